"""A real groove under six lights against its maker's height map; skipped where it is not there."""

import pytest

from tests.benchmarks.accuracy.groove import Groove
from tests.benchmarks.accuracy.real_sets import data_folder

FOLDER = data_folder() / "groove"


@pytest.mark.skipif(not FOLDER.is_dir(), reason=f"no groove in {FOLDER}: set RETROGRAPH_DATA")
def test_six_lights_keep_to_the_makers_map_in_the_worse_half_better_than_three() -> None:
    groove = Groove(FOLDER)
    three, six = (
        max(groove.error(groove.rows(*taught), groups).percent for taught in ((0.0, 0.5), (0.5, 1.0)))
        for groups in (groove.groups[:1], groove.groups)
    )
    assert six < 3.0
    assert six < 0.8 * three

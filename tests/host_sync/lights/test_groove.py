"""A real groove under six lights against its maker's height map; skipped where it is not there."""

import pytest

from tests.benchmarks.accuracy.groove import Groove
from tests.benchmarks.accuracy.real_sets import data_folder

FOLDER = data_folder() / "groove"


@pytest.mark.skipif(not FOLDER.is_dir(), reason=f"no groove in {FOLDER}: set RETROGRAPH_DATA")
def test_six_lights_are_nearer_the_makers_map_than_three() -> None:
    groove = Groove(FOLDER)
    for taught, worst in (((0.0, 0.5), 3.0), ((0.5, 1.0), 4.2)):
        three, six = (
            groove.error(groove.rows(*taught), groups).percent for groups in (groove.groups[:1], groove.groups)
        )
        assert six < worst
        assert six < 0.8 * three

"""Names of the files in a result folder, and the versions of its record."""

from __future__ import annotations

from typing import Final, Literal

DetailName = Literal["raw", "shrunk"]
"""raw: every pixel's own slope, noise included. shrunk: from frames whose pixel noise was shrunk."""


def other_detail(detail: DetailName) -> DetailName:
    """Return the other kind."""
    return "shrunk" if detail == "raw" else "raw"


RESULT_SCHEMA: Final = "retrograph.result/1"
SEQUENCE_SCHEMA: Final = "retrograph.sequence/1"

RECORD_FILE: Final = "result.json"
HEIGHT_FILE: Final = "height_um.tif"
OTHER_HEIGHT_FILES: Final[dict[DetailName, str]] = {"raw": "height_raw_um.tif", "shrunk": "height_shrunk_um.tif"}
"""Height map with the detail that `HEIGHT_FILE` does not hold."""
SLOPE_P_FILE: Final = "slope_p.tif"
SLOPE_Q_FILE: Final = "slope_q.tif"
HEIGHT_SIGMA_FILE: Final = "height_sigma_um.tif"
SLOPE_SIGMA_FILE: Final = "slope_sigma.tif"
SAMPLES_FILE: Final = "height_draws_um.tif"
EXTRAPOLATED_FILE: Final = "extrapolated.png"
UNTOUCHED_FILE: Final = "untouched.png"
"""Untouched skin that the zero was taken from; missing where none is untouched."""
RELIEF_FILE: Final = "relief.png"
DETAIL_FILE: Final = "detail_um.tif"
DETAIL_PICTURE_FILE: Final = "detail.png"
OVERVIEW_FILE: Final = "overview.png"
"""Beside a calibration's report."""
HEIGHTS_FILE: Final = "heights_um.tif"
"""Height maps of a video, one page per frame."""

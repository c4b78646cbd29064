"""When a press, a gel or a light is worth a word: every threshold of coach, verdict and health in one place.

Shares are of the field or of full scale unless the line says otherwise; intensity is that of untouched skin, 1.
"""

from __future__ import annotations

from typing import Final

CLIPPED_RETAKE: Final = 0.05
CLIPPED_DOUBTFUL: Final = 0.005
"""Shares of clipped pixels from which a press is to be retaken, or doubted."""

LEAST_CONTACT: Final = 0.005
"""A press that shades a smaller share of the field has hardly touched anything."""

SHADED: Final = 0.06
"""Intensity this far from that of flat skin, in any channel, counts as shaded."""

UNDEREXPOSED: Final = 0.1
"""A frame whose 99th percentile stays under this share of full scale is mostly noise."""

DEEPEST_SHARE: Final = 0.6
"""Of the slab's thickness: pressed deeper, a gel tears or leaves its window."""

DEEP_SHARE: Final = 0.5
"""Of the slab's thickness: from here the coach warns."""

RAISED_SHARE: Final = 0.03
"""Of the slab's thickness: skin that is lifted by more is in contact, or close beside it."""

TILTED_DEG: Final = 6.0
"""A contact whose plane leans more is pressed askew."""

TILT_CONTACT: Final = 0.05
"""Contacts of a smaller share of the field have no tilt worth a word."""

MOVING: Final = 0.05
"""Change of smoothed intensity from frame to frame, 99th percentile: above, the object moves."""

STILL_S: Final = 0.4
"""Contact that has not moved for this long is still."""

MOTION_DOUBTFUL: Final = 0.10
"""The same change between the last live frame and the frame of the scan: above, the scan may be smeared."""

SHARP: Final = 0.4
"""Fine over coarser contrast of the strongest edges: below, the frame is far out of focus or smeared."""

DRIFTED: Final = 0.02
"""A light or the reference that has changed by this share since calibration costs about half a degree of slope."""

DRIFTED_FAR: Final = 0.10
"""Change from which the calibration means nothing any more."""

STALE_EVIDENCE_SCANS: Final = 20
"""After so many scans without a look at untouched skin, the state of the lights is unknown."""

DEFECT_CONTRAST: Final = 0.04
"""A place of the resting skin that differs from its surroundings by this share is a scratch, dust or a stain."""

DEFECTS_DOUBTFUL: Final = 0.02
"""Share of the field under defects from which a gel is to be wiped or changed."""

GEL_PRESSES: Final = 5000
"""Presses after which a gel's coat is worth a look, whatever its reference says."""

FLAT_RESIDUAL_UM: Final = 8.0
"""The zero check passes while the untouched skin reads flat to this root mean square."""

OLD_CALIBRATION_S: Final = 30 * 86_400.0
"""Age from which a calibration is worth a check with the cap."""

LOW_BATTERY: Final = 0.1

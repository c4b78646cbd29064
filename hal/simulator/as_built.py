"""A board's profile as a twin: its sensor, scale, lens and lights in the simulated world."""

from __future__ import annotations

import msgspec

from hal.board_profile import BoardProfile, TwinConfig
from hal.errors import BoardProfileError
from hal.simulator.lens import GEL_INDEX


def twin_of(profile: BoardProfile) -> BoardProfile:
    """Return the profile with the twin's driver, its camera where the lens stands sharp.

    Raises
    ------
    BoardProfileError
        The profile has no [lens] table, so nobody knows how sharp it is or from where it looks.
    """
    if profile.lens is None:
        raise BoardProfileError(f"board {profile.name!r} has no [lens] table: state focal_mm, f_number and pixel_um")
    magnification = profile.lens.pixel_um / profile.sensor.pixel_pitch_um
    # From inside the gel the lens seems farther: rays bend where they leave the block.
    distance_mm = GEL_INDEX * profile.lens.focal_mm * (1.0 + 1.0 / magnification)
    twin = profile.twin or TwinConfig()
    as_twin = msgspec.structs.replace(twin, camera_distance_mm=distance_mm)
    return msgspec.structs.replace(profile, driver="twin", twin=as_twin)

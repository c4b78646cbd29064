"""One press as the camera sees it: where the skin lies, and how much charge each light brings to each pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hal.board_profile import BoardProfile
from hal.twin.arrays import Float32Array
from hal.twin.elastomer import Skin, drape
from hal.twin.lens import Lens
from hal.twin.optics import coat, radiance, skin_geometry
from hal.twin.sensor import mosaic_weights
from hal.twin.surfaces import Surface


@dataclass(frozen=True, slots=True)
class Press:
    """An object on the gel: its origin at `centre_mm`, turned by `turn_rad`, its top `indentation_mm` deep."""

    surface: Surface
    centre_mm: tuple[float, float]
    turn_rad: float
    indentation_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A press, rendered without noise.

    charge_e : for each light, float32 array of shape (H, W), electrons per mA and ms of exposure
    """

    skin: Skin
    charge_e: tuple[Float32Array, ...]


def render(profile: BoardProfile, press: Press | None) -> Scene:
    """The scene of a press, or of the resting skin when there is none."""
    twin = profile.twin
    if twin is None:
        raise ValueError(f"board {profile.name!r} has no [twin] table")
    lens = Lens.of(profile)
    skin = _lay_skin(profile, lens, press)
    geometry = skin_geometry(lens, skin.height_mm)
    charges = []
    for index, light in enumerate(profile.lights):
        seen = radiance(geometry, lens, coat(twin.skin), light.position_mm, twin.light_radius_mm)
        red, green, blue = (row[index] for row in twin.crosstalk)
        weights = mosaic_weights(profile.sensor, (red, green, blue)) * np.float32(twin.yield_e_per_ma_ms)
        charges.append(lens.transmit(seen) * weights)
    return Scene(skin, tuple(charges))


def _lay_skin(profile: BoardProfile, lens: Lens, press: Press | None) -> Skin:
    """The skin on the camera's pixel grid.

    The object is seen in perspective before the skin is laid over it, so contact is exact; the free skin between
    stretches by height over camera distance, about a percent, as the picture does.
    """
    if press is None:
        shape = (profile.sensor.rows, profile.sensor.columns)
        return Skin(np.zeros(shape, np.float32), np.zeros(shape, np.bool_))
    seen = lens.see(press.surface, press.centre_mm, press.turn_rad, press.indentation_mm)
    return drape(seen, lens.pitch_mm, profile.gel.slab_thickness_mm)

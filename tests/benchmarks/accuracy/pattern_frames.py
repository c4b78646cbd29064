"""Frames of a fine pattern and of ball presses, with the twin's light and sensor, with or without mosaic.

The elastomer does not affect the pattern: the skin has its shape exactly, as if printed on it, so what a height map
lacks was lost by camera or reconstruction. A pixel sees the mean over its own square, from 16 points with slopes by the
pattern's formula: differences of neighbouring pixels would blur them.

The camera without mosaic has one sensor per colour (three sensors behind a prism) and a lens without blur; the one with
mosaic is that of the profile.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.surface import Float32Array
from hal.board_profile import BoardProfile, TwinConfig
from hal.frame import RawFrame
from hal.simulator.lens import Lens
from hal.simulator.scene import SkinGeometry, expose, light_on_skin, mosaic_weights, native_order, skin_geometry
from tests.benchmarks.accuracy.pattern import Patch

POINTS: Final = 4
_STEP_PX: Final = 1e-3


def pattern_light(profile: BoardProfile, patches: Sequence[Patch]) -> tuple[Float32Array, ...]:
    """Radiance of the patterned skin under each light, float32 arrays of shape (H, W), before the lens."""
    lens = Lens.of(profile)
    shifts = (np.arange(POINTS) + 0.5) / POINTS - 0.5
    total = [np.zeros((lens.row_mm.size, lens.column_mm.size), np.float32) for _ in profile.lights]
    for down in shifts:
        for right in shifts:
            seen = _light(profile, lens, _patterned_skin(lens, patches, right, down))
            for sum_, part in zip(total, seen, strict=True):
                sum_ += part / np.float32(POINTS**2)
    return tuple(total)


def skin_light(profile: BoardProfile, height_mm: Float32Array) -> tuple[Float32Array, ...]:
    """Radiance of a skin with heights `height_mm`, of shape (H, W), under each light, before the lens."""
    lens = Lens.of(profile)
    return _light(profile, lens, skin_geometry(lens, height_mm))


def mosaic_frame(profile: BoardProfile, light: Sequence[Float32Array], seed: int) -> RawFrame:
    """Raw frame of this light by the profile's own camera, blurred as untouched skin is."""
    sensor, camera, twin = profile.sensor, profile.camera, _twin(profile)
    lens = Lens.of(profile)
    untouched = np.zeros((sensor.rows, sensor.columns), np.float32)
    charge = np.zeros_like(untouched)
    for index, (source, seen) in enumerate(zip(profile.lights, light, strict=True)):
        red, green, blue = (row[index] for row in twin.crosstalk)
        charge += (
            lens.transmit(seen, untouched)
            * mosaic_weights(sensor, (red, green, blue))
            * _dose_e(profile, source.current_ma)
        )
    counts = expose(charge, sensor, camera.analogue_gain, np.random.default_rng(seed))
    return RawFrame(counts, native_order(sensor), sensor.black_level_dn, sensor.white_level_dn, camera.settings, 0)


def rgb_frame(profile: BoardProfile, light: Sequence[Float32Array], seed: int) -> NDArray[np.uint16]:
    """Frame of this light by three sensors: uint16 array of shape (H, W, 3), linear, black 0; blurred as flat skin."""
    sensor, twin = profile.sensor, _twin(profile)
    lens = Lens.of(profile)
    random = np.random.default_rng(seed)
    untouched = np.zeros((sensor.rows, sensor.columns), np.float32)
    planes = []
    for passed in twin.crosstalk:
        charge = np.zeros((sensor.rows, sensor.columns), np.float32)
        for source, share, seen in zip(profile.lights, passed, light, strict=True):
            charge += lens.transmit(seen, untouched) * np.float32(share) * _dose_e(profile, source.current_ma)
        counts = expose(charge, sensor, profile.camera.analogue_gain, random).astype(np.float64)
        full_scale = sensor.white_level_dn - sensor.black_level_dn
        planes.append(np.clip((counts - sensor.black_level_dn) / full_scale, 0.0, 1.0) * 65_535.0)
    return np.rint(np.stack(planes, axis=-1)).astype(np.uint16)


def _patterned_skin(lens: Lens, patches: Sequence[Patch], right_px: float, down_px: float) -> SkinGeometry:
    """The patterned skin at one point of every pixel, at this distance from its centre."""
    shape = (lens.row_mm.size, lens.column_mm.size)
    height, p, q = (np.zeros(shape, np.float32) for _ in range(3))
    for patch in patches:
        reach = int(np.ceil(patch.reach_px)) + 1
        rows, columns = (
            slice(max(int(at) - reach, 0), min(int(at) + reach + 1, size))
            for at, size in zip((patch.row, patch.column), shape, strict=True)
        )
        row, column = np.mgrid[rows, columns].astype(np.float64)
        row, column = row + down_px, column + right_px
        height[rows, columns] += patch.height_px(column, row) * lens.pitch_mm
        ahead, below = patch.height_px(column + _STEP_PX, row), patch.height_px(column, row + _STEP_PX)
        behind, above = patch.height_px(column - _STEP_PX, row), patch.height_px(column, row - _STEP_PX)
        p[rows, columns] += (ahead - behind) / (2.0 * _STEP_PX)
        q[rows, columns] += (below - above) / (2.0 * _STEP_PX)
    x, y = lens.points_mm(height)
    up = 1.0 / np.sqrt(1.0 + p**2 + q**2)
    return SkinGeometry(*(np.asarray(part, np.float32) for part in (x, y, height, -p * up, -q * up, up)))


def _light(profile: BoardProfile, lens: Lens, skin: SkinGeometry) -> tuple[Float32Array, ...]:
    return tuple(light_on_skin(profile, skin, lens, light.position_mm) for light in profile.lights)


def _dose_e(profile: BoardProfile, current_ma: float) -> np.float32:
    """Electrons per unit of radiance that one light brings in one exposure."""
    return np.float32(_twin(profile).yield_e_per_ma_ms * current_ma * profile.camera.exposure_us * 1e-3)


def _twin(profile: BoardProfile) -> TwinConfig:
    if profile.twin is None:
        raise ValueError(f"board {profile.name!r} has no [twin] table")
    return profile.twin

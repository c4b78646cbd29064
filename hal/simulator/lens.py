"""The twin's lens: which point of the skin each pixel sees, and what the optics do to its light.

The skin is described on the camera's own pixel grid: z of the point that each pixel sees. The truth is therefore on the
same grid as the frames, and nothing is resampled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Self

import cv2
import numpy as np

from hal.board_profile import BoardProfile
from hal.profile_tables import LensConfig
from hal.simulator.surfaces import Float32Array, FloatArray, Surface


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """A camera looking straight down from `distance_mm` above the untouched skin.

    column_mm, row_mm : float32 arrays of shape (1, W) and (H, 1), mm; nominal position of each pixel on the untouched
        skin
    distortion : relative radial shift at the corner of the field
    blur : of a lens with an f-number, in place of `point_spread_px`
    """

    column_mm: Float32Array
    row_mm: Float32Array
    pitch_mm: float
    distance_mm: float
    distortion: float
    vignetting: float
    point_spread_px: float
    blur: Blur | None = None

    @classmethod
    def of(cls, profile: BoardProfile) -> Self:
        """Return the lens of a twin's board profile."""
        sensor, twin = profile.sensor, profile.twin
        if twin is None:
            raise ValueError(f"board {profile.name!r} has no [twin] table")
        pitch = sensor.pixel_pitch_um * 1e-3
        return cls(
            (np.arange(sensor.columns, dtype=np.float32)[None, :] - (sensor.columns - 1) / 2) * np.float32(pitch),
            (np.arange(sensor.rows, dtype=np.float32)[:, None] - (sensor.rows - 1) / 2) * np.float32(pitch),
            pitch,
            twin.camera_distance_mm,
            twin.distortion,
            twin.vignetting,
            twin.point_spread_px,
            None if profile.lens is None else blur_of(profile.lens, sensor.pixel_pitch_um),
        )

    @property
    def corner_mm(self) -> float:
        """Half the diagonal of the field, mm."""
        return float(np.hypot(self.column_mm[0, -1], self.row_mm[-1, 0]))

    def aim_mm(self) -> tuple[FloatArray, FloatArray]:
        """Return where each pixel's line of sight meets the untouched skin: x and y (mm), broadcasting to (H, W)."""
        if self.distortion == 0.0:
            return self.column_mm, self.row_mm
        stretch = 1.0 + self._bend() * (self.column_mm**2 + self.row_mm**2)
        return self.column_mm * stretch, self.row_mm * stretch

    def points_mm(self, height_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """x and y (mm), arrays of shape (H, W), of the skin point at `height_mm` that each pixel sees."""
        x, y = self.aim_mm()
        nearer = 1.0 - height_mm / np.float32(self.distance_mm)
        return x * nearer, y * nearer

    def see(self, surface: Surface, centre_mm: tuple[float, float], turn_rad: float, top_mm: float) -> FloatArray:
        """Return the height (mm) over the untouched skin of the surface point that each pixel would see.

        NaN outside the surface, whose origin is at `centre_mm`, turned by `turn_rad`, its highest point at `top_mm`.
        """
        cos, sin = np.float32(np.cos(turn_rad)), np.float32(np.sin(turn_rad))
        height = np.full((self.row_mm.size, self.column_mm.size), top_mm, np.float32)
        # Each round shrinks the error by slope times the tangent of the viewing angle, some percent.
        for _ in range(4):
            x, y = self.points_mm(np.nan_to_num(np.maximum(height, 0.0)))
            x, y = x - np.float32(centre_mm[0]), y - np.float32(centre_mm[1])
            height = np.asarray(
                surface.height_mm(cos * x + sin * y, cos * y - sin * x) + np.float32(top_mm), np.float32
            )
        return height

    def skin_slopes(self, height_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return slopes (dz/dx, dz/dy) of the skin itself, arrays of shape (H, W), from heights on the pixel grid."""
        along_row, along_column = np.gradient(height_mm / np.float32(self.pitch_mm))
        p, q = self._undistorted(along_column, along_row)
        x, y = self.aim_mm()
        # The line of sight leans by (x, y) / distance: z(X) on the grid is z at the point X (1 - z / distance).
        nearer = 1.0 - height_mm / np.float32(self.distance_mm)
        leaning = x * p + y * q
        stretch = 1.0 / (nearer - leaning / np.float32(self.distance_mm))
        return p * stretch, q * stretch

    def transmit(self, radiance: Float32Array, height_mm: FloatArray) -> Float32Array:
        """Return the radiance of a skin at `height_mm`, arrays (H, W), after vignetting and point spread; float32."""
        radius2 = (self.column_mm**2 + self.row_mm**2) / np.float32(self.corner_mm**2)
        passed = radiance * (1.0 - np.float32(self.vignetting) * radius2)
        if self.blur is not None:
            return self.blur.spread(np.asarray(passed, np.float32), height_mm)
        if self.point_spread_px > 0.0:
            passed = cv2.GaussianBlur(passed, (0, 0), self.point_spread_px, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(passed, np.float32)

    def _bend(self) -> np.float32:
        return np.float32(self.distortion / self.corner_mm**2)

    def _undistorted(self, p: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return slopes relative to the aim from slopes on the pixel grid: inverse transposed Jacobian of `aim_mm`."""
        if self.distortion == 0.0:
            return p, q
        x, y, bend = self.column_mm, self.row_mm, self._bend()
        xx, yy = 1.0 + bend * (3.0 * x**2 + y**2), 1.0 + bend * (x**2 + 3.0 * y**2)
        xy = 2.0 * bend * x * y
        determinant = xx * yy - xy**2
        return (yy * p - xy * q) / determinant, (xx * q - xy * p) / determinant


# Blur of a lens from its f-number: diffraction, pixel and defocus in quadrature. Geometry and Airy's pattern alone.

WAVELENGTH_UM: Final = 0.53
GEL_INDEX: Final = 1.41
SIGMA_OF_DISC: Final = 0.25
"""Standard deviation along one axis of an evenly lit disc, as a share of its diameter."""

SIGMA_OF_AIRY: Final = 0.42
"""Of the Gaussian that fits the core of Airy's pattern, as a share of wavelength times f-number."""

SIGMA_OF_PIXEL: Final = 1.0 / math.sqrt(12.0)
FULL_WIDTH: Final = 2.3548
"""Full width at half height of a Gaussian, in standard deviations."""

LEVEL_RATIO: Final = 1.15
"""Blurs of neighbouring levels differ by this factor; between two, light is interpolated."""


@dataclass(frozen=True, slots=True)
class Blur:
    """Blur at the skin, µm.

    airy_um : diameter of Airy's disc
    pitch_um : pixel pitch
    defocus : diameter of the disc of defocus over the distance from the plane in focus
    depth_mm : distance from that plane at which the disc of defocus is as wide as two pixels
    focus_mm : height of that plane above the untouched skin
    """

    airy_um: float
    pitch_um: float
    defocus: float
    depth_mm: float
    focus_mm: float

    def at_um(self, off_mm: float) -> float:
        """Full width at half height at this distance from the plane in focus, mm."""
        return FULL_WIDTH * float(self.sigma_um(np.float64(off_mm)))

    def sigma_um(self, off_mm: FloatArray | np.float64) -> FloatArray:
        """Return the standard deviation of a point's image, in the shape of `off_mm`.

        off_mm : distances from the plane in focus
        """
        fixed = math.hypot(SIGMA_OF_AIRY / 2.44 * self.airy_um, SIGMA_OF_PIXEL * self.pitch_um)
        return np.asarray(np.hypot(fixed, SIGMA_OF_DISC * self.defocus * 1e3 * off_mm))

    def spread(self, light: Float32Array, height_mm: FloatArray) -> Float32Array:
        """Return the light of shape (H, W) as blurred where the skin stands at `height_mm`, array of the same shape.

        Gaussians of a few levels are computed, and each pixel takes a mean of the two next to its own variance.
        """
        sigma_px = np.asarray(self.sigma_um(height_mm - self.focus_mm) / self.pitch_um, np.float32)
        low, high = float(sigma_px.min()), float(sigma_px.max())
        steps = max(math.ceil(math.log(high / low) / math.log(LEVEL_RATIO)), 1)
        levels = np.geomspace(low, high, steps + 1) if high > 1.001 * low else np.array([high])
        spread = np.zeros_like(light)
        for number, level in enumerate(levels):
            weight = _tent(sigma_px**2, levels**2, number)
            spread += weight * cv2.GaussianBlur(light, (0, 0), float(level), borderType=cv2.BORDER_REPLICATE)
        return spread


def blur_of(lens: LensConfig, pitch_um: float) -> Blur:
    """Return the blur of a lens at the f-number to which it is set."""
    magnification = lens.pixel_um / pitch_um
    airy_um = 2.44 * WAVELENGTH_UM * lens.f_number * (1.0 + magnification) / magnification
    # The pupil, focal length over f-number, stands f (1 + 1/m) from the skin; the gel narrows the cone.
    defocus = magnification / ((1.0 + magnification) * lens.f_number) / GEL_INDEX
    return Blur(airy_um, pitch_um, defocus, 2.0 * pitch_um * 1e-3 / defocus, lens.focus_mm)


def _tent(value: Float32Array, nodes: FloatArray, number: int) -> Float32Array:
    """Return the weight (0 to 1) of one node in linear interpolation between nodes, in the shape of `value`."""
    peak = np.zeros(nodes.size)
    peak[number] = 1.0
    return np.asarray(np.interp(value, nodes, peak), np.float32)

"""The twin's lens: which point of the skin each pixel sees, and what the optics do to its light.

The skin is described on the camera's own pixel grid: z of the point that each pixel sees. The truth is therefore on the
same grid as the frames, and nothing is resampled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np

from hal.board_profile import BoardProfile
from hal.simulator.arrays import Float32Array, FloatArray
from hal.simulator.blur import Blur, blur_of
from hal.simulator.surfaces import Surface


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
        """The lens of a twin's board profile."""
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
        """Height (mm) above the untouched skin of the surface point that each pixel would see, NaN outside the surface.

        The origin of the surface is at `centre_mm`, turned by `turn_rad`, its highest point at `top_mm`.
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
        """Slopes (dz/dx, dz/dy) of the skin itself, arrays of shape (H, W), from heights on the pixel grid."""
        along_row, along_column = np.gradient(height_mm / np.float32(self.pitch_mm))
        p, q = self._undistorted(along_column, along_row)
        x, y = self.aim_mm()
        # The line of sight leans by (x, y) / distance: z(X) on the grid is z at the point X (1 - z / distance).
        nearer = 1.0 - height_mm / np.float32(self.distance_mm)
        leaning = x * p + y * q
        stretch = 1.0 / (nearer - leaning / np.float32(self.distance_mm))
        return p * stretch, q * stretch

    def transmit(self, radiance: Float32Array, height_mm: FloatArray) -> Float32Array:
        """Radiance of a skin at `height_mm`, arrays of shape (H, W), after vignetting and point spread; float32."""
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
        """Slopes relative to the aim from slopes on the pixel grid: inverse transposed Jacobian of `aim_mm`."""
        if self.distortion == 0.0:
            return p, q
        x, y, bend = self.column_mm, self.row_mm, self._bend()
        xx, yy = 1.0 + bend * (3.0 * x**2 + y**2), 1.0 + bend * (x**2 + 3.0 * y**2)
        xy = 2.0 * bend * x * y
        determinant = xx * yy - xy**2
        return (yy * p - xy * q) / determinant, (xx * q - xy * p) / determinant

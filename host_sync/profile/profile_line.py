"""Heights along a chosen line, averaged across it where a width is given."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from device.surface.fields import Float32Array, Float64Array, MaskArray
from host_sync.errors import MeasurementError

MIN_SAMPLES = 8
MIN_WEIGHT = 1e-9


@dataclass(frozen=True, slots=True)
class Line:
    """A line on the field, µm from the centre of the first pixel.

    start_um, end_um : (column, row) of both ends
    width_um : width across the line over which the profile is averaged; 0 takes the line alone
    """

    start_um: tuple[float, float]
    end_um: tuple[float, float]
    width_um: float = 0.0

    @property
    def length_um(self) -> float:
        """Length from end to end, µm."""
        return math.dist(self.start_um, self.end_um)


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Heights at equal steps along a line.

    z_um : float64 array of shape (N,), µm, NaN where invalid
    step_um : sample spacing, µm
    """

    z_um: Float64Array
    step_um: float

    @property
    def along_um(self) -> Float64Array:
        """Distances of the samples from the start: float64 array of shape (N,), µm."""
        return np.arange(self.z_um.size, dtype=np.float64) * self.step_um

    @property
    def masked_share(self) -> float:
        """Fraction of samples without a height."""
        return float(np.isnan(self.z_um).mean())


def profile_along(z_um: Float32Array, pitch_um: float, line: Line) -> Profile:
    """The profile along a line: bilinear, one sample per pixel, NaN where one of the four neighbours is invalid.

    Across the line the valid samples are averaged; the profile is invalid where fewer than half of them are valid.

    Raises
    ------
    MeasurementError
        The line leaves the field or is too short.
    """
    steps = int(np.floor(line.length_um / pitch_um + 1e-6))
    if steps + 1 < MIN_SAMPLES:
        raise MeasurementError(
            f"the line is {line.length_um:g} µm long, which is less than {MIN_SAMPLES} pixels of {pitch_um:g} µm: "
            "move its ends apart"
        )
    start, end = (np.array(place) / pitch_um for place in (line.start_um, line.end_um))
    limit = np.array(z_um.shape[::-1]) - 1.0
    for name, place in (("start", start), ("end", end)):
        if (place < -0.5).any() or (place > limit + 0.5).any():
            column, row = place * pitch_um
            raise MeasurementError(
                f"the line's {name} ({column:g}, {row:g}) µm lies outside the field of "
                f"{limit[0] * pitch_um:.0f} x {limit[1] * pitch_um:.0f} µm: move it inside"
            )
    along = (end - start) / np.hypot(*(end - start))
    across = np.array([-along[1], along[0]])
    half = line.width_um / pitch_um / 2.0
    offsets = np.linspace(-half, half, max(int(np.ceil(2.0 * half)) + 1, 1)) if half > 0.0 else np.zeros(1)
    places = start + np.arange(steps + 1)[:, None, None] * along + offsets[:, None] * across
    values, seen = bilinear(z_um, places, limit)
    count = seen.sum(axis=-1)
    mean = np.where(seen, values, 0.0).sum(axis=-1) / np.maximum(count, 1)
    return Profile(np.where(2 * count >= offsets.size, mean, np.nan), pitch_um)


def bilinear(
    z_um: Float32Array, places: Float64Array, limit: Float64Array | None = None
) -> tuple[Float64Array, MaskArray]:
    """Heights between pixels, and where they are valid: float64 and bool arrays of shape (...).

    places : float64 array of shape (..., 2), column and row in pixels
    limit : largest column and row; that of the array by default
    """
    limit = np.array(z_um.shape[::-1]) - 1.0 if limit is None else limit
    inside = ((places > -0.5) & (places < limit + 0.5)).all(axis=-1)
    places = np.clip(places, 0.0, limit)
    low = np.minimum(np.floor(places), np.maximum(limit - 1.0, 0.0)).astype(np.intp)
    across, down = np.moveaxis(places - low, -1, 0)
    column, row = np.moveaxis(low, -1, 0)
    values = np.zeros(places.shape[:-1])
    for i, weight_down in ((0, 1.0 - down), (1, down)):
        for j, weight_across in ((0, 1.0 - across), (1, across)):
            weight = weight_down * weight_across
            # A pixel without weight may be invalid.
            near = z_um[np.minimum(row + i, z_um.shape[0] - 1), np.minimum(column + j, z_um.shape[1] - 1)]
            values += np.where(weight > MIN_WEIGHT, weight * near, 0.0)
    return values, inside & np.isfinite(values)

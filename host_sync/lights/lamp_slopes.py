"""Slopes that fitted lamps tell at places of known elevation: least squares over the channels that count.

An inverse map is a polynomial taught by a dozen balls; the lamps that explain these balls hold for every slope, place
and elevation, and tell what each channel shows where another is hidden.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface.fields import Float32Array, Float64Array
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.lights.lamp_model import LampModel
from host_sync.lights.step_kernel import write_shown, write_step
from host_sync.lights.surroundings import Surroundings

INTENSITY_SIGMA: Final = 0.01
"""Standard uncertainty of the intensity that lamps predict."""

STEP: Final = 1e-3
"""Slope by which derivatives are taken."""

BESIDE: Final = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
"""Steps of slopes p and q, in `STEP`, at which light is taken for its derivatives."""

SURFACE_SIGMA: Final = 0.15
"""Standard uncertainty of slopes as they are known before lamps tell them."""

READER_STEPS: Final = 4

WORK: Final = 16
"""Pixels of a field whose kernels take as long as the arithmetic of one place."""

MAX_MOVE: Final = 0.3
"""Slope, at most, by which one step of the search moves."""


@dataclass(frozen=True, slots=True, eq=False)
class LampSkin:
    """Places of skin under lamps.

    model : the lamps
    column, row : pixels, float64 arrays of shape (N,)
    rest : intensity of untouched skin there up to the model's factor, shape (N, 3)
    shares : of it, what each channel shows of each lamp, shape (N, 3, 3)
    close : what skin close by shows, shape (N, 3)
    visible : of each of a lamp's points, how much of its light arrives, shape (N, 3, points); None where all of it does
    """

    model: LampModel
    column: Float64Array
    row: Float64Array
    rest: Float64Array
    shares: Float64Array
    close: Float64Array
    visible: Float64Array | None = None

    @classmethod
    def at(
        cls, model: LampModel, column: Float64Array, row: Float64Array, around: Surroundings | None = None
    ) -> LampSkin:
        """Skin at these pixels, float64 arrays of shape (N,); None where the skin around is untouched."""
        level = np.zeros_like(column)
        own = model.own_light(level, level, column, row, level)
        rest = model.mixed(own)
        close = np.ones_like(rest) if around is None else around.at(column, row)
        return cls(model, column, row, rest, model.mixing * own[:, None, :] / rest[:, :, None], close)

    def select(self, rows: np.ndarray) -> LampSkin:
        """The places of these numbers."""
        column, row, rest, shares, close = (
            part[rows] for part in (self.column, self.row, self.rest, self.shares, self.close)
        )
        return LampSkin(
            self.model, column, row, rest, shares, close, None if self.visible is None else self.visible[rows]
        )

    def shown(self, slope: Float64Array, z_px: Float64Array, model: LampModel | None = None) -> Float64Array:
        """Intensity (N, 3) of slopes (N, 2) at elevations (N,), under other lamps, all of which arrive, where given."""
        p, q = np.ascontiguousarray(slope.T)
        if model is not None:
            return model.shown(p, q, self.column, self.row, z_px, self.close)
        return self._shown(p[:, None], q[:, None], z_px)[:, 0]

    def shown_and_changes(self, slope: Float64Array, z_px: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Intensity (N, 3) as `shown`, and what it changes with both slopes: shape (N, 3, 2)."""
        p, q = (slope[:, axis, None] + STEP * BESIDE[axis] for axis in (0, 1))
        here, by_p, by_q = np.moveaxis(self._shown(p, q, z_px), 1, 0)
        change = np.empty((*here.shape, 2))
        np.subtract(by_p, here, out=change[..., 0])
        np.subtract(by_q, here, out=change[..., 1])
        change /= STEP
        return np.ascontiguousarray(here), change

    def _shown(self, p: Float64Array, q: Float64Array, z_px: Float64Array) -> Float64Array:
        """Intensity (N, K, 3) of K slopes (N, K) at each place, at elevations (N,)."""
        model, own = self.model, self.model.own_light(p, q, self.column, self.row, z_px, self.visible)
        shown, bounce = np.empty_like(own), np.array([model.bounce_afar, model.bounce_close])
        light = own, model.mixing, model.haze, self.rest, self.close, bounce
        parallel_rows(write_shown, (len(own), WORK * p.shape[1]), *light, p, q, shown)
        return shown

    def without(self, lost: Float64Array) -> Float64Array:
        """What channels lack of other lamps' light where they lack `lost` (N, 3) of their own: shape (N, 3)."""
        own = np.einsum("ncc->nc", self.shares)
        return np.asarray(np.einsum("nck,nk->nc", self.shares, lost / own) - lost)


@dataclass(frozen=True, slots=True, eq=False)
class KnownBefore:
    """Slopes that are known beforehand.

    slope : shape (N, 2)
    sigma : standard uncertainty of either
    """

    slope: Float64Array
    sigma: float


def move_towards(
    skin: LampSkin,
    intensity: Float64Array,
    slope: Float64Array,
    z_px: Float64Array,
    before: KnownBefore,
    trust: Float64Array | None = None,
    known: tuple[Float64Array, Float64Array] | None = None,
) -> Float64Array:
    """One Gauss-Newton step from slopes (N, 2) towards those that explain intensities (N, 3): the new slopes.

    trust : how much each channel counts, 0 to 1, shape (N, 3); all of them fully where it is None
    known : as of `LampSkin.shown_and_changes` for these slopes, where that was asked before
    """
    shown, change = skin.shown_and_changes(slope, z_px) if known is None else known
    missing = intensity - shown
    weight = np.full_like(shown, INTENSITY_SIGMA**-2)
    if trust is not None:
        weight *= trust
        missing += skin.without((1.0 - trust) * np.maximum(-missing, 0.0))
    move = gauss_newton_step(change, weight, missing, before.slope - slope, before.sigma)
    return slope + bounded(move)


def bounded(move: Float64Array) -> Float64Array:
    """Moves of slopes, shape (N, 2), none longer than `MAX_MOVE`."""
    length = np.linalg.norm(move, axis=1, keepdims=True)
    return np.asarray(move * np.minimum(1.0, MAX_MOVE / np.maximum(length, 1e-9)))


def gauss_newton_step(
    change: Float64Array, weight: Float64Array, missing: Float64Array, back: Float64Array, sigma: float
) -> Float64Array:
    """Slopes (N, 2) to be added that explain missing intensities (N, 3) best.

    change : of intensities with slopes, shape (N, 3, 2)
    weight : of channels, shape (N, 3)
    back : to slopes that are known beforehand with the standard uncertainty `sigma`, shape (N, 2)
    """
    step = np.empty((len(back), 2))
    parallel_rows(write_step, (len(step), WORK), change, weight, missing, back, sigma**-2, step)
    return step


@dataclass(frozen=True, slots=True, eq=False)
class LampReader:
    """What lamps make of an inverse map's slopes at the elevation of untouched skin.

    around : of the skin that is read; None where it is untouched
    """

    inverse: InverseMap
    model: LampModel
    around: Surroundings | None = None

    def in_frame(self, image: NormalizedImage) -> LampReader:
        """The reader of an image's skin."""
        return replace(self, around=Surroundings.of(image))

    def predict(self, intensity: Float32Array, column: Float32Array, row: Float32Array) -> Float64Array:
        """Slopes p and q, float64 array of shape (N, 2), of intensities (N, 3) at pixels (N,)."""
        read = self.inverse.predict(intensity, column, row)
        skin = LampSkin.at(self.model, column.astype(np.float64), row.astype(np.float64), self.around)
        seen, level = intensity.astype(np.float64), np.zeros(len(read))
        before, slope = KnownBefore(read, SURFACE_SIGMA), read
        for _ in range(READER_STEPS):
            slope = move_towards(skin, seen, slope, level, before)
        return slope

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
from device.surface.fields import Float32Array, Float64Array, MaskArray
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.lights.lamp_model import LampModel, arriving_or_all
from host_sync.lights.search_kernel import write_search
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

SEARCH_WORK: Final = 64
"""Pixels of a field whose kernels take as long as one step of the search at one place, or the rays before the first."""

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


@dataclass(frozen=True, slots=True, eq=False)
class KnownBefore:
    """Slopes that are known beforehand.

    slope : shape (N, 2)
    sigma : standard uncertainty of either
    """

    slope: Float64Array
    sigma: float


@dataclass(frozen=True, slots=True, eq=False)
class ChannelTrust:
    """How much channels count whose lamps may be hidden; all others count in full.

    hidden : which, bool array of shape (N, 3)
    counts : how much they count at most, 0 to 1, shape (N, 3)
    apart : intensity by which one is darker or brighter than predicted: from the first on it counts less, from the
        second on it does not count
    setting : predicted intensity below which a light is about to set, and at which it has
    free_steps : how many steps, the first, leave them out
    """

    hidden: MaskArray
    counts: Float64Array
    apart: tuple[float, float]
    setting: tuple[float, float]
    free_steps: int


ALL_COUNT: Final = ChannelTrust(np.empty((0, 3), np.bool_), np.empty((0, 3)), (0.0, 1.0), (1.0, 0.0), 0)
"""No channel is hidden anywhere."""


def move_towards(
    skin: LampSkin, intensity: Float64Array, slope: Float64Array, z_px: Float64Array, before: KnownBefore, steps: int
) -> Float64Array:
    """Gauss-Newton steps from slopes (N, 2) towards those that explain intensities (N, 3): the new slopes.

    z_px : elevation, shape (N,)
    """
    return move_past_hidden(skin, intensity, slope, z_px, before, steps, ALL_COUNT)[0]


def move_past_hidden(
    skin: LampSkin,
    intensity: Float64Array,
    slope: Float64Array,
    z_px: Float64Array,
    before: KnownBefore,
    steps: int,
    trust: ChannelTrust,
) -> tuple[Float64Array, Float64Array]:
    """Slopes as of `move_towards` where lamps may be hidden, and how much channels counted in the last step, (N, 3).

    A channel that counts for less than the whole, and is darker than predicted, lacks its lamp's light, as others do as
    far as their filters pass it.
    """
    model = skin.model
    lamps = (*model.lamps_and_coat(), model.mixing, model.haze, np.array([model.bounce_afar, model.bounce_close]))
    places = model.places(skin.column, skin.row, z_px)
    found, weight = np.array(slope, np.float64, order="C"), np.ones_like(trust.counts)
    parallel_rows(
        write_search,
        (len(found), SEARCH_WORK * (1 + steps)),
        lamps,
        (*places, skin.rest, skin.shares, skin.close, arriving_or_all(skin.visible)),
        intensity,
        before.slope,
        (trust.hidden, trust.counts, trust.apart, trust.setting, trust.free_steps),
        (STEP, INTENSITY_SIGMA**-2, before.sigma**-2, MAX_MOVE),
        steps,
        found,
        weight,
    )
    return found, weight


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
        return move_towards(skin, seen, read, level, KnownBefore(read, SURFACE_SIGMA), READER_STEPS)

"""Forward model of a gel sensor: the intensity of every channel by slope, place and elevation of the skin.

The light of a few upright panels falls on a rough coat (Oren and Nayar, "Generalization of Lambert's reflectance
model", SIGGRAPH 1994) that scatters a part of it below its surface, with a glossy lobe (Walter et al., "Microfacet
models for refraction through rough surfaces", EGSR 2007), under a camera at a finite height. Skin around a place adds
one bounce (`kernels.incoming_light`). What sources cannot describe is a polynomial in the normal and in elevation whose
coefficients vary over the field; it is zero on level skin at rest. Intensity is divided by that of skin at rest, so
that neither vignetting nor the brightness of a source matters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from device.surface import Float64Array
from host_sync.kernels.parallel_rows import parallel_rows
from host_sync.light.kernels import write_light

ALONG: Final = ((-0.387, 5 / 18), (0.0, 8 / 18), (0.387, 5 / 18))
UPWARD: Final = ((-0.289, 0.5), (0.289, 0.5))
"""Gauss-Legendre points and weights along a length of 1, of a panel's length and height."""

POINTS: Final = np.array([(along, up) for along, _ in ALONG for up, _ in UPWARD])
POINT_WEIGHTS: Final = np.array([along * up for _, along in ALONG for _, up in UPWARD])
"""Of the points of a panel, shares of its length and height, and weights."""

NORMAL_ORDER: Final = 4
PLACE_ORDER: Final = 2
"""Orders of the residual field in the normal's horizontal components and in the place."""

ELEVATION: Final = 0.05
"""Elevation, in widths of the field, that counts as 1 in the residual field."""

BEYOND: Final = 0.05
"""Slope beyond the steepest of the balls, relative to it, at which the error of the intensity grows by half."""

Position = tuple[float, float, float]
"""Place of a source: right, down and up from the middle of the field on skin at rest, mm."""

DARK: Final = 0.01
"""Light of skin at rest, relative to the median over the field, below which a place counts as dark."""

WORK: Final = 64
"""Pixels of a field whose kernels take as long as the light of one place."""


@dataclass(frozen=True)
class LightModel:
    """Sources, coat and residual field of a sensor with C channels; lengths in widths of the field.

    shape : (H, W) of the full-size field, pixels
    sources : float64 array of shape (S, 5): right, down and up from the middle of skin at rest to the middle of a
        panel, its length, and its own height relative to its elevation
    strengths : float64 array of shape (C, S), brightness of every source in each channel
    haze : float64 array of shape (C,), light that does not depend on the slope
    albedo : fraction of light from skin around a place that the place reflects
    fall_off : power of the distance with which light decreases
    roughness : of the coat, standard deviation of its facets' slopes, radians
    gloss, gloss_width, tail : fraction of glossy reflection, width of its lobe (microfacets' alpha), decay of its tail
    tilt_gain : relative gain of intensity with 1 - cos(tilt)
    beam : fraction of a source's light that follows the cosine from its axis, which meets the middle of the field
    camera : one over the camera's height over the middle of the field; 0 for a distant camera
    scattering : fraction of matt reflection by single scattering below the surface, in proportion to the cosine to the
        light over the sum of the cosines to light and camera (Seeliger, 1888)
    residual : float64 array of shape (C, terms, places)
    sigma, source_sigma : float64 arrays of shape (C,), root mean square errors of the intensity on held-out balls, and
        those without the residual field
    steepest : slope up to which balls were seen
    """

    shape: tuple[int, int]
    sources: Float64Array
    strengths: Float64Array
    haze: Float64Array
    albedo: float
    fall_off: float
    roughness: float
    gloss: float
    gloss_width: float
    tail: float
    tilt_gain: float
    beam: float
    camera: float
    scattering: float
    residual: Float64Array
    sigma: Float64Array
    source_sigma: Float64Array
    steepest: float

    def light(
        self, p: Float64Array, q: Float64Array, x: Float64Array, y: Float64Array, z: Float64Array
    ) -> Float64Array:
        """Return the light that every source adds: float64 array of shape (N, S).

        p, q : slopes, shape (N,)
        x, y, z : places in widths of the field from its middle at rest, shape (N,)
        """
        out = np.empty((len(x), len(self.sources)))
        skin = [np.ascontiguousarray(part, np.float64) for part in (p, q, x, y, z)]
        parallel_rows(write_light, (len(out), WORK), *self.geometry, self.coat, *skin, out)
        return out

    def rest(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """Return the light of skin at rest: shape (N, C)."""
        level = np.zeros_like(x)
        return self.mixed(self.light(level, level, x, y, level))

    @property
    def lights_field(self) -> bool:
        """True where no channel leaves a part of the field dark, as no reference does."""
        across, down = (part.ravel() for part in np.meshgrid(*(np.linspace(-0.5, 0.5, 9),) * 2))
        rest = self.rest(across, down * self.shape[0] / self.shape[1])
        return bool((rest > DARK * np.median(rest, axis=0)).all())

    def mixed(self, light: Float64Array) -> Float64Array:
        """Return what every channel shows of the sources' light (N, S): shape (N, C)."""
        return np.asarray(light @ self.strengths.T + self.haze)

    def intensity(
        self,
        slope: Float64Array,
        places: tuple[Float64Array, Float64Array, Float64Array],
        incoming: Float64Array,
    ) -> Float64Array:
        """Return the intensity of unshaded skin over that of skin at rest: shape (N, C).

        slope : shape (N, 2)
        places : see `places`
        incoming : light from skin around (`kernels.incoming_light`) over the light at rest, shape (N, C)
        """
        p, q = slope.T
        x, y, z = places
        direct = self.mixed(self.light(p, q, x, y, z)) / self.rest(x, y)
        coefficients = self.residual_at(x, y)
        left = np.einsum("ncm,nm->nc", coefficients, residual_terms(p, q, z))
        return np.asarray(direct + self.albedo * incoming + left)

    def elevated(
        self, slope: Float64Array, places: tuple[Float64Array, Float64Array, Float64Array], z: Float64Array
    ) -> Float64Array:
        """Return what the sources' light gains where skin has an elevation z (N,) instead of that of `places`: (N, C).

        slope, places : see `intensity`
        """
        p, q = slope.T
        x, y, below = places
        change = (self.light(p, q, x, y, z) - self.light(p, q, x, y, below)) @ self.strengths.T
        return np.asarray(change / self.rest(x, y))

    def residual_at(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """Return the residual's coefficients at places: shape (N, C, terms)."""
        flat = self.residual.reshape(-1, self.residual.shape[-1])
        return np.asarray(place_terms(x, y, self.shape) @ flat.T).reshape(-1, *self.residual.shape[:2])

    def residual_gain(
        self, slope: Float64Array, places: tuple[Float64Array, Float64Array, Float64Array], spread: Float64Array
    ) -> Float64Array:
        """Return what the mean of the residual over normals gains by their covariance, to second order: (N, C).

        slope : of the mean normal, shape (N, 2)
        places : see `places`
        spread : covariance of the normals, shape (N, 3), see `slopes_hidden_by_means`
        """
        up = 1.0 / np.sqrt(1.0 + np.square(slope).sum(axis=1))
        across, down = -slope[:, 0] * up, -slope[:, 1] * up
        gain = np.zeros((len(slope), len(MONOMIALS)))
        for term, (i, j) in enumerate(MONOMIALS):
            second = (
                (i * (i - 1), i - 2, j, 0.5), (i * j, i - 1, j - 1, 1.0), (j * (j - 1), i, j - 2, 0.5)
            )  # fmt: skip
            for part, (factor, k, m, half) in enumerate(second):
                if factor:
                    gain[:, term] += half * factor * across**k * down**m * spread[:, part]
        return np.asarray(np.einsum("ncm,nm->nc", self.residual_at(*places[:2])[..., :-1], gain))

    def places(
        self, column: Float64Array, row: Float64Array, z_px: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return places x, y and z, shape (N,), of pixels at an elevation over skin at rest."""
        rows, columns = self.shape
        return (column - 0.5 * (columns - 1)) / columns, (row - 0.5 * (rows - 1)) / columns, z_px / columns

    def variance(self, slope: Float64Array) -> Float64Array:
        """Return the variance of the predicted intensity of slopes (N, 2), which grows beyond the balls': (N, C)."""
        beyond = np.maximum(np.linalg.norm(slope, axis=1) / self.steepest - 1.0, 0.0) / BEYOND
        return np.asarray((1.0 + beyond[:, None] ** 2) * self.sigma**2)

    def uncertain_fraction(self, prior_sigma: float) -> float:
        """Return how much of errors of slopes known to `prior_sigma` remains, on the mean over the field."""
        return float((1.0 / (1.0 + self.information * prior_sigma**2)).mean())

    def believed_fraction(self, prior_sigma: float) -> float:
        """Return how much of errors of slopes known to `prior_sigma` the sources alone take away."""
        return 1.0 - self._sources_alone.uncertain_fraction(prior_sigma)

    @cached_property
    def _sources_alone(self) -> LightModel:
        """The model without its residual field, whose errors are those of the sources."""
        return replace(self, sigma=self.source_sigma, residual=np.zeros_like(self.residual))

    @cached_property
    def information(self) -> Float64Array:
        """One over the variance of a slope component by intensity, over places and directions: shape (N,)."""
        rows, columns = self.shape
        angle = np.arange(8) * (np.pi / 4)
        across, down, turn = (part.ravel() for part in np.meshgrid((0.2, 0.5, 0.8), (0.2, 0.5, 0.8), angle))
        places = self.places(across * columns, down * rows, np.zeros_like(turn))
        slope = 0.3 * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        level = np.zeros((len(turn), len(self.sigma)))
        here = self.intensity(slope, places, level)
        moved = [self.intensity(slope + step, places, level) - here for step in ((0.01, 0.0), (0.0, 0.01))]
        return np.asarray(np.square(np.array(moved) / (0.01 * self.sigma)).sum(axis=-1).mean(axis=0))

    @cached_property
    def geometry(self) -> tuple[Float64Array, Float64Array]:
        """Points (S, points, 4), places and brightness, and axes (S, 3) of the sources."""
        return source_points(self.sources, self.fall_off)

    @cached_property
    def coat(self) -> Float64Array:
        """Numbers of the coat as kernels read them: shape (10,).

        They are fall-off, even and uneven part of the rough coat, gloss, squared width, tail, tilt gain, beam, camera
        and scattering.
        """
        square = self.roughness**2
        even, uneven = 1.0 - 0.5 * square / (square + 0.33), 0.45 * square / (square + 0.09)
        shine = (self.gloss, self.gloss_width**2, self.tail)
        return np.array([self.fall_off, even, uneven, *shine, self.tilt_gain, self.beam, self.camera, self.scattering])


def source_points(sources: Float64Array, fall_off: float) -> tuple[Float64Array, Float64Array]:
    """Return points, places and brightness, shape (S, points, 4), and axes, shape (S, 3), of panels (S, 5)."""
    place, length, height = sources[:, :3], sources[:, 3], sources[:, 4]
    reach = np.maximum(np.hypot(place[:, 0], place[:, 1]), 1e-6)
    along = np.stack([-place[:, 1] / reach, place[:, 0] / reach, np.zeros_like(reach)], axis=-1) * length[:, None]
    points = place[:, None] + POINTS[:, :1] * along[:, None]
    points[..., 2] *= 1.0 + POINTS[:, 1] * height[:, None]
    distance = np.linalg.norm(place, axis=1)
    bright = POINT_WEIGHTS * distance[:, None] ** fall_off
    return np.concatenate([points, bright[..., None]], axis=-1), place / distance[:, None]


def residual_terms(p: Float64Array, q: Float64Array, z: Float64Array) -> Float64Array:
    """Return products of the normal's horizontal components up to `NORMAL_ORDER`, and elevation: shape (N, terms)."""
    up = 1.0 / np.sqrt(1.0 + p * p + q * q)
    across, down = (np.vander(part * up, NORMAL_ORDER + 1, increasing=True).T for part in (-p, -q))
    return np.stack([*(across[i] * down[j] for i, j in MONOMIALS), z / ELEVATION], axis=-1)


def place_terms(x: Float64Array, y: Float64Array, shape: tuple[int, int]) -> Float64Array:
    """Return products of places, from -1 to 1 over the field, up to `PLACE_ORDER`: shape (N, places)."""
    places = 2.0 * x, 2.0 * y * shape[1] / shape[0]
    across, down = (np.vander(part, PLACE_ORDER + 1, increasing=True).T for part in places)
    orders = [(i, j) for i in range(PLACE_ORDER + 1) for j in range(PLACE_ORDER + 1 - i)]
    return np.stack([across[i] * down[j] for i, j in orders], axis=-1)


MONOMIALS: Final = tuple((i, j) for i in range(NORMAL_ORDER + 1) for j in range(NORMAL_ORDER + 1 - i) if i + j)
TERMS: Final = len(MONOMIALS) + 1
PLACES: Final = (PLACE_ORDER + 1) * (PLACE_ORDER + 2) // 2

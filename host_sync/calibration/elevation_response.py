"""How skin looks when it stands higher than untouched skin, so that one colour means another slope.

Under any lights a matt skin of slope g at the elevation z shows, divided by its reference and times s = √(1 + |g|²),

    s I = 1 + a·g + z (b + c·g)

with a the light's direction on untouched skin, b how its brightness and c how its slant grow with elevation. Away from
its sources light has no divergence, and that of small sources no curl, so that all three follow from how a and the
reference's light R change over the field:

    b = div a + a·∇ ln R,        c = −∇ ln R.

Nothing is assumed of positions, number and mixture of the lights. What the camera sees of R is also vignetted, which
changes b and c by w = ∇ ln V, alike in all channels: b by a·w. A tilt changes the colours in the same way, so that b
falls into a part that is a common brightening, which vignetting and a ball's wrong centre leave alone, and a part that
is like a tilt. The first is the evidence: at the apexes of balls the skin is level and high. Measured brightening
against that which R predicts gives the share of it that is there; a share that cannot be told apart from zero means
that nothing is known, and nothing is corrected. The second is read from the apexes alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from device.balls.sphere import Ball, pixels_inside, sphere_slopes
from device.imaging.flat_field import DARK_FLOOR, NormalizedImage
from device.inverse_map.illumination import between_nodes
from device.inverse_map.near_light import CUBIC_DOUBT, GENTLE, OLD_PLACE_DEGREE, PLACE_DEGREE
from device.inverse_map.polynomial_features import field_position, monomials, position_exponents
from device.surface.fields import Float32Array, Float64Array

MIN_BALLS: Final = 8
"""Balls from which directions of degree 2 in place, and what elevation adds, can be told."""

MIN_PIXELS: Final = 60
"""Gentle pixels of one ball: ten numbers are fitted to them."""

CERTAIN: Final = 4.0
"""Standard uncertainties by which the confirmed share must differ from zero.

Lights that are far show shares of some thousandths, so that this asks how well the correction is known: it is to leave
little of the effect. On rendered lights at 300 to 800 pixels shares are known to a twelfth to a quarter, and errors of
heights fall to a half.
"""

LIKELY: Final = 2.0
"""The same, for a response by which centres are moved once more: better centres make it better known."""

CONFIRMED: Final = (0.3, 3.0)
"""Shares outside of which what is seen is something else than elevation under near lights."""

MAX_SHARE: Final = 1.5
"""Share up to which slants grow with it. On six rendered benches with shares of 1.1 to 1.5 features are 1.4 % off with
it (geometric mean; 2.1 % when slants were held to what was predicted), and a wave of 80 px keeps its gain."""

SHARE_DOUBT: Final = 0.5
"""Relative standard uncertainty of slants for each unit by which the share is not 1."""

UNEXPLAINED: Final = 0.1
"""Share from which something is seen of elevation. Sensors whose light knows none show 0.00 to 0.02, the twin's coat of
flakes 0.20."""

LAMPS_DOUBT: Final = 0.5
"""Relative standard uncertainty of slants of a skin that is not matt, taken as under lamps of one height.

The twin's flat tops under a coat of flakes are 6 % too low without and, at the lamps' true height, 4 % too high with
them.
"""

CLEAR: Final = 8.0
"""Standard uncertainties by which such a skin's share must differ from zero.

28 under flakes, 3 to 4 on two real sensors that show shares of 0.4 and 6.8, which nothing confirms.
"""

MODEL_DOUBT: Final = 0.15
"""Standard uncertainty of slants that were predicted: skins are not matt, and beams are narrower than a lamp's."""

BRIGHTENING_DEGREE: Final = 2
"""Degree in position of the common part of b."""

TILT_DEGREE: Final = 1
BENT_TILT_DEGREE: Final = 2
MIN_BALLS_BENT: Final = 12
"""Degrees of the part of b that is like a tilt; the second from so many balls on, as a plane leaves a third of it."""

LIGHT_DEGREE: Final = 4
"""Degree in position of ln R; directions have that of `device.inverse_map.near_light`."""

CHANGE_DOUBT: Final = 4.0
"""Doubt of how directions change over the field, over doubt of directions themselves.

On four rendered benches balls that are left out differ by 0.14 to 0.31 of the spread, and what the directions' changes
do to a centre is up to twice what is right: followed to the end, it moves corner balls farther off than nothing does.
Point lamps over a matt skin differ by 0.02 and are followed.
"""

ROUNDS: Final = 3
"""Slants at the apexes are carried down to rest by the response that they give."""

NODES: Final = 33
"""Places along each side of the field at which the response is kept."""

LIGHT_STEP_PX: Final = 16
MIN_VOLUME: Final = 1e-3
"""Of three directions; below it the channels do not show two slopes and a brightness."""


@dataclass(frozen=True, slots=True, eq=False)
class ElevationResponse:
    """What one pixel of elevation changes, at places even over the field, borders included.

    directions : float32 array of shape (n, n, 2, 3), a by component and channel
    brightening : float32 array of shape (n, n, 3), b per pixel of elevation
    slanting : float32 array of shape (n, n, 2, 3), c per pixel of elevation
    share, share_sigma : of the predicted common brightening that is seen, and its standard uncertainty
    direction_doubt : error of directions at a ball that was left out, as a share of their spread over the field
    is_of_lamps : slants were not predicted by the light on untouched skin, but taken as under lamps of one height
    misread : float32 array of shape (n, n, 9), `as_slopes` as the inverse map itself reads raised skin; None where that
        is not known
    """

    directions: Float32Array
    brightening: Float32Array
    slanting: Float32Array
    share: float
    share_sigma: float
    direction_doubt: float = 0.0
    is_of_lamps: bool = False
    misread: Float32Array | None = None

    @property
    def followed(self) -> float:
        """Share of what place does to the light that is to be believed: its change is less well known than itself."""
        return 1.0 / (1.0 + (CHANGE_DOUBT * self.direction_doubt) ** 2)

    @property
    def is_certain(self) -> bool:
        """Whether elevation is told apart from none."""
        return self._differs_by(CERTAIN)

    @property
    def is_likely(self) -> bool:
        """Whether it is worth while to look for the balls' centres by it."""
        return self._differs_by(LIKELY)

    def _differs_by(self, sigmas: float) -> bool:
        confirmed = self.share > sigmas * self.share_sigma and CONFIRMED[0] < self.share < CONFIRMED[1]
        return confirmed and self.nearness_per_px > 0.0

    @property
    def relative_sigma(self) -> float:
        """Relative standard uncertainty of the share."""
        return self.share_sigma / max(abs(self.share), 1e-6)

    @property
    def is_of_another_skin(self) -> bool:
        """Whether what is seen of elevation is clear, but weaker than a matt skin would show it."""
        return self.share > CLEAR * self.share_sigma and UNEXPLAINED < self.share < CONFIRMED[0]

    def under_lamps(self, nearness_per_px: float) -> ElevationResponse:
        """The same directions and brightness with slants as under lamps that all stand at one height.

        nearness_per_px : one over that height
        """
        growth = np.float32(nearness_per_px) + self.brightening[..., None, :]
        return replace(self, slanting=self.directions * growth, is_of_lamps=True)

    @property
    def possible_fraction(self) -> float:
        """Share of the predicted that may be there where it is not certain, at most 1.

        A share that is neither near 0 nor near 1 says that light changes with elevation in another way: all of the
        predicted may be there.
        """
        if self.share > UNEXPLAINED:
            return 1.0
        return min(float(np.hypot(self.share, self.share_sigma)), 1.0)

    @property
    def as_slopes(self) -> Float32Array:
        """What elevation adds to a common brightness λ, p and q, each as factors of 1, p and q: shape (n, n, 9).

        b + c·g = λ (1 + a·g) + a·(what is added to g), for three channels.
        """
        if self.misread is not None:
            return self.misread
        ones = np.ones_like(self.brightening)
        system = np.stack([ones, self.directions[..., 0, :], self.directions[..., 1, :]], axis=-1)
        added = np.stack([self.brightening, self.slanting[..., 0, :], self.slanting[..., 1, :]], axis=-1)
        volume = np.linalg.det(system.astype(np.float64))
        safe = np.abs(volume) > MIN_VOLUME
        system = np.where(safe[..., None, None], system, np.eye(3))
        found = np.linalg.solve(system.astype(np.float64), added.astype(np.float64)) * safe[..., None, None]
        return np.asarray(found.reshape(*volume.shape, 9), np.float32)

    @property
    def nearness_per_px(self) -> float:
        """By what share a pixel of elevation makes light slant more, mean over the field; 1 / height of one lamp."""
        a, c = self.directions.astype(np.float64), self.slanting.astype(np.float64)
        square = (a**2).sum(axis=-2)
        return float(((a * c).sum(axis=-2) - self.brightening * square).sum() / square.sum())

    @property
    def nearness_sigma_per_px(self) -> float:
        """Standard uncertainty of `nearness_per_px`: what a correction leaves of slants that were predicted."""
        if self.is_of_lamps:
            return LAMPS_DOUBT * abs(self.nearness_per_px)
        a, c = self.directions.astype(np.float64), self.slanting.astype(np.float64)
        slant = abs(float((a * c).sum() / (a**2).sum()))
        off = SHARE_DOUBT * (min(self.share, MAX_SHARE) - 1.0) if self.share > 1.0 else 0.0
        return slant * float(np.linalg.norm([self.relative_sigma, MODEL_DOUBT, off]))


@dataclass(frozen=True, slots=True, eq=False)
class _Apexes:
    """What each ball shows at its apex.

    brightening : float64 array of shape (N, 3), intensity less 1 per pixel of elevation
    slants : float64 array of shape (N, 2, 3), what slopes do to intensity at that elevation
    place : float64 array of shape (N, 2), position variables
    elevation_px : float64 array of shape (N,)
    """

    brightening: Float64Array
    slants: Float64Array
    place: Float64Array
    elevation_px: Float64Array


def measure_elevation_response(
    balls: Sequence[tuple[NormalizedImage, Ball, float]], flat_field: Float32Array
) -> ElevationResponse | None:
    """The response that balls show; None where too few show enough.

    balls : the press, the ball with a centre that was not read from its colours, and its apex over untouched skin, px
    flat_field : float32 array of shape (H, W, 3), the reference's light
    """
    apexes = _apexes(balls)
    if apexes is None:
        return None
    light = _light(flat_field)
    response = None
    for _ in range(ROUNDS):
        response = _response(apexes, response, light, (flat_field.shape[0], flat_field.shape[1]))
        if response is None or not response.is_likely:
            break
    return response


def _response(
    apexes: _Apexes, before: ElevationResponse | None, light: Float64Array, shape: tuple[int, int]
) -> ElevationResponse | None:
    """The response that apexes show; None where three channels do not tell two slopes.

    before : by which the slants that apexes show are carried down to rest
    """
    slants = apexes.slants
    if before is not None:
        added = between_nodes(before.slanting.reshape(NODES, NODES, 6), apexes.place).reshape(-1, 2, 3)
        slants = slants - apexes.elevation_px[:, None, None] * added
    directions = _fitted(slants.reshape(-1, 6), apexes.place, PLACE_DEGREE).reshape(-1, 2, 3)
    doubt = _left_out_error(slants.reshape(-1, 6), apexes.place, PLACE_DEGREE)
    here = _predicted(directions, light, apexes.place, shape)
    if np.abs(np.linalg.det(_system(here.directions))).min() < MIN_VOLUME:
        return None
    seen, predicted = (_parts(here.directions, b) for b in (apexes.brightening, here.brightening))
    power = max(float((predicted[:, 0] ** 2).sum()), 1e-30)
    share = float((seen[:, 0] * predicted[:, 0]).sum()) / power
    left = seen[:, 0] - share * predicted[:, 0]
    sigma = float(np.sqrt((left**2).sum() / (len(left) - 1) / power))
    common = _fitted(seen[:, :1], apexes.place, BRIGHTENING_DEGREE)
    degree = BENT_TILT_DEGREE if len(seen) >= MIN_BALLS_BENT else TILT_DEGREE
    tilt = _fitted(seen[:, 1:], apexes.place, degree)
    vignetting = _fitted(seen[:, 1:] - share * predicted[:, 1:], apexes.place, TILT_DEGREE)
    side = np.linspace(-1.0, 1.0, NODES)
    nodes = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    there = _predicted(directions, light, nodes, shape)
    parts = np.concatenate([monomials(nodes, BRIGHTENING_DEGREE) @ common, monomials(nodes, degree) @ tilt], 1)
    brightening = np.einsum("nkc,nc->nk", _system(there.directions), parts)
    # Derivatives of smooth polynomials are too small: what is seen over what was predicted tells by how much.
    vignetted = (monomials(nodes, TILT_DEGREE) @ vignetting)[:, :, None]
    slanting = min(share, MAX_SHARE) * (there.slanting - vignetted / share) if share > 0.0 else 0.0 * there.slanting
    return ElevationResponse(
        there.directions.reshape(NODES, NODES, 2, 3).astype(np.float32),
        brightening.reshape(NODES, NODES, 3).astype(np.float32),
        slanting.reshape(NODES, NODES, 2, 3).astype(np.float32),
        share,
        sigma,
        doubt,
    )


def _fitted(values: Float64Array, place: Float64Array, degree: int) -> Float64Array:
    """Coefficients (terms, C) of the polynomial in place through values (N, C)."""
    design, wanted = _equations(values, place, degree)
    return np.asarray(np.linalg.lstsq(design, wanted, rcond=None)[0])


def _left_out_error(values: Float64Array, place: Float64Array, degree: int) -> float:
    """Root mean square error of the same polynomial at a place left out of it, over the spread of the values."""
    design, wanted = _equations(values, place, degree)
    inverse = np.linalg.pinv(design)
    leverage = np.einsum("nk,kn->n", design, inverse)[: len(values), None]
    left = (values - (design @ (inverse @ wanted))[: len(values)]) / np.maximum(1.0 - leverage, 1e-3)
    spread = values - values.mean(axis=0)
    return float(np.sqrt((left**2).sum() / max(float((spread**2).sum()), 1e-30)))


def _equations(values: Float64Array, place: Float64Array, degree: int) -> tuple[Float64Array, Float64Array]:
    """Monomials at places and the values, and below both what holds back terms of high degree."""
    dear = np.array([CUBIC_DOUBT * (i + j > OLD_PLACE_DEGREE) for i, j in position_exponents(degree)])
    design = np.concatenate([monomials(place, degree), np.diag(dear)])
    return design, np.concatenate([values, np.zeros((len(dear), values.shape[1]))])


def _apexes(balls: Sequence[tuple[NormalizedImage, Ball, float]]) -> _Apexes | None:
    """What each ball shows around its apex; None where too few balls show enough."""
    brightening, slants, place, elevation_px = [], [], [], []
    for image, ball, apex_px in balls:
        row, column = pixels_inside(ball, image.shape)
        p, q = (s.astype(np.float64) for s in sphere_slopes(ball, column.astype(np.float32), row.astype(np.float32)))
        gentle = image.faithful_at((row, column)) & (np.hypot(p, q) < GENTLE)
        if gentle.sum() < MIN_PIXELS:
            continue
        p, q = p[gentle], q[gentle]
        # Higher powers take up what is no plane: the skin's own law, and that the ball falls away from its apex.
        terms = np.stack([p**i * q**j for i, j in ((0, 0), (1, 0), (0, 1))], axis=-1)
        bends = np.stack([p**i * q**j for i, j in position_exponents(3) if i + j > 1], axis=-1)
        lit = image.values[row[gentle], column[gentle]] * np.sqrt(1.0 + p**2 + q**2)[:, None]
        found = np.linalg.lstsq(np.concatenate([terms, bends], axis=-1), lit.astype(np.float64), rcond=None)[0]
        brightening.append((found[0] - 1.0) / apex_px)
        slants.append(found[1:3])
        elevation_px.append(apex_px)
        place.append(field_position(np.array([ball.column]), np.array([ball.row]), image.shape)[0])
    if len(place) < MIN_BALLS:
        return None
    return _Apexes(np.stack(brightening), np.stack(slants), np.stack(place), np.array(elevation_px))


@dataclass(frozen=True, slots=True, eq=False)
class _Predicted:
    """a (N, 2, 3), b (N, 3) and c (N, 2, 3) at places of the field, but for vignetting."""

    directions: Float64Array
    brightening: Float64Array
    slanting: Float64Array


def _predicted(
    directions: Float64Array, light: Float64Array, place: Float64Array, shape: tuple[int, int]
) -> _Predicted:
    a = np.einsum("nk,kdc->ndc", monomials(place, PLACE_DEGREE), directions)
    across, down = _derivatives(place, PLACE_DEGREE, shape)
    spreading = across @ directions[:, 0] + down @ directions[:, 1]
    ramp = np.stack([part @ light for part in _derivatives(place, LIGHT_DEGREE, shape)], axis=1)
    return _Predicted(a, spreading + (a * ramp).sum(axis=1), -ramp)


def _light(flat_field: Float32Array) -> Float64Array:
    """ln R as a polynomial in place: float64 array of shape (terms, 3)."""
    step = max(1, min(LIGHT_STEP_PX, min(flat_field.shape[:2]) // 16))
    sample = cv2.blur(flat_field, (step, step))[step // 2 :: step, step // 2 :: step]
    row, column = np.mgrid[: sample.shape[0], : sample.shape[1]] * step + step // 2
    place = field_position(column.ravel().astype(np.float64), row.ravel().astype(np.float64), flat_field.shape[:2])
    logarithm = np.log(np.maximum(sample.reshape(-1, 3).astype(np.float64), DARK_FLOOR))
    return np.asarray(np.linalg.lstsq(monomials(place, LIGHT_DEGREE), logarithm, rcond=None)[0])


def _derivatives(place: Float64Array, degree: int, shape: tuple[int, int]) -> tuple[Float64Array, Float64Array]:
    """Derivatives of the monomials of place by column and by row, per pixel: float64 arrays of shape (N, terms)."""
    x, y = place.T
    terms = position_exponents(degree)
    across = np.stack([i * x ** max(i - 1, 0) * y**j for i, j in terms], axis=-1)
    down = np.stack([j * x**i * y ** max(j - 1, 0) for i, j in terms], axis=-1)
    return across * (2.0 / shape[1]), down * (2.0 / shape[0])


def _system(directions: Float64Array) -> Float64Array:
    """(N, channels, 3): what a common brightness, p and q do to each channel."""
    return np.stack([np.ones_like(directions[:, 0]), directions[:, 0], directions[:, 1]], axis=-1)


def _parts(directions: Float64Array, brightening: Float64Array) -> Float64Array:
    """b (N, 3) as a common brightening and what is like a tilt p, q: float64 array of shape (N, 3)."""
    return np.asarray(np.linalg.solve(_system(directions), brightening[..., None])[..., 0])

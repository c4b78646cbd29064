"""Balls of calibration presses as they would look at the elevation of untouched skin.

A ball's apex stands high over the skin, its rim lower. Used for training as they are, such colours would be read as
slopes of skin that stands as high. So the intensity inside each contact is changed to what the same slopes would show
on untouched skin, by the response that the balls themselves tell (`elevation_response`).

Centres: under near lights the apex does not read 1, and a centre that is sought where it does is off by up to seven
hundredths of the radius. Rotational symmetry of the pressed skin does not know of brightness, but where the frame's
border cuts the slope around a ball it is off by as much as eight: where balls agree clearly better on what elevation
does under their own centres, those are taken, moved by what symmetry shows of all balls together (`centre_trend`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np

from device.balls.candidates import ReducedIntensity, reduce_intensity
from device.balls.detector import REFINE_RADIUS_PX
from device.balls.refinement import find_circle
from device.balls.sphere import Ball, pixels_inside, sphere_slopes
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.illumination import between_nodes, rows_between_nodes
from device.inverse_map.model import InverseMap
from device.inverse_map.polynomial_features import field_position
from device.surface.fields import Float32Array, GradientField
from host_sync.calibration.centre_trend import centres_along_trend
from host_sync.calibration.elevation_response import MIN_BALLS, ElevationResponse, measure_elevation_response
from host_sync.calibration.lamp_centres import centres_under_lamps
from host_sync.gradients.cell_slopes import cell_slopes
from host_sync.integration.zero_level import elevation_over_datum_px
from host_sync.kernels.cell_rows import middles_of_cells
from host_sync.lights.known_lamps import KnownLamps
from host_sync.lights.lamp_model import FittedLamps, LampModel
from host_sync.uncertainty.elevation import ElevationCorrection, apex_in_cells_px

MAX_CELL_PX: Final = 4
MIN_CELLS_ALONG_RADIUS: Final = 25.0
"""Cells of so many pixels at most, so many along a ball's radius at least, tell where it stands."""

ROUNDS: Final = 3
"""Elevations and centres need the response, and the response them; the last round moves them by a per cent."""

OWN_AGREE: Final = 0.85
"""The balls' own centres are taken where they leave the response so much less uncertain than those of symmetry.

The ratio is 0.3 to 0.77 on the twin, where JPEG, flakes and shadows spoil symmetry and own centres are within 2.5 px of
the truth. It is 0.93 and more on rendered benches but one.
"""

NEAR_CENTRE: Final = 0.2
"""A centre of symmetry farther from a ball's own, as a share of its radius, is another thing's."""

Press = tuple[NormalizedImage, Sequence[Ball]]


@dataclass(frozen=True, slots=True, eq=False)
class ElevatedBalls:
    """Balls of a calibration, where they stand, and what that changes.

    response : what elevation changes
    balls : by press, with centres of symmetry, their own, or where lamps put them
    apexes_px : by press, elevation of each ball's apex over untouched skin, pixels
    lamps : that explain what the balls show; without them what is seen of elevation says all
    """

    response: ElevationResponse
    balls: tuple[tuple[Ball, ...], ...]
    apexes_px: tuple[tuple[float, ...], ...]
    lamps: FittedLamps | None = None

    @property
    def left(self) -> ElevationCorrection:
        """At which elevation the balls showed each slope, and how uncertain the nearness is that was corrected for."""
        apexes_px = [apex_px for of_press in self.apexes_px for apex_px in of_press]
        radii_px = [ball.radius_px for of_press in self.balls for ball in of_press]
        response = self.response
        sigma = response.nearness_sigma_per_px
        if self.lamps is not None:
            sigma = response.share_sigma * abs(response.nearness_per_px)
        return ElevationCorrection(float(np.median(apexes_px)), float(np.median(radii_px)), sigma)

    def followed(self, nearness_per_px: float, *, is_matt: bool) -> ElevatedBalls | None:
        """What slopes are to be corrected by; None where nothing is seen of elevation.

        nearness_per_px : one over the lights' height, which counts where the skin is not matt
        is_matt : whether the skin shines as the slants of a response take for granted
        """
        if self.lamps is not None or (self.response.is_certain and is_matt):
            return self
        if (self.response.is_certain or self.response.is_of_another_skin) and nearness_per_px > 0.0:
            return replace(self, response=self.response.under_lamps(nearness_per_px))
        return None

    def lowered(self, press: int, image: NormalizedImage) -> NormalizedImage:
        """The image of a press with each contact as it would look at the elevation of untouched skin."""
        values = image.values.copy()
        for ball, apex_px in zip(self.balls[press], self.apexes_px[press], strict=True):
            _lower(values, ball, apex_px, self.response if self.lamps is None else self.lamps.model)
        return replace(image, values=values)


def find_elevated_balls(
    presses: Sequence[Press], inverse: InverseMap, flat_field: Float32Array, lamps: KnownLamps | None = None
) -> ElevatedBalls | None:
    """The balls of presses as symmetry and heights show them; None where they are too few to tell what elevation does.

    inverse : a map trained on the balls as they are; its heights are good to some per cent
    flat_field : float32 array of shape (H, W, 3), the reference's light
    lamps : take their bias out of the balls' own centres; None where nobody knows them
    """
    every = [ball for _, of_press in presses for ball in of_press]
    if len(every) < MIN_BALLS:
        return None
    radius_px = float(np.median([ball.radius_px for ball in every]))
    reliefs = [_Relief.of(image, inverse, _cell_px(radius_px)) for image, _ in presses]
    reduced = [reduce_intensity(image, radius_px / REFINE_RADIUS_PX) for image, _ in presses]

    def own(_skins: Sequence[_Skin], _response: ElevationResponse | None) -> Centred:
        return tuple(tuple(of_press) for _, of_press in presses)

    def lit(skins: Sequence[_Skin], _response: ElevationResponse | None) -> Centred:
        apexes_px = [[skin.apex_px(ball) for ball in balls] for skin, (_, balls) in zip(skins, presses, strict=True)]
        return own(skins, None) if lamps is None else centres_under_lamps(presses, apexes_px, lamps)

    def symmetric(skins: Sequence[_Skin], response: ElevationResponse | None) -> Centred:
        lit = _Lit.of(response, skins[0]) if response else None
        return tuple(
            tuple(_centred(seen, skin, ball, lit) for ball in of_press)
            for seen, skin, (_, of_press) in zip(reduced, skins, presses, strict=True)
        )

    as_they_are, as_symmetry_says = (_elevated(presses, reliefs, flat_field, centres) for centres in (own, symmetric))
    if as_they_are is None or as_symmetry_says is None:
        return as_they_are or as_symmetry_says
    # Judged before lamps move own centres: moving them shrinks the response as much as its uncertainty.
    own_agree = as_they_are.response.relative_sigma < OWN_AGREE * as_symmetry_says.response.relative_sigma
    if not own_agree:
        return as_symmetry_says
    if as_they_are.response.is_certain and lamps is not None:
        as_they_are = _elevated(presses, reliefs, flat_field, lit)
        if as_they_are is None:
            return as_symmetry_says
    along = centres_along_trend(as_they_are.balls, as_symmetry_says.balls, presses[0][0].shape)
    if along is None:
        return as_they_are
    return _elevated(presses, reliefs, flat_field, lambda _skins, _response: along)


Centred = tuple[tuple[Ball, ...], ...]
"""The balls of every press."""


def _elevated(
    presses: Sequence[Press],
    reliefs: Sequence[_Relief],
    flat_field: Float32Array,
    centres: Callable[[Sequence[_Skin], ElevationResponse | None], Centred],
) -> ElevatedBalls | None:
    """The balls where `centres` puts them, by skins and the response so far, and what elevation does to those."""
    images = [image for image, of_press in presses for _ in of_press]
    radius_px = float(np.median([ball.radius_px for _, of_press in presses for ball in of_press]))
    trained, found = ElevationCorrection(0.0, radius_px, 0.0), None
    for _ in range(ROUNDS):
        skins = [relief.at(trained) for relief in reliefs]
        balls = centres(skins, found.response if found else None)
        apexes = tuple(
            tuple(skin.apex_px(ball) for ball in of_press) for skin, of_press in zip(skins, balls, strict=True)
        )
        centred = [ball for of_press in balls for ball in of_press]
        heights = [apex_px for of_press in apexes for apex_px in of_press]
        response = measure_elevation_response(list(zip(images, centred, heights, strict=True)), flat_field)
        found = ElevatedBalls(response, balls, apexes) if response else None
        if response is None or not response.is_likely:
            break
        trained = ElevationCorrection(float(np.median(heights)), radius_px, response.nearness_per_px)
    return found


def _cell_px(radius_px: float) -> int:
    """Pixels along the cells that tell the relief of a ball of this radius."""
    return int(np.clip(radius_px / MIN_CELLS_ALONG_RADIUS, 1, MAX_CELL_PX))


@dataclass(frozen=True, slots=True, eq=False)
class _Skin:
    """The skin of a press in cells of `cell` pixels: slopes and elevation, shape (h, w)."""

    p: Float32Array
    q: Float32Array
    z_px: Float32Array
    cell: int
    shape: tuple[int, int]

    def apex_px(self, ball: Ball) -> float:
        """Elevation of a ball's apex, pixels: that over its own contact's rim at least."""
        return apex_in_cells_px(self.z_px, ball, self.cell)

    def as_lit_at(self, ball: Ball, lit: _Lit) -> Float32Array:
        """What is to be added to intensity, (h, w, 3), were all skin untouched and lit as the middle of a ball is."""
        middle = field_position(np.array([ball.column]), np.array([ball.row]), self.shape)
        there = between_nodes(lit.nodes, middle)[0]
        a, b, c = lit.directions, lit.brightening, lit.slanting
        p, q, z_px = self.p[..., None], self.q[..., None], self.z_px[..., None]
        wanted = 1.0 + there[:3] * p + there[3:] * q
        seen = 1.0 + a[..., :3] * p + a[..., 3:] * q + z_px * (b + c[..., :3] * p + c[..., 3:] * q)
        change = np.maximum(wanted, 0.0) - np.maximum(seen, 0.0)
        return np.asarray(change / np.sqrt(1.0 + p**2 + q**2), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Lit:
    """A response at the pixels of a skin, (h, w, 6), (h, w, 3) and (h, w, 6): alike for all presses of one grid.

    nodes : the first of them where it was measured
    followed : share of the response that is taken out
    """

    directions: Float32Array
    brightening: Float32Array
    slanting: Float32Array
    nodes: Float32Array
    followed: float

    @classmethod
    def of(cls, response: ElevationResponse, skin: _Skin) -> _Lit:
        row, column = middles_of_cells(skin.z_px.shape, skin.cell)
        x, y = (field_position(axis, axis, skin.shape)[:, k].astype(np.float32) for k, axis in enumerate((column, row)))
        nodes = _flat_nodes(response)
        a, b, c = (rows_between_nodes(part, x, y) for part in nodes)
        return cls(a, b, c, nodes[0], response.followed)


@dataclass(frozen=True, slots=True, eq=False)
class _Relief:
    """Slopes of a press as a map reads them in cells of `cell` pixels, and the elevation they add up to, (h, w)."""

    gradients: GradientField
    z_px: Float32Array
    cell: int
    shape: tuple[int, int]

    @classmethod
    def of(cls, image: NormalizedImage, inverse: InverseMap, cell: int) -> _Relief:
        gradients = cell_slopes(image, inverse, cell)
        return cls(gradients, elevation_over_datum_px(gradients, float(cell)), cell, image.shape)

    def at(self, trained: ElevationCorrection) -> _Skin:
        """The skin, where slopes are read right at the elevation of the training balls."""
        found = self.gradients
        if trained.nearness_per_px == 0.0:
            return _Skin(found.p, found.q, self.z_px, self.cell, self.shape)
        share = trained.steeper(self.z_px, found.p**2 + found.q**2)
        right = replace(found, p=found.p - share * found.p, q=found.q - share * found.q)
        return _Skin(right.p, right.q, elevation_over_datum_px(right, float(self.cell)), self.cell, self.shape)


def _centred(reduced: ReducedIntensity, skin: _Skin, ball: Ball, lit: _Lit | None) -> Ball:
    """The ball at the centre of the pressed skin's rotational symmetry; its own where none is near.

    lit : takes what light makes of elevation and place, which is not symmetric, out of the intensity
    """
    if lit is not None:
        size = reduced.weight.shape[::-1]
        change = cv2.resize(skin.as_lit_at(ball, lit), size, interpolation=cv2.INTER_LINEAR)
        reduced = replace(reduced, deviation=reduced.deviation + np.float32(lit.followed) * change)
    radius = ball.radius_px / reduced.columns_per_pixel
    column, row = reduced.to_full(*find_circle(reduced, *reduced.from_full(ball.column, ball.row), radius))
    if np.hypot(column - ball.column, row - ball.row) > NEAR_CENTRE * ball.radius_px:
        return ball
    return replace(ball, column=float(column), row=float(row))


def _flat_nodes(response: ElevationResponse) -> tuple[Float32Array, Float32Array, Float32Array]:
    """a, b and c of a response with 6, 3 and 6 values a node: first the component's, then the channel's."""
    parts = (response.directions, response.brightening, response.slanting)
    a, b, c = (part.reshape(*part.shape[:2], -1) for part in parts)
    return a, b, c


def _lower(values: Float32Array, ball: Ball, apex_px: float, light: ElevationResponse | LampModel) -> None:
    """Change the intensity inside a ball's contact to what its slopes would show on untouched skin."""
    row, column = pixels_inside(ball, values.shape[:2])
    p, q = (s.astype(np.float64) for s in sphere_slopes(ball, column.astype(np.float32), row.astype(np.float32)))
    brightness = 1.0 / np.sqrt(1.0 + p**2 + q**2)
    z_px = apex_px - ball.radius_px * (1.0 - brightness)
    if isinstance(light, LampModel):
        there = column.astype(np.float64), row.astype(np.float64)
        values[row, column] += (light.shown(p, q, *there, 0.0 * z_px) - light.shown(p, q, *there, z_px)).astype(
            np.float32
        )
        return
    place = field_position(column, row, (values.shape[0], values.shape[1]))
    a, b, c = (between_nodes(part, place) for part in _flat_nodes(light))
    directions, slanting = (part.reshape(-1, 2, 3) for part in (a, c))
    slope = np.stack([p, q], axis=-1)
    at_rest = 1.0 + np.einsum("nd,ndc->nc", slope, directions)
    raised = at_rest + z_px[:, None] * (b + np.einsum("nd,ndc->nc", slope, slanting))
    # A light that has set lights nothing, here or there.
    change = brightness[:, None] * (np.maximum(at_rest, 0.0) - np.maximum(raised, 0.0))
    values[row, column] += change.astype(np.float32)

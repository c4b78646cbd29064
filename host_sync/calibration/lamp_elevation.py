"""What elevation does where lamps and coat are known as a whole: no law of light between lamps is needed then.

The response of `elevation_response` takes for granted that skin is matt, and reads how light changes with elevation
from how it changes with place. Lamps that were fitted to balls (`lamp_fit`) predict it for shining coats too, and
where each ball's centre is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from device.balls.sphere import Ball, BallSamples, gather_samples
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface.fields import Float64Array
from host_sync.calibration.elevated_balls import ElevatedBalls
from host_sync.calibration.elevation_response import NODES, UNEXPLAINED, ElevationResponse
from host_sync.calibration.shading_model import fit_shading_model
from host_sync.lights.lamp_fit import fit_lamps
from host_sync.lights.lamp_model import LampModel
from host_sync.lights.surroundings import Surroundings

DOUBT_PER_RESIDUAL: Final = 5.0
MAX_DOUBT: Final = 0.1
"""Relative standard uncertainty of what fitted lamps predict of elevation, over the intensity that they leave of the
balls, and at most. On ten rendered benches, which leave 0.004 to 0.014, lamps are found 0 to 2.5 % too high or too low,
root mean square 1.9 times what they leave; coats of flakes leave more.
"""

EXCLUDED: Final = 4.0
"""Standard uncertainties from zero within which a share below `UNEXPLAINED` says that light knows no elevation."""

SLOPE: Final = 0.1
"""Slopes by which directions are measured: a coat that shines is bent."""

RAISED_WIDTHS: Final = 0.02
"""Elevation by which changes are measured, in widths of the field."""

STEEPNESSES: Final = (0.2, 0.55)
AZIMUTHS: Final = 8
"""Slopes, as shares of the steepest that balls show, at which the map is asked what it reads of raised skin, ..."""

ELEVATIONS: Final = (0.5, 1.0)
"""... and elevations, as shares of the balls' apexes."""

MAX_MISREAD: Final = 0.2
"""Change of a slope beyond which a map is not followed: no ball taught it the colours in that corner."""

RIDGE: Final = 1e-9
"""Of the terms of what a map misreads, as a share of their equations' trace: keeps them solvable."""

ANY_RESIDUAL: Final = 1.0
"""Polynomials are compared with lamps however much they leave."""

Press = tuple[NormalizedImage, Sequence[Ball]]


def find_lamps(presses: Sequence[Press], elevated: ElevatedBalls) -> ElevatedBalls | None:
    """The balls of presses under the lamps that explain them; None where none do, or light knows no elevation.

    elevated : the balls as symmetry and heights show them
    """
    seen = elevated.response
    if abs(seen.share) + EXCLUDED * seen.share_sigma < UNEXPLAINED:
        return None
    samples = gather_samples(presses, to_teach=True)
    shading = fit_shading_model(samples, presses, ANY_RESIDUAL)
    if shading is None:
        return None
    balls = [ball for _, of_press in presses for ball in of_press]
    apexes_px = [apex_px for of_press in elevated.apexes_px for apex_px in of_press]
    fit = fit_lamps(samples, _close_by(samples, presses), balls, apexes_px, presses[0][0].shape)
    if not fit.explains(shading.residual):
        return None
    moved = iter(
        replace(ball, column=ball.column + across, row=ball.row + down)
        for ball, (across, down) in zip(balls, fit.shift_px.tolist(), strict=True)
    )
    centred = tuple(tuple(next(moved) for _ in of_press) for _, of_press in presses)
    return ElevatedBalls(response_under(fit.lamps.model, fit.residual), centred, elevated.apexes_px, fit.lamps)


def _close_by(samples: BallSamples, presses: Sequence[Press]) -> Float64Array:
    """What skin close to samples of presses' balls shows: shape (N, 3)."""
    press_of_ball = np.repeat(np.arange(len(presses)), [len(balls) for _, balls in presses])
    close = np.ones((len(samples.p), 3))
    for press in np.unique(press_of_ball):
        rows = press_of_ball[samples.ball] == press
        close[rows] = Surroundings.of(presses[press][0]).at(samples.column[rows], samples.row[rows])
    return close


def response_under(model: LampModel, residual: float) -> ElevationResponse:
    """What elevation changes under these lamps.

    residual : root mean square intensity that they leave of the balls
    """
    row, column = _nodes(model.shape)

    def shown(p: float, q: float, z_px: float) -> Float64Array:
        slope = np.full_like(column, p), np.full_like(column, q)
        lit = model.shown(*slope, column, row, np.full_like(column, z_px))
        return np.asarray(np.sqrt(1.0 + p * p + q * q) * lit)

    def slants(z_px: float) -> Float64Array:
        return np.stack(
            [
                (shown(SLOPE * across, SLOPE * down, z_px) - shown(-SLOPE * across, -SLOPE * down, z_px))
                / (2.0 * SLOPE)
                for across, down in ((1, 0), (0, 1))
            ],
            axis=1,
        )

    raised = RAISED_WIDTHS * model.shape[1]
    directions = slants(0.0)
    return ElevationResponse(
        directions.reshape(NODES, NODES, 2, 3).astype(np.float32),
        ((shown(0.0, 0.0, raised) - 1.0) / raised).reshape(NODES, NODES, 3).astype(np.float32),
        ((slants(raised) - directions) / raised).reshape(NODES, NODES, 2, 3).astype(np.float32),
        share=1.0,
        share_sigma=min(DOUBT_PER_RESIDUAL * residual, MAX_DOUBT),
    )


def as_read(elevated: ElevatedBalls, inverse: InverseMap) -> ElevatedBalls:
    """The same with what the inverse map reads of raised skin, where lamps predict how that looks.

    A map is taught skin at the elevation of untouched skin; of other brightness it makes what it will.
    """
    if elevated.lamps is None:
        return elevated
    model = elevated.lamps.model
    apex_px = float(np.median([apex_px for of_press in elevated.apexes_px for apex_px in of_press]))
    row, column = _nodes(model.shape)
    quiet = inverse.quiet
    slopes = [np.zeros(2)]
    for share in STEEPNESSES:
        for number in range(AZIMUTHS):
            angle = 2.0 * np.pi * number / AZIMUTHS
            slopes.append(share * inverse.max_trained_slope * np.array([np.cos(angle), np.sin(angle)]))

    def read(slope: Float64Array, z_px: float) -> Float64Array:
        p, q = (np.full_like(column, part) for part in slope)
        shown = model.shown(p, q, column, row, np.full_like(column, z_px))
        return quiet.predict(*(part.astype(np.float32) for part in (shown, column, row)))

    equations, changes = [], []
    for slope in slopes:
        level = read(slope, 0.0)
        for share in ELEVATIONS:
            z_px = share * apex_px
            change = np.clip(read(slope, z_px) - level, -MAX_MISREAD, MAX_MISREAD)
            equations.append(z_px * _terms(*(level + change).T))
            changes.append(change)
    system, wanted = np.concatenate(equations, axis=1), np.concatenate(changes, axis=1)
    gram = np.einsum("nki,nkj->nij", system, system)
    gram += RIDGE * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(gram.shape[1])
    terms = np.linalg.solve(gram, np.einsum("nki,nk->ni", system, wanted)[..., None])[..., 0]
    misread = np.insert(terms, 0, 0.0, axis=1).reshape(NODES, NODES, 9).astype(np.float32)
    return replace(elevated, response=replace(elevated.response, misread=misread))


def _terms(p: Float64Array, q: Float64Array) -> Float64Array:
    """What the terms of `as_slopes` but the constant brightening, which the others hold, make of slopes (N,) that are
    read: shape (N, 2, 8).
    """
    zero, one = np.zeros_like(p), np.ones_like(p)
    across = (-p * p, -p * q, one, p, q, zero, zero, zero)
    down = (-p * q, -q * q, zero, zero, zero, one, p, q)
    return np.stack([np.stack(across, axis=-1), np.stack(down, axis=-1)], axis=1)


def _nodes(shape: tuple[int, int]) -> tuple[Float64Array, Float64Array]:
    """Rows and columns of the places at which a response is kept, borders included: shape (NODES²,) each."""
    axes = (np.linspace(0.0, size - 1.0, NODES) for size in shape)
    row, column = np.meshgrid(*axes, indexing="ij")
    return row.ravel(), column.ravel()

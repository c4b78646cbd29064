"""Balls' centres where the lamps' places are known.

An apex is sought where intensity is that of untouched skin but for a brightening that all channels share. It stands
nearer to the lamps than untouched skin, and under each by another share: level skin there looks as if it sloped, and
the place that looks level is off by so much times the ball's radius. A map that is taught such centres reads all skin
at the apexes' elevation tilted. Lamps whose places are known predict the slope, and the shared brightening beside it;
what balls show of that brightening says how much of both a coat follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from device.balls.sphere import Ball, pixels_inside, sphere_slopes
from device.imaging.flat_field import NormalizedImage
from device.surface.fields import Float64Array
from host_sync.lights.known_lamps import KnownLamps

APEX: Final = 0.1
"""Radius of the patch around an apex whose mean intensity is taken, as a share of the ball's radius."""

MAX_FOLLOWED: Final = 1.2
"""Share of the predicted slope, at most, that centres are moved for: a matt coat shows 0.95, one with flakes 0.6."""

Press = tuple[NormalizedImage, Sequence[Ball]]


def centres_under_lamps(
    presses: Sequence[Press], apexes_px: Sequence[Sequence[float]], lamps: KnownLamps
) -> tuple[tuple[Ball, ...], ...]:
    """The balls of every press where their apexes are, from where they look level.

    apexes_px : elevation of each ball's apex over untouched skin, pixels
    """
    every = [(image, ball) for image, of_press in presses for ball in of_press]
    z_px = np.array([apex_px for of_press in apexes_px for apex_px in of_press])
    place = np.array([[ball.column, ball.row] for _, ball in every])
    slope, brighter = lamps.level_skin_raised(place, z_px, every[0][0].shape)
    seen = np.array([_brightening(image, ball) for image, ball in every])
    known = np.isfinite(seen)
    power = float((brighter[known] ** 2).sum())
    followed = float(np.clip((seen[known] * brighter[known]).sum() / max(power, 1e-12), 0.0, MAX_FOLLOWED))
    moved = iter(
        replace(ball, column=ball.column - by[0], row=ball.row - by[1])
        for (_, ball), by in zip(every, (followed * slope * _radii_px(every)).tolist(), strict=True)
    )
    return tuple(tuple(next(moved) for _ in of_press) for _, of_press in presses)


def _radii_px(balls: Sequence[tuple[NormalizedImage, Ball]]) -> Float64Array:
    return np.array([[ball.radius_px] for _, ball in balls])


def _brightening(image: NormalizedImage, ball: Ball) -> float:
    """Mean over the channels of intensity at the apex less 1, without what slopes darken; NaN where none is seen."""
    apex = replace(ball, contact_radius_px=APEX * ball.radius_px)
    row, column = pixels_inside(apex, image.shape)
    seen = image.valid[row, column]
    if not seen.any():
        return float("nan")
    p, q = sphere_slopes(ball, column[seen].astype(np.float32), row[seen].astype(np.float32))
    lit = image.values[row[seen], column[seen]].mean(axis=1) * np.sqrt(1.0 + p**2 + q**2)
    return float(lit.mean()) - 1.0

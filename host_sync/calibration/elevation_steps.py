"""The steps of a calibration that are about elevation: where balls stand, what that changes, and what it leaves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from device.balls.sphere import Ball, BallSamples, gather_samples
from device.balls.viewpoint import MIN_HEIGHTS, Viewpoint
from device.calibration.cross_validation import angle_between_deg
from device.calibration.fit import InverseFit
from device.errors import CalibrationError
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface.fields import Float32Array
from host_sync.calibration.balls import UsedPress, apply_fit
from host_sync.calibration.elevated_balls import ElevatedBalls, find_elevated_balls
from host_sync.calibration.lamp_elevation import find_lamps
from host_sync.calibration.shading_model import GLITTERING, fit_shading_model
from host_sync.kernels.cell_rows import cell_px
from host_sync.lights.known_lamps import KnownLamps
from host_sync.lights.lamp_slopes import LampReader
from host_sync.lights.lit_skin import is_lit_by_all
from host_sync.uncertainty.elevation import ElevationCorrection, apexes_px, elevation_correction
from host_sync.uncertainty.light_height import nearness_per_px
from host_sync.uncertainty.slope_error import OverCells


def seen_from(located: Sequence[UsedPress], inverse: InverseMap, viewpoint: Viewpoint) -> list[UsedPress]:
    """The presses with balls as a camera sees them that is not far away.

    Raises
    ------
    CalibrationError
        The camera would stand hardly higher than the balls.
    """
    seen = [
        replace(
            press,
            balls=tuple(
                replace(ball, viewpoint=viewpoint, apex_px=apex_px)
                for ball, apex_px in zip(press.balls, apexes_px(press.intensity, press.balls, inverse), strict=True)
            ),
        )
        for press in located
    ]
    highest_px = max((ball.apex_px for press in seen for ball in press.balls), default=0.0)
    if viewpoint.height_px < MIN_HEIGHTS * highest_px:
        raise CalibrationError(
            f"the camera's pupil is stated {viewpoint.height_px:.0f} px over the skin and a ball rises "
            f"{highest_px:.0f} px: check pupil_height_mm"
        )
    return seen


def elevated_balls_of(
    located: Sequence[UsedPress], inverse: InverseFit, flat_field: Float32Array, lamps: KnownLamps | None
) -> ElevatedBalls | None:
    """The balls of presses with what elevation does to them; None where they cannot tell."""
    used = apply_fit(located, inverse)
    pressed = [(press.intensity, press.balls) for press in used]
    found = find_elevated_balls(pressed, inverse.map, flat_field, lamps)
    return (find_lamps(pressed, found) or found) if found else None


def followed_balls(located: Sequence[UsedPress], inverse: InverseFit, elevated: ElevatedBalls) -> ElevatedBalls | None:
    """What slopes are to be corrected by for their elevation; None where nothing is seen of it."""
    kept = [(press.intensity, press.balls) for press in apply_fit(located, inverse)]
    samples = gather_samples(kept)
    is_matt = fit_shading_model(samples, kept, GLITTERING) is not None
    return elevated.followed(nearness_per_px(samples, inverse.map.shape), is_matt=is_matt)


def lowered_presses(located: Sequence[UsedPress], elevated: ElevatedBalls) -> list[UsedPress]:
    """Presses whose balls look as if they stood at the elevation of untouched skin."""
    return [
        replace(press, intensity=elevated.lowered(number, press.intensity), balls=elevated.balls[number])
        for number, press in enumerate(located)
    ]


def lamps_that_read_better(
    kept: Sequence[tuple[NormalizedImage, Sequence[Ball]]], inverse: InverseFit, followed: ElevatedBalls | None
) -> OverCells | None:
    """What reads the balls of `kept` by the lamps that explain them.

    None where no lamps do, or the map without a ball reads it better than lamps without its fold.
    """
    if followed is None or followed.lamps is None or inverse.held_out_deg is None:
        return None
    lamps = followed.lamps
    without = [LampReader(inverse.map, lamps.without(int(number))) for number in np.flatnonzero(inverse.kept)]
    errors_deg = []
    for (image, ball), reader in zip(((image, ball) for image, balls in kept for ball in balls), without, strict=True):
        shown = gather_samples([(image, [ball])])
        found = reader.in_frame(image).predict(shown.intensity, shown.column, shown.row)
        errors_deg.append(angle_between_deg(found, np.stack([shown.p, shown.q], axis=-1)))
    if float(np.concatenate(errors_deg).mean()) >= inverse.held_out_deg:
        return None
    return OverCells(
        LampReader(inverse.map, lamps.model),
        without,
        cell_px(inverse.map.shape),
        partial(is_lit_by_all, lamps.model),
    )


def elevation_left(
    kept: Sequence[tuple[NormalizedImage, Sequence[Ball]]],
    training: BallSamples,
    inverse: InverseFit,
    elevated: ElevatedBalls | None,
    followed: ElevatedBalls | None,
) -> ElevationCorrection:
    """What elevation leaves uncertain: of a correction its uncertainty, else as much of the lights' nearness as may
    be.
    """
    if followed:
        return followed.left
    nearness = elevation_correction(kept, training, inverse.map)
    return nearness.shared(elevated.response.possible_fraction) if elevated else nearness

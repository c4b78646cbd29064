"""Held-out error of the paper's method, for a fair comparison of methods."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from device.balls.sphere import Ball, gather_samples
from device.calibration.cross_validation import angle_between_deg
from device.imaging.flat_field import NormalizedImage
from device.surface import Float64Array
from host_sync.johnson2009.model import PaperModel, estimate_gradients, fit_paper_model

FOLDS: Final = 3


def held_out_paper_deg(presses: Sequence[tuple[NormalizedImage, Sequence[Ball]]]) -> float:
    """Return the mean angular error of the normal over held-out balls, degrees; NaN with fewer than two balls."""
    numbered = [(press, ball) for press, (_, balls) in enumerate(presses) for ball in balls]
    if len(numbered) < 2:
        return float("nan")
    folds = min(FOLDS, len(numbered))
    errors = []
    for fold in range(folds):
        held = set(numbered[fold::folds])
        training = [
            (image, [ball for ball in balls if (press, ball) not in held])
            for press, (image, balls) in enumerate(presses)
        ]
        model = fit_paper_model(gather_samples(training))
        errors += [_ball_error_deg(model, presses[press][0], ball) for press, ball in sorted(held, key=str)]
    return float(np.concatenate(errors).mean())


def _ball_error_deg(model: PaperModel, image: NormalizedImage, ball: Ball) -> Float64Array:
    """Return the angular error at every usable pixel inside one ball's contact, degrees."""
    reach = int(np.ceil(ball.contact_radius_px)) + 3
    top, left = max(round(ball.row) - reach, 0), max(round(ball.column) - reach, 0)
    window = (slice(top, round(ball.row) + reach), slice(left, round(ball.column) + reach))
    crop = NormalizedImage(image.values[window], image.valid[window], image.clipped[window])
    gradients = estimate_gradients(model, crop)
    truth = gather_samples([(image, [ball])])
    row, column = truth.row.astype(np.intp) - top, truth.column.astype(np.intp) - left
    inside = (row < crop.shape[0]) & (column < crop.shape[1])
    row, column = row[inside], column[inside]
    usable = gradients.valid[row, column]
    slope = np.stack([gradients.p[row, column], gradients.q[row, column]], axis=-1)[usable]
    true = np.stack([truth.p, truth.q], axis=-1)[inside][usable]
    return angle_between_deg(slope.astype(np.float64), true.astype(np.float64))

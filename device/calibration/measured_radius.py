"""Radii of balls as the last calibration reads them: a wrong ball has all its slopes wrong by one factor."""

from __future__ import annotations

from typing import Final

import numpy as np

from device.balls.sphere import BallSamples
from device.inverse_map.model import InverseMap

GENTLE: Final = 0.5
"""Slopes up to which radii are read, as stated."""


def measured_radius_shares(samples: BallSamples, last: InverseMap) -> np.ndarray:
    """Each ball's measured radius over the stated one, float64 array of shape (number of balls,), NaN without samples.

    last : the inverse map of the last calibration of the same gel and lights. A ball of radius R that is stated as R'
        shows about R' / R times the stated slopes.
    """
    stated = np.stack([samples.p, samples.q], axis=-1).astype(np.float64)
    gentle = np.linalg.norm(stated, axis=1) < GENTLE
    read = np.asarray(last.predict(samples.intensity[gentle], samples.column[gentle], samples.row[gentle]))[:, :2]
    stated, ball = stated[gentle], samples.ball[gentle]
    count = int(samples.ball.max()) + 1
    both = np.bincount(ball, (stated * read).sum(axis=1), count)
    alone = np.bincount(ball, (stated * stated).sum(axis=1), count)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(alone / both)

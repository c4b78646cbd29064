"""Whether balls have the radii that are stated for them: shading tells their sizes against one another.

A map from intensity to slope trained on many balls reads every ball. A ball that is smaller than stated is steeper at
each place than its stated radius makes it: the map reads its slopes by that share too steep. The common size of all
balls cannot be told so: were all radii wrong by one share, the map would have learned slopes wrong by it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from device.balls.sphere import BallSamples
from device.calibration.limits import MAX_RADIUS_SPREAD
from device.errors import CalibrationError
from device.inverse_map.model import InverseMap
from device.surface.fields import Float64Array

MAX_SAMPLES = 20_000


def radius_shares(samples: BallSamples, inverse_map: InverseMap) -> Float64Array:
    """Radius that shading gives each ball over the one stated, float64 array of shape (number of balls,).

    NaN for a ball without a faithful pixel.
    """
    step = max(1, len(samples.p) // MAX_SAMPLES)
    true = np.stack([samples.p[::step], samples.q[::step]], axis=-1).astype(np.float64)
    read = inverse_map.predict(samples.intensity[::step], samples.column[::step], samples.row[::step])
    ball = samples.ball[::step]
    count = int(samples.ball.max()) + 1
    agreement = np.bincount(ball, (read * true).sum(axis=-1), count)
    square = np.bincount(ball, (true**2).sum(axis=-1), count)
    return np.where(square > 0.0, square / np.maximum(agreement, 1e-9), np.nan)


def radius_spread(shares: Float64Array) -> float:
    """Relative spread of radii: one or two lights show all slopes too flat, which is no contradiction among balls."""
    return float(np.nanstd(shares) / np.nanmedian(shares))


def check_radii(shares: Float64Array, owners: Sequence[str]) -> None:
    """Refuse balls whose radii contradict one another.

    shares : as `radius_shares` returns them
    owners : the press of each ball

    Raises
    ------
    CalibrationError
        Names the presses at both ends and what they read.
    """
    spread = radius_spread(shares)
    if spread <= MAX_RADIUS_SPREAD:
        return
    small, large = owners[int(np.nanargmin(shares))], owners[int(np.nanargmax(shares))]
    odd = owners[int(np.nanargmax(np.abs(shares - np.nanmedian(shares))))]
    raise CalibrationError(
        f"the balls' radii contradict each other: by their shading they are {np.nanmin(shares):.2f} ({small}) to "
        f"{np.nanmax(shares):.2f} ({large}) of what is stated (spread {spread:.0%}, at most {MAX_RADIUS_SPREAD:.0%}): "
        f"check ball_radius_mm of each press; where they are right, leave out {odd}"
    )

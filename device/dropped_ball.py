"""What is said of a ball that was found and that the fit then dropped."""

from __future__ import annotations

from device.ball_finder import RejectedBall
from device.inverse_fit import InverseFit


def dropped_ball(fit: InverseFit, number: int) -> RejectedBall:
    """Ball `number` of a fit as a rejected one, with the error by which it stood out."""
    ball = fit.balls[number]
    error_deg = float(fit.ball_error_deg[number])
    return RejectedBall(ball.column, ball.row, f"does not follow the sphere (held-out error {error_deg:.1f} degrees)")

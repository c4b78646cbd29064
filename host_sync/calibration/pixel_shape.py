"""The shape of pixels, height over width, that the skin around pressed balls shows.

Inside a contact nothing shows it: a map learned from balls that are stretched with the frame reads stretched slopes.
Around the contact the skin is no sphere, and slopes that the map reads there belong to one surface (∂p/∂row =
∂q/∂column) only when both are taken over the right distances. With pixels that are `a` times as high as wide, the map
reads p and q / a, so that ∂p/∂row = a² ∂q/∂column.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from device.balls.sphere import Ball
from device.imaging.flat_field import NormalizedImage
from device.inverse_map.model import InverseMap
from host_sync.calibration.balls import UsedPress

RING: Final = (1.1, 1.8)
"""Inner and outer radius of the skin that is looked at, in contacts."""

REDUCED_PX: Final = 24.0
"""Radius of a ball in the frame that is looked at; a larger one is reduced to it."""

BLUR: Final = 0.06
"""Standard deviation of the blur of slopes, in radii of the ball."""

LEAST_AGREEMENT: Final = 0.3
"""Correlation of the two derivatives from which on a ball's skin shows the shape."""

LEAST_BALLS: Final = 4
SYSTEMATIC: Final = 0.02
"""Standard uncertainty that does not average out: light that the map misreads is 1.2 % on the one real sensor whose
pixels are known to be square (oem-bga)."""

OF_DEVIATION: Final = 0.1
"""And this share of the deviation: a map that was fitted to stretched balls reads the skin around them a little
wrong (rendered frames: 1.197 of true 1.176, 1.092 of 1.087)."""

OF_DISAGREEMENT: Final = 0.7
"""And this part of how far the two derivatives disagree, (1 - ρ) / (1 + ρ) of their correlation ρ: in cast shadows and
under a wide lens the map is wrong on one side of a ball. Chosen on two public sensors with round contacts, bnz-ur5
(0.90) and fots-gelsight (0.75). Of seven others only cmu-mini is contradicted, by labels that are up to a radius off
(0.147, with 0.139 allowed); with found balls it is not (0.058, with 0.122)."""

SPREAD_OF_QUARTILES: Final = 1.349
COVERAGE: Final = 2.0
MAX_OFF: Final = 0.05
"""Pixels further from the stated shape than this make heights wrong by as much: the calibration does not pass."""


@dataclass(frozen=True, slots=True)
class PixelShape:
    """Height of a pixel over its width, over what is stated, with its standard uncertainty.

    balls : number of balls that show it
    """

    ratio: float
    sigma: float
    balls: int

    @property
    def off(self) -> float:
        """Distance from the shape that is stated."""
        return abs(self.ratio - 1.0)

    @property
    def allowed(self) -> float:
        """The distance that contradicts nothing."""
        return max(COVERAGE * self.sigma, MAX_OFF)

    @property
    def against_stated(self) -> str:
        """The sentence on pixels whose shape was stated and seems another."""
        return (
            f"by the skin around {self.balls} balls the height of pixels over their width is {self.ratio:.3f} ± "
            f"{self.sigma:.3f} of the stated two pitches: shadows or the lens may cause that; else heights are wrong "
            "by as much"
        )

    def disagreement(self, pitch_um: float) -> str:
        """Return the sentence on how pixels differ from the stated ones or may differ; empty where they agree."""
        if self.off <= min(self.sigma, MAX_OFF):
            return ""
        if self.off <= self.allowed:
            return (
                f"the shape of pixels is not confirmed: by the skin around {self.balls} balls their height over width "
                f"is {self.ratio:.2f} ± {COVERAGE * self.sigma:.2f} of the stated, which shadows or the lens may "
                "cause: compare a ruler along both sides of a frame"
            )
        square, found = f"{pitch_um:.4g}", f"{pitch_um * self.ratio:.4g}"
        return (
            f"pixels are not of the stated shape: by the skin around {self.balls} balls the pitch down a column is "
            f"{self.ratio:.3f} ± {self.sigma:.3f} times as large beside that along a row (a stream that was resized or "
            f"cropped), and heights are wrong by as much: state two pitches where one was, such as "
            f"pixel_pitch_um = [{square}, {found}], or [{square}, {square}] if you know the pixels to be square"
        )


def measure_pixel_shape(presses: Sequence[UsedPress], inverse_map: InverseMap) -> PixelShape | None:
    """Return the shape that the presses show; None where too few balls do."""
    found = [_shape(press.intensity, ball, inverse_map) for press in presses for ball in press.balls]
    shapes = np.array([one for one in found if one is not None])
    if len(shapes) < LEAST_BALLS:
        return None
    low, ratio, high = np.percentile(shapes[:, 0], [25, 50, 75])
    agreement = float(np.median(shapes[:, 1]))
    scatter = (high - low) / SPREAD_OF_QUARTILES / np.sqrt(len(shapes))
    disagreement = OF_DISAGREEMENT * (1.0 - agreement) / (1.0 + agreement)
    sigma = np.linalg.norm([scatter, SYSTEMATIC, OF_DEVIATION * (ratio - 1.0), disagreement])
    return PixelShape(float(ratio), float(sigma), len(shapes))


def _shape(image: NormalizedImage, ball: Ball, inverse_map: InverseMap) -> tuple[float, float] | None:
    """Return the shape by one ball's skin, by total least squares of the two derivatives, and their correlation.

    None where they do not agree.
    """
    rows, columns = image.shape
    reach = RING[1] * ball.contact_radius_px + 2.0 * BLUR * ball.radius_px + 2.0
    top, bottom = max(int(ball.row - reach), 0), min(int(ball.row + reach) + 2, rows)
    left, right = max(int(ball.column - reach), 0), min(int(ball.column + reach) + 2, columns)
    window = np.s_[top:bottom, left:right]
    factor = max(ball.radius_px / REDUCED_PX, 1.0)
    size = (max(round((right - left) / factor), 3), max(round((bottom - top) / factor), 3))
    values = cv2.resize(np.nan_to_num(image.values[window]), size, interpolation=cv2.INTER_AREA)
    lit = cv2.resize(image.faithful_at(window).astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.99
    scale = ((right - left) / size[0], (bottom - top) / size[1])
    column = ((np.arange(size[0]) + 0.5) * scale[0] - 0.5 + left).astype(np.float32)
    row = ((np.arange(size[1]) + 0.5) * scale[1] - 0.5 + top).astype(np.float32)
    column, row = np.broadcast_arrays(column, row[:, None])
    read = inverse_map.predict(
        np.asarray(values, np.float32).reshape(-1, values.shape[-1]),
        np.asarray(column.ravel(), np.float32),
        np.asarray(row.ravel(), np.float32),
    )
    slopes = read.astype(np.float64).reshape(*row.shape, 2)
    smooth = cv2.GaussianBlur(slopes, (0, 0), max(BLUR * ball.radius_px / factor, 1.0))
    down = np.gradient(smooth[..., 0], axis=0) / scale[1]
    across = np.gradient(smooth[..., 1], axis=1) / scale[0]
    apart = np.hypot(row - ball.row, column - ball.column) / ball.contact_radius_px
    ring = (apart > RING[0]) & (apart < RING[1]) & lit
    if ring.sum() < REDUCED_PX:
        return None
    x, y = across[ring], down[ring]
    xx, yy, both = float((x * x).mean()), float((y * y).mean()), float((x * y).mean())
    agreement = both / max(float(np.sqrt(xx * yy)), 1e-12)
    if agreement <= LEAST_AGREEMENT:
        return None
    square = (yy - xx + np.hypot(yy - xx, 2.0 * both)) / (2.0 * both)
    return float(np.sqrt(square)), agreement

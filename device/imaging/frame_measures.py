"""Figures of a whole frame of a press: sharpness, fraction of the field in contact, order of channels, orientation."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Final

import cv2
import numpy as np

from device.errors import CalibrationMismatch
from device.imaging.flat_field import DARK_FLOOR, LinearFrame, NormalizedImage, bin_bayer
from device.surface import Float32Array
from hal.frame import RawFrame

CLEAR_FACTOR: Final = 0.5
"""A permutation must reduce the disagreement to this fraction before the frame is refused."""

_VIEWS: Final[dict[str, tuple[slice, ...]]] = {
    "mirrored left to right": np.s_[:, ::-1],
    "mirrored top to bottom": np.s_[::-1, :],
    "turned by half a turn": np.s_[::-1, ::-1],
}

ROWS_SAMPLED: Final = 128
"""About as many rows, and columns at the same stride, are tested."""

CLEAR_DISAGREEMENT: Final = 0.06
"""Disagreement (median of |log intensity|) below which the given order is accepted without a test."""


def check_channel_order(frame: LinearFrame, flat_field: Float32Array, name: str) -> None:
    """Refuse a frame whose channels are in another order than its reference's, or that is mirrored or turned.

    Raises
    ------
    CalibrationMismatch
        Names the frame and the order that its channels seem to have, or how it is turned.
    """
    step = max(1, frame.shape[0] // ROWS_SAMPLED)
    light = np.log(np.maximum(frame.rgb[::step, ::step], DARK_FLOOR))
    rest = np.log(np.maximum(flat_field[::step, ::step], DARK_FLOOR))
    as_given = _disagreement(light, rest)
    if as_given <= CLEAR_DISAGREEMENT:
        return
    disagreement = {order: _disagreement(light[..., order], rest) for order in permutations(range(3))}
    best = min(disagreement, key=lambda order: disagreement[order])
    turned = {words: _disagreement(light[view], rest) for words, view in _VIEWS.items()}
    view = min(turned, key=lambda words: turned[words])
    if turned[view] < min(CLEAR_FACTOR * as_given, disagreement[best]):
        raise CalibrationMismatch(
            f"{name}: is {view} against the untouched skin: take all frames as one camera mode does"
        )
    if disagreement[best] < CLEAR_FACTOR * as_given:
        seen = ", ".join("RGB"[best.index(channel)] for channel in range(3))
        raise CalibrationMismatch(f"{name}: the channels are in the order {seen}, not R, G, B: convert the file")


def _disagreement(light: Float32Array, rest: Float32Array) -> float:
    """Return the median distance of log light from the reference's, averaged over colours."""
    return float(np.median(np.abs(light - rest), axis=(0, 1)).mean())


SCALES_PX: Final = (1.4, 2.8, 5.6)
"""Standard deviations of the Gaussians whose differences are fine and coarser contrast."""

EDGES_PERCENTILE: Final = 99.5
MIN_CONTRAST: Final = 0.03


def sharpness(intensity: NormalizedImage) -> float | None:
    """Return the ratio of fine to coarser contrast at the strongest edges; None without edges."""
    green = np.ascontiguousarray(intensity.values[..., 1])
    fine, middle, coarse = (cv2.GaussianBlur(green, (0, 0), scale) for scale in SCALES_PX)
    coarser = float(np.percentile(np.abs(middle - coarse)[::2, ::2], EDGES_PERCENTILE))
    if coarser < MIN_CONTRAST:
        return None
    return float(np.percentile(np.abs(fine - middle)[::2, ::2], EDGES_PERCENTILE)) / coarser


SHADED: Final = 0.06
"""Difference from the intensity of flat skin, in any channel, from which a pixel counts as shaded."""


def shaded_fraction(intensity: NormalizedImage) -> float:
    """Return the fraction of valid pixels whose intensity differs from flat skin's."""
    smooth = cv2.GaussianBlur(intensity.values, (0, 0), 2.0)
    red, green, blue = np.moveaxis(np.abs(smooth - 1.0) > SHADED, -1, 0)
    shaded = red | green | blue
    return float(shaded[intensity.valid].mean()) if intensity.valid.any() else 0.0


# Focus figure: fine contrast of whatever the camera sees, for turning a lens to its sharpest place.
#
# Unlike a scan's sharpness it needs neither a reference nor an edge, and compares frames of one scene only.

FOCUS_SCALES_PX: Final = (0.7, 1.4)
"""Standard deviations of the Gaussians whose difference is fine contrast, in pairs of pixels."""

CENTRE: Final = 0.5
"""Part of the field's width and height that is judged: a lens is focused at the centre."""


NEAR_BEST: Final = 0.9
"""Fraction of the best figure from which the lens counts as sharp; a figure below it has clearly fallen."""

MEDIAN_OF: Final = 3
"""Frames whose median figure counts, so that noise of one frame makes no best value."""

IS_DARK: Final = "The picture is dark: take the lens cap off and check the lights."
SEARCH: Final = "Turn the focus ring slowly one way, until the figure has risen and falls again."
TURN_BACK: Final = "Below the best: turn slowly back. If the object was moved, start again."
IS_SHARP: Final = "Sharp: lock the ring here. Then calibrate, because the picture has changed."


@dataclass(frozen=True, slots=True)
class FocusReading:
    """Present sharpness of the lens.

    figure, best : present and largest focus figure since the start
    advice : what to turn, one sentence
    """

    figure: float
    best: float
    advice: str

    @property
    def fraction(self) -> float:
        """Present figure as a fraction of the best; 0 in darkness."""
        return self.figure / self.best if self.best else 0.0


class FocusMeter:
    """Holds the best figure while a person turns the lens, and says what to turn. One scene only."""

    def __init__(self) -> None:
        self._last: deque[float] = deque(maxlen=MEDIAN_OF)
        self._best = 0.0
        self._has_fallen = False

    def read(self, frame: RawFrame) -> FocusReading:
        """Return the reading with one more frame."""
        self._last.append(focus_figure(frame))
        figure = float(np.median(self._last))
        self._best = max(self._best, figure)
        is_near = figure >= NEAR_BEST * self._best
        self._has_fallen = self._has_fallen or not is_near
        if figure == 0.0:
            return FocusReading(figure, self._best, IS_DARK)
        advice = SEARCH if not self._has_fallen else IS_SHARP if is_near else TURN_BACK
        return FocusReading(figure, self._best, advice)


def focus_figure(frame: RawFrame) -> float:
    """Return the fine contrast at the field's centre, per thousand of the mean light; 0 in darkness.

    Contrast is a standard deviation here.
    """
    rows, columns = frame.shape
    down, right = (round(size * (1.0 - CENTRE) / 4.0) * 2 for size in (rows, columns))  # even: whole Bayer quads
    centre = np.ascontiguousarray(frame.mosaic[down : rows - down, right : columns - right])
    green = np.ascontiguousarray(bin_bayer(replace(frame, mosaic=centre)).rgb[..., 1])
    mean = float(green.mean())
    if mean <= 0.0:
        return 0.0
    fine, coarse = (cv2.GaussianBlur(green, (0, 0), scale) for scale in FOCUS_SCALES_PX)
    return 1e3 * float((fine - coarse).std()) / mean

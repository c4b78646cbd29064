"""The inverse map of a calibration's presses, and which balls at which centres it is fitted to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Literal

import numpy as np

from device.balls.sphere import gather_samples
from device.calibration.fit import BegunFit, InverseFit, begin_fit
from device.inverse_map.illumination import IlluminationMap
from host_sync.calibration.balls import PressFrame, UsedPress, add_detections, cut_to_core, relocate_labels

Centres = Literal["found", "labelled", "found at labels", "found at labels and beyond"]
FITTED_SAMPLES: Final = 40_000
WORTH_MORE_BALLS: Final = 1.1
"""Balls that no label has are tried when there are so many times as many with them."""

MORE_BALLS_GAIN: Final = 0.95
"""Their held-out error counts as so much smaller: more balls show more of the field than the labelled ones can tell."""

CORE_KEPT: Final = 0.9
"""So many of the balls that train without a cut must train with it: an error that is small because balls are left out
says nothing."""


def fit_to_best_balls(
    presses: Sequence[PressFrame], located: Sequence[UsedPress], light: IlluminationMap | None
) -> tuple[BegunFit, Sequence[UsedPress], Centres]:
    """Return the inverse map; where a hand labelled balls, fitted to the balls and centres that held-out labelled ones
    prefer.

    Balls that no label has count where they make the labelled ones' held-out error smaller. Labelled contacts are cut
    to their core where that makes the core's own held-out error smaller, and not by leaving balls aside.

    light : of untouched skin, None where no reference shows it
    """
    by_hand = [press.labelled_by_hand for press in presses]
    best = fit_to(located, light)
    if not any(by_hand):
        return best, located, "found"
    chosen: tuple[Sequence[UsedPress], Centres] = (located, "labelled")
    choices: tuple[tuple[Centres, Callable[[UsedPress], UsedPress]], ...] = (
        ("found at labels", relocate_labels),
        ("found at labels and beyond", add_detections),
    )
    for name, move in choices:
        moved = [move(used) if hand else used for used, hand in zip(located, by_hand, strict=True)]
        more = name == "found at labels and beyond"
        if more and _count(moved) < WORTH_MORE_BALLS * _count(located):
            continue
        begun = fit_to(moved, light)
        gain = MORE_BALLS_GAIN if more else 1.0
        if gain * _label_error_deg(begun.fit, moved, located) < _label_error_deg(best.fit, chosen[0], located):
            best, chosen = begun, (moved, name)
    if chosen[1] != "found at labels and beyond":
        cut = [cut_to_core(used) if hand else used for used, hand in zip(chosen[0], by_hand, strict=True)]
        core = fit_to_cores(cut, best, light)
        return (*core, chosen[1]) if core else (best, *chosen)
    return best, *chosen


def fit_to_cores(
    cut: Sequence[UsedPress], whole: BegunFit, light: IlluminationMap | None
) -> tuple[BegunFit, Sequence[UsedPress]] | None:
    """Return the inverse map of presses whose contacts were cut to their core; None where held-out balls prefer the
    whole.

    The error of the core alone decides, and not one that is smaller because balls were left aside.
    """
    begun = fit_to(cut, light)
    core_deg, kept = begun.fit.held_out_deg, begun.fit.kept.sum()
    if core_deg is None or whole.fit.core_deg is None or kept < CORE_KEPT * whole.fit.kept.sum():
        return None
    return (begun, cut) if core_deg < whole.fit.core_deg else None


def _count(presses: Sequence[UsedPress]) -> int:
    return sum(len(press.balls) for press in presses)


def _label_error_deg(fit: InverseFit, fitted: Sequence[UsedPress], located: Sequence[UsedPress]) -> float:
    """Return the median held-out error of the balls that `located` holds too: the first of each press in `fitted`."""
    common = [i < len(own.balls) for press, own in zip(fitted, located, strict=True) for i in range(len(press.balls))]
    return float(np.median(fit.ball_error_deg[np.array(common)]))


def fit_to(presses: Sequence[UsedPress], light: IlluminationMap | None, like: BegunFit | None = None) -> BegunFit:
    """Return the inverse map of the presses' balls, begun.

    light : of untouched skin, None where no reference shows it
    like : an earlier fit, whose choices are kept
    """
    samples = gather_samples([(press.intensity, press.balls) for press in presses], for_fit=True)
    balls = [ball for press in presses for ball in press.balls]
    alone = np.array([len(press.balls) == 1 for press in presses for _ in press.balls])
    shape = presses[0].intensity.shape
    return begin_fit(
        samples, balls, shape, max_samples=FITTED_SAMPLES, light=light, thorough=True, like=like, alone=alone
    )

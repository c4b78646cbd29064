"""Lamps that shine otherwise in a press than in the reference: by how much, and the presses without it.

A lamp that is a per cent weaker while a ball is pressed teaches slopes that are a hundredth off there, and untouched
skin that slopes. The skin beside the ball tells the change as it does in a scan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from device.calibration.fit import BegunFit
from device.inverse_map.illumination import IlluminationMap
from device.inverse_map.model import InverseMap
from device.surface.fields import Float64Array
from host_sync.calibration.ball_choice import fit_to
from host_sync.calibration.balls import UsedPress
from host_sync.calibration.lamp_drift import MAX_DRIFT, MIN_PRESSES, believed_share, untouched_level
from host_sync.frame_checks.light_levels import cell_logs, untouched_levels

PATCH_SIGMA: Final = 0.001
"""Standard uncertainty of the level of the largest patch that agrees on one."""


def fit_without_drift(
    presses: Sequence[UsedPress], begun: BegunFit, light: IlluminationMap
) -> tuple[BegunFit, Float64Array | None]:
    """The inverse map fitted again to the presses without drift, and that drift; None where they do not drift.

    The drift is the logarithm of each channel's light in each press over the reference's, float64 array of shape
    (N, 3): zero where it is no more than its uncertainty, or more than `MAX_DRIFT`.

    begun : the map as fitted to the presses as they are
    light : of untouched skin
    """
    drifts = _first_drifts(presses, begun.fit.map)
    if drifts is None:
        return begun, None
    begun = fit_to(without_drift(presses, drifts), light)
    # A press in which the first map sees no untouched skin may show it to the second.
    left = np.stack([_seen(press, begun.fit.map) for press in without_drift(presses, drifts)])
    if left.any():
        drifts = drifts + left
        begun = fit_to(without_drift(presses, drifts), light, begun)
    return begun, drifts


def without_drift(presses: Sequence[UsedPress], drifts: Float64Array) -> list[UsedPress]:
    """The presses under the reference's lamps; drifts as of `fit_without_drift`."""
    return [
        replace(press, intensity=replace(press.intensity, values=press.intensity.values * factors))
        if (factors != 1.0).any()
        else press
        for press, factors in zip(presses, np.exp(-drifts).astype(np.float32), strict=True)
    ]


def drift_note(drifts: Float64Array) -> str:
    """What a person should know of them, a sentence."""
    largest = np.expm1(np.abs(drifts).max())
    return (
        f"lamps differed by up to {largest:.1%} between the presses and the reference, which was taken out: let them "
        "warm up before you calibrate"
    )


def _first_drifts(presses: Sequence[UsedPress], inverse_map: InverseMap) -> Float64Array | None:
    """The drift under a map that was fitted to drifting presses; None where fewer than `MIN_PRESSES` tell one, or all
    tell none.
    """
    levels = [untouched_level(press.intensity, inverse_map) for press in presses]
    seen = [_believed(level.logs, level.covariance) for level in levels if level is not None]
    if len(seen) < MIN_PRESSES or not np.any(seen):
        return None
    believed = iter(seen)
    return np.stack(
        [
            _largest_patch(press) if level is None else next(believed)
            for press, level in zip(presses, levels, strict=True)
        ]
    )


def _largest_patch(press: UsedPress) -> Float64Array:
    """The drift on which most of the field agrees."""
    sights = untouched_levels(cell_logs(press.intensity))
    return _believed(sights[0].levels, sights[0].covariance + PATCH_SIGMA**2 * np.eye(3)) if sights else np.zeros(3)


def _seen(press: UsedPress, inverse_map: InverseMap) -> Float64Array:
    """The drift of a press under a map that tells it well; zero where no untouched skin is seen."""
    level = untouched_level(press.intensity, inverse_map)
    return np.zeros(3) if level is None else _believed(level.logs, level.covariance)


def _believed(logs: Float64Array, covariance: Float64Array) -> Float64Array:
    """The part of log levels that is a drift."""
    drift = logs * believed_share(logs, covariance)
    return drift if np.expm1(np.abs(drift).max()) <= MAX_DRIFT else np.zeros(3)

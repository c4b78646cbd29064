"""Checks that a frame was made as its calibration was: same lights, gel, exposure and orientation.

Three things that any scan shows, whatever was pressed. Most of its light lies over the field as in the reference,
not as in the reference turned or mirrored. Its colours are such as the balls showed. Its untouched skin reads 1.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from device.imaging.flat_field import DARK_FLOOR, NormalizedImage
from device.inverse_map.model import InverseMap
from device.surface import Float32Array, MaskArray
from host_sync.frame_checks.layout_check import HALF_TURNS

TURNED_FRACTION: Final = 0.7
"""A frame is turned when a turned reference leaves less than this share of what the reference leaves unexplained."""

OUT_OF_DOMAIN_DISTANCE: Final = 0.5
"""Distance from the calibrated colours, standard deviations, from which a colour is out of domain."""

MAX_OUT_OF_DOMAIN: Final = 0.25
"""Maximum fraction of out-of-domain pixels; valid frames stay below 10 %."""

MAX_DRIFT: Final = 0.15
"""Share by which untouched skin may differ from the reference in any colour; honest frames stay under 6 %."""

LARGEST_GAIN: Final = 4.0
"""Largest gain in standard deviations of the presses' own gains, where these differ more than that."""

MIN_REST: Final = 0.1
"""Fraction of the field that must be untouched to be judged: a few pixels that happen to look flat prove nothing."""

SAMPLES_ALONG: Final = 256
"""The frame is looked at with at most so many rows and columns, about; fewer will do where frames follow each other."""


def check_frame(
    intensity: NormalizedImage, flat_field: Float32Array, inverse: InverseMap, samples_along: int = SAMPLES_ALONG
) -> list[str]:
    """Return what speaks against a frame before anything is reconstructed, one clause each.

    flat_field : float32 array of shape (H, W, 3), what the frame was divided by
    samples_along : rows and columns that are sampled, about
    """
    warnings = []
    step = _step(intensity.shape, samples_along)
    turn = _turn(intensity, flat_field, step)
    if turn is not None:
        warnings.append(f"its light is distributed over the field as if it were {turn}")
    fraction = _out_of_domain_fraction(intensity, inverse, step)
    if fraction > MAX_OUT_OF_DOMAIN:
        warnings.append(
            f"{fraction:.0%} of its colours are unlike those of the balls (at most {MAX_OUT_OF_DOMAIN:.0%})"
        )
    return warnings


def check_datum(intensity: NormalizedImage, at_rest: MaskArray, gain_sigma: float = 0.0) -> list[str]:
    """Return what speaks against a frame whose untouched skin is known; nothing where no skin is untouched.

    gain_sigma : relative standard deviation by which the calibration's own presses differ from the reference
    """
    most = max(MAX_DRIFT, LARGEST_GAIN * gain_sigma)
    resting = np.count_nonzero(at_rest)
    if resting == at_rest.size or resting < MIN_REST * at_rest.size:
        return []
    step = _step(at_rest.shape, SAMPLES_ALONG)
    rest = intensity.values[::step, ::step][at_rest[::step, ::step]]
    if not rest.size:
        return []
    drift = np.median(rest, axis=0) - 1.0
    worst = int(np.abs(drift).argmax())
    if abs(float(drift[worst])) <= most:
        return []
    colour = ("red", "green", "blue")[worst]
    return [
        f"its untouched skin is {abs(float(drift[worst])):.0%} {'brighter' if drift[worst] > 0 else 'darker'} "
        f"in {colour} than the reference (at most {most:.0%})"
    ]


def _turn(intensity: NormalizedImage, flat_field: Float32Array, step: int) -> str | None:
    """Return the name of the turn under which the reference explains the frame far better, if there is one."""
    # Rows and columns from both ends alike, so that a turned reference lies where the reference does.
    first = ((intensity.shape[0] - 1) % step // 2, (intensity.shape[1] - 1) % step // 2)
    every = (slice(first[0], None, step), slice(first[1], None, step))
    rest = np.log(np.maximum(flat_field[every], np.float32(DARK_FLOOR)))
    shade = np.maximum(intensity.values[every], np.float32(DARK_FLOOR))
    light = np.log(shade) + rest
    left = _unexplained(light - rest)
    for turn in HALF_TURNS:
        if _unexplained(light - turn.of(rest)) < TURNED_FRACTION * left:
            return turn.name
    return None


def _unexplained(difference: NDArray[np.float32]) -> float:
    """Return the median distance of log light from its own median, mean over colours."""
    centred = np.abs(difference - np.median(difference, axis=(0, 1)))
    return float(np.median(centred, axis=(0, 1)).mean())


def _out_of_domain_fraction(intensity: NormalizedImage, inverse: InverseMap, step: int) -> float:
    usable = intensity.valid[::step, ::step] & ~intensity.clipped[::step, ::step]
    if not usable.any():
        return 0.0
    excess = inverse.domain.excess(np.ascontiguousarray(intensity.values[::step, ::step]))
    return float((excess[usable] > OUT_OF_DOMAIN_DISTANCE).mean())


def _step(shape: tuple[int, ...], samples_along: int) -> int:
    return max(1, max(shape[:2]) // samples_along)

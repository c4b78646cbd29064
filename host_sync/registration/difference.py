"""The difference of two presses of one object that remains after registration and levelling."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from device.align import Pose
from device.surface import Float32Array, Float64Array, HeightMap, MaskArray
from host_sync.errors import RegistrationRefused, ViewError
from host_sync.registration.fit import at_pitch, centred, moved
from host_sync.registration.register import MIN_AGREEMENT, NOTHING_IN_COMMON, Registration, register

MIN_FRACTION: Final = 0.02
"""Least common field, as a fraction of the first map."""

MAX_EQUATIONS: Final = 30_000
ROUNDS: Final = 4
TUKEY: Final = 4.685


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """The second height map minus the first, on the grid of the first.

    z_um : float32 array of shape (H, W), NaN where either is invalid
    registration : where the object lies in the second map, and how sure that is
    shift_um : (rows, columns), displacement of the object in the second map, at the centre, down and right positive
    shift_sigma_um : standard uncertainty of the shift along the direction that is known least; None if undetermined
    turn_deg : rotation of the object in the second map, clockwise on the screen
    offset_um, tilt : height (µm) and tilt (rows, columns; µm/µm) that were subtracted
    residual_um : root mean square of the difference
    median_um : median of its absolute value
    overlap_share : common field as a fraction of the first map
    sigma_um : float32 array of shape (H, W), combined standard uncertainty; None where a map has none
    """

    z_um: Float32Array
    registration: Registration
    shift_um: tuple[float, float]
    shift_sigma_um: float | None
    turn_deg: float
    offset_um: float
    tilt: tuple[float, float]
    residual_um: float
    median_um: float
    overlap_share: float
    sigma_um: Float32Array | None

    @property
    def warning(self) -> str:
        """Why a person's own shift may show two different objects; empty if they agree."""
        agreement = self.registration.agreement
        if agreement >= MIN_AGREEMENT:
            return ""
        return f"their slopes agree by only {100.0 * max(agreement, 0.0):.0f} %: they may show different things"


def difference(
    first: HeightMap,
    second: HeightMap,
    sigmas_um: tuple[Float32Array | None, Float32Array | None] = (None, None),
    *,
    frames: tuple[Float32Array, Float32Array] | None = None,
    near: Pose | None = None,
    pinned: bool = False,
) -> Difference:
    """Return the second height map minus the first, after registration and levelling; arguments as for `register`.

    sigmas_um : standard uncertainty of each, of its height map's shape, if known

    Raises
    ------
    ViewError
        They hardly overlap.
    RegistrationRefused
        Their registration cannot be trusted.
    """
    found = register(first, second, frames=frames, near=near, pinned=pinned)
    if not found.accepted:
        raise RegistrationRefused(
            f"not registered: {found.refused}: give the shift by hand, or choose other scans",
            found.pose.down,
            found.pose.right,
            found.pose.turn,
        )
    pitch_um, pose = first.pitch_um, found.pose
    rest = moved(at_pitch(second, pitch_um), pose, first.z_um.shape, 1) - first.z_um
    known = np.isfinite(rest)
    if known.mean() < MIN_FRACTION:
        raise ViewError(NOTHING_IN_COMMON)
    level = _level(rest, known)
    row, column = centred(rest.shape, rest.shape, 1)
    rest = rest - np.asarray(level[0] + level[1] * row + level[2] * column, np.float32)
    sigma_px = found.sigma_px
    return Difference(
        z_um=rest.astype(np.float32),
        registration=found,
        shift_um=(pose.down * pitch_um, pose.right * pitch_um),
        shift_sigma_um=sigma_px * pitch_um if np.isfinite(sigma_px) else None,
        turn_deg=float(np.degrees(pose.turn)),
        offset_um=float(level[0]),
        tilt=(float(level[1]) / pitch_um, float(level[2]) / pitch_um),
        residual_um=float(np.sqrt(np.mean(rest[known] ** 2))),
        median_um=float(np.median(np.abs(rest[known]))),
        overlap_share=float(known.mean()),
        sigma_um=_both(sigmas_um, second.pitch_um, pitch_um, pose, known),
    )


def _level(rest: Float32Array, known: MaskArray) -> Float64Array:
    """Return the height and tilts (µm, µm/px) that most of the difference has: least squares with Tukey weights."""
    row, column = (part[known] for part in centred(rest.shape, rest.shape, 1))
    step = max(1, row.size // MAX_EQUATIONS)
    design = np.stack([np.ones(row[::step].size), row[::step], column[::step]], axis=-1).astype(np.float64)
    target = rest[known][::step].astype(np.float64)
    weight = np.ones(target.size)
    found: Float64Array = np.zeros(3)
    for _ in range(ROUNDS):
        root = np.sqrt(weight)
        found = np.asarray(np.linalg.lstsq(design * root[:, None], target * root, rcond=None)[0], np.float64)
        off = np.abs(target - design @ found)
        spread = max(TUKEY * 1.4826 * float(np.median(off)), 1e-9)
        weight = np.clip(1.0 - (off / spread) ** 2, 0.0, None) ** 2
    return found


def _both(
    sigmas_um: tuple[Float32Array | None, Float32Array | None],
    pitch_um: float,
    wanted_um: float,
    pose: Pose,
    known: MaskArray,
) -> Float32Array | None:
    """Return the uncertainty of the difference of two independent maps, on the grid of the first.

    NaN where the difference is invalid; None where a map has no uncertainty.
    """
    first, second = sigmas_um
    if first is None or second is None:
        return None
    other = moved(at_pitch(HeightMap(second, pitch_um), wanted_um), pose, first.shape, 1)
    return np.where(known, np.hypot(first, other), np.float32(np.nan)).astype(np.float32)


# Copies of one press, which are no repeated measurements: no two presses have the same noise.

ROUNDING: Final = 1e-5
"""Difference of copies, as a fraction of the span of heights: rounding and the order of threads."""

SAMPLED_PX: Final = 128
"""Rows and columns that are compared, at most about twice as many."""


def are_copies(first_um: Float32Array, second_um: Float32Array) -> bool:
    """Return whether two height maps, float32 arrays of shape (H, W), come from the same frame.

    They do if nearly all heights agree pixel by pixel, apart from rounding.
    """
    if first_um.shape != second_um.shape:
        return False
    step = max(1, max(first_um.shape) // SAMPLED_PX)
    first_um, second_um = first_um[::step, ::step], second_um[::step, ::step]
    off = np.abs(first_um - second_um)
    known = np.isfinite(off)
    if not known.any():
        return False
    span_um = float(np.ptp(first_um[known]))
    return float(np.quantile(off[known], 0.99)) <= ROUNDING * span_um

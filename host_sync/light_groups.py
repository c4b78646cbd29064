"""Any number of lights as groups of three, each of which is calibrated and read as an RGB frame is.

Groups are those whose lights differ most, and together they hold every light. Where a light shows other than the others
predict, groups that hold it do not count. Why so, and what was tried: docs/decisions/0010-any-number-of-lights.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import cv2
import numpy as np

from device.balls.sphere import Ball, BallSamples, gather_samples
from device.errors import CalibrationError, CalibrationMismatch
from device.imaging.flat_field import DARK_FLOOR, SATURATED, LinearFrame, flat_field_correct
from device.inverse_map.near_light import GENTLE, direction_features, lit_by
from device.inverse_map.regressor import field_position, monomials, position_exponents
from device.surface import Float32Array, Float64Array, GradientField, MaskArray
from host_sync.frames.frame_set_file import MAX_LIGHTS

CHANNELS: Final = 3
SEEN_PLACES: Final = 20_000
CELL_PX: Final = 4
"""Lights are held against each other in cells of so many pixels: shadows and mirrors are larger, and noise is less."""

MIN_ALLOWED: Final = 0.03
SAFETY: Final = 3.0
"""A scan's lights may contradict each other by so many times what the presses' do, at least by the first."""

LEFT_OUT_WEIGHT: Final = 0.02
"""Weight of a group that holds a light which is left out: it counts where no other group is left."""

Group = tuple[int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class LightGroups:
    """The lights of a sensor.

    flat_field : float32 array of shape (H, W, N), light of untouched skin
    groups : of three lights each, every light in one of them at least
    matt : what predicts each light from the others
    typical : float64 array of shape (N,), median disagreement of each light in the presses
    allowed : by how much a frame's may differ from it
    names : of the lights, as messages call them
    """

    flat_field: Float32Array
    groups: tuple[Group, ...]
    matt: MattLights
    typical: Float64Array
    allowed: float
    names: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of lights."""
        return len(self.names)

    def check(self, frame: LinearFrame, name: str) -> list[str]:
        """Return what speaks against a frame: a light that shows other than the others predict.

        Nothing speaks against a frame of three lights or fewer.

        Raises
        ------
        CalibrationMismatch
            Another number of lights.
        """
        if frame.rgb.shape[2] != self.count:
            raise CalibrationMismatch(
                f"{name} shows {frame.rgb.shape[2]} lights and its calibration {self.count}: name one image a light"
            )
        off = np.median(_disagreement(self.matt, frame, self.flat_field).reshape(-1, self.count), axis=0)
        off = off - self.typical
        worst = int(np.argmax(np.abs(off)))
        if abs(off[worst]) <= self.allowed:
            return []
        direction = "brighter" if off[worst] > 0.0 else "darker"
        return [
            f"light {self.names[worst]} is {abs(off[worst]):.0%} {direction} than the others predict, where "
            f"{self.allowed:.0%} is usual: check the order of the images and that light"
        ]

    def left_out(self, frame: LinearFrame) -> list[MaskArray]:
        """Return where a light of each group is hidden, mirrored or saturated: bool arrays of shape (H, W)."""
        off = np.abs(_disagreement(self.matt, frame, self.flat_field)) / self.matt.tolerance
        worst = np.argmax(off, axis=-1)
        hidden = off.max(axis=-1) > 1.0
        rows, columns = frame.shape
        masks = []
        for group in self.groups:
            cells = (hidden & np.isin(worst, group)).astype(np.uint8)
            masks.append(cv2.resize(cells, (columns, rows), interpolation=cv2.INTER_NEAREST).astype(np.bool_))
        return masks


def in_group(frame: LinearFrame, group: Group) -> LinearFrame:
    """Return the three lights of a group as a frame of three channels; clipped where one of them is."""
    rgb = np.ascontiguousarray(frame.rgb[..., list(group)])
    return LinearFrame(rgb, np.any(rgb >= np.float32(SATURATED), axis=-1))


def choose_groups(frames: Sequence[LinearFrame]) -> tuple[Group, ...]:
    """Return groups of three of the lights that frames show: those whose answers to slopes differ most.

    Raises
    ------
    CalibrationError
        There are more lights than eight.
    """
    count = frames[0].rgb.shape[2]
    if count > MAX_LIGHTS:
        raise CalibrationError(f"{count} lights are more than {MAX_LIGHTS}: leave some out")
    answers = _answers(frames)
    volume = {group: abs(float(np.linalg.det(answers[list(group)]))) for group in combinations(range(count), CHANNELS)}
    number = -(-count // CHANNELS)
    covering = [
        chosen for chosen in combinations(volume, number) if len({n for group in chosen for n in group}) == count
    ]
    best = max(covering, key=lambda chosen: min(volume[group] for group in chosen))
    return tuple((group[0], group[1], group[2]) for group in best)


def _answers(frames: Sequence[LinearFrame]) -> Float64Array:
    """Return how lights change together, (N, 3): their part in the three largest changes over the frames."""
    count = frames[0].rgb.shape[2]
    step = max(1, int(np.sqrt(frames[0].clipped.size * len(frames) / SEEN_PLACES)))
    usual = np.median(np.stack([frame.rgb[::step, ::step] for frame in frames]), axis=0)
    seen = np.concatenate([(frame.rgb[::step, ::step] - usual).reshape(-1, count) for frame in frames])
    if len(frames) == 1:
        blurred = cv2.blur(frames[0].rgb, (frames[0].shape[1] // 8 * 2 + 1,) * 2).reshape(frames[0].rgb.shape)
        seen = (frames[0].rgb - blurred)[::step, ::step].reshape(-1, count)
    seen = seen / np.maximum(seen.std(axis=0), 1e-6)
    _, axes = np.linalg.eigh(seen.T.astype(np.float64) @ seen)
    return np.asarray(axes[:, ::-1][:, :CHANNELS])


def find_light_groups(
    groups: tuple[Group, ...],
    presses: Sequence[tuple[LinearFrame, Sequence[Ball]]],
    flat_field: Float32Array,
    names: Sequence[str],
) -> LightGroups:
    """Return the groups with the lights' directions that balls show.

    flat_field : float32 array of shape (H, W, N)
    names : of the lights; numbers from 1 where there are none
    """
    samples = gather_samples([(flat_field_correct(frame, flat_field), balls) for frame, balls in presses])
    matt = MattLights.of(samples, (flat_field.shape[0], flat_field.shape[1]))
    count = flat_field.shape[2]
    seen = np.array(
        [np.median(_disagreement(matt, frame, flat_field).reshape(-1, count), axis=0) for frame, _ in presses]
    )
    typical = np.median(seen, axis=0)
    allowed = max(MIN_ALLOWED, SAFETY * float(np.abs(seen - typical).max()))
    called = tuple(names) or tuple(str(number) for number in range(1, count + 1))
    return LightGroups(flat_field, groups, matt, typical, allowed, called)


def joined(gradients: Sequence[GradientField], left_out: Sequence[MaskArray]) -> GradientField:
    """Return slopes of groups as one: their mean by weight; groups with a light that is left out hardly count."""
    if len(gradients) == 1:
        return gradients[0]
    total = np.zeros(gradients[0].p.shape, np.float32)
    p, q, valid = np.zeros_like(total), np.zeros_like(total), np.zeros(total.shape, np.bool_)
    for field, out in zip(gradients, left_out, strict=True):
        weight = np.where(field.valid, field.weight, np.float32(0.0)) * np.where(out, LEFT_OUT_WEIGHT, 1.0)
        weight = weight.astype(np.float32)
        total += weight
        p += weight * np.where(field.valid, field.p, np.float32(0.0))
        q += weight * np.where(field.valid, field.q, np.float32(0.0))
        valid |= field.valid & (weight > 0.0)
    per_weight = np.float32(1.0) / np.maximum(total, np.float32(1e-12))
    weight = np.where(valid, total / np.float32(len(gradients)), np.float32(0.0)).astype(np.float32)
    p *= per_weight
    q *= per_weight
    return GradientField(p, q, valid, weight)


def _disagreement(matt: MattLights, frame: LinearFrame, flat_field: Float32Array) -> Float64Array:
    """Return the difference of each light from what the others predict, in cells: (h, w, N)."""
    rows, columns = frame.shape
    size = (max(columns // CELL_PX, 1), max(rows // CELL_PX, 1))
    cells = []
    for light in range(frame.rgb.shape[2]):
        rest = np.maximum(flat_field[..., light], np.float32(DARK_FLOOR))
        cells.append(cv2.resize(frame.rgb[..., light] / rest, size, interpolation=cv2.INTER_AREA))
    intensity = np.stack(cells, axis=-1).astype(np.float32)
    row, column = (
        (np.arange(count) + 0.5) * full / count - 0.5 for count, full in zip(size[::-1], (rows, columns), strict=True)
    )
    at = np.meshgrid(column, row)
    place = field_position(at[0].ravel(), at[1].ravel(), frame.shape)
    return matt.disagreement(intensity.reshape(-1, intensity.shape[2]), place).reshape(intensity.shape)


# Directions of lights as seen from each place, by which any of them can be predicted from the others.
#
# A matt skin of slope g shows, divided by its reference, s I_k = 1 + a_k(x, y)·g under light k, with s = √(1 + |g|²).
# Four lights or more are more equations than unknowns (1 / s, p / s, q / s): what one light shows can be held against
# what the others predict. A light that is hidden or mirrored is found that way.

NEEDED: Final = 3
"""Lights that brightness and both slopes need; of more, one can be left out."""

NEAR_DEGREE: Final = 2
FAR_DEGREE: Final = 0
NUMBERS_OF_TERMS: Final = tuple(len(position_exponents(degree)) for degree in (FAR_DEGREE, NEAR_DEGREE))
MIN_BALLS: Final = 6
"""Of fewer balls the lights' directions are taken to be the same all over the field."""

RARE_PERCENT: Final = 99.5
MIN_TOLERANCE: Final = 0.1
MARGIN: Final = 1.25
"""A light is left out where it is off by more than that percentile of ball pixels is, times the margin."""


@dataclass(frozen=True, slots=True, eq=False)
class MattLights:
    """Directions of lights.

    directions : float32 array of shape (N, K, 2), a's components by light and monomial of place
    tolerance : float32 array of shape (N,), intensity by which a light may differ from what the others predict
    """

    directions: Float32Array
    tolerance: Float32Array

    @classmethod
    def of(cls, samples: BallSamples, shape: tuple[int, int]) -> MattLights:
        """Return what gentle slopes on balls show, of a field (H, W)."""
        slope = np.stack([samples.p, samples.q], axis=-1).astype(np.float64)
        place = field_position(samples.column.astype(np.float64), samples.row.astype(np.float64), shape)
        degree = NEAR_DEGREE if len(np.unique(samples.ball)) >= MIN_BALLS else FAR_DEGREE
        gentle = np.linalg.norm(slope, axis=1) < GENTLE
        there = monomials(place[gentle], degree)
        p, q = slope[gentle].T
        bends = np.stack([p * p, p * q, q * q, p**3, p * p * q, p * q * q, q**3], axis=1)
        features = np.concatenate([direction_features(slope[gentle], there), bends], axis=1)
        penalty = 1e-3 * np.sqrt(max(int(gentle.sum()), 1)) * np.eye(features.shape[1])
        lit = lit_by(samples.intensity[gentle], slope[gentle])
        stacked = np.concatenate([lit, np.zeros((len(penalty), lit.shape[1]))])
        found = np.linalg.lstsq(np.concatenate([features, penalty]), stacked, rcond=None)[0]
        directions = found[: 2 * there.shape[1]].reshape(there.shape[1], 2, -1).transpose(2, 0, 1).astype(np.float32)
        lights = cls(np.ascontiguousarray(directions), np.full(len(directions), np.inf, np.float32))
        off = np.percentile(np.abs(lights.disagreement(samples.intensity, place)), RARE_PERCENT, axis=0)
        return cls(lights.directions, np.maximum(MARGIN * off, MIN_TOLERANCE).astype(np.float32))

    @property
    def degree(self) -> int:
        """Degree in place of the directions."""
        return NEAR_DEGREE if self.directions.shape[1] == len(position_exponents(NEAR_DEGREE)) else FAR_DEGREE

    def disagreement(self, intensity: Float32Array, place: Float64Array) -> Float64Array:
        """Return the difference of each light from what the others predict: (n, N), 0 where they predict nothing.

        intensity : float32 array of shape (n, N)
        place : position variables, float64 array of shape (n, 2)
        """
        if len(self.directions) <= NEEDED:
            return np.zeros(intensity.shape)
        a = np.tensordot(monomials(place, self.degree), self.directions.astype(np.float64), axes=(1, 1))
        system = np.concatenate([np.ones((*a.shape[:2], 1)), a], axis=-1)
        gram = np.einsum("nka,nkb->nab", system, system) + 1e-6 * np.eye(3)
        inverse = np.linalg.inv(gram)
        known = np.einsum("nab,nkb,nk->na", inverse, system, intensity)
        left = intensity - np.einsum("nka,na->nk", system, known)
        leverage = np.einsum("nka,nab,nkb->nk", system, inverse, system)
        return np.asarray(left / np.maximum(1.0 - leverage, 0.05))

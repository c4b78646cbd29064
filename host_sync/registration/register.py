"""Registers the second of two height maps to the first, or says why it cannot: a wrong shift is worse than none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from device.align import Complex, PlaceSearch, Pose, relief_slopes
from device.surface import Float32Array, Float64Array, HeightMap
from host_sync.errors import ViewError
from host_sync.registration.fit import Fit, Pair, at_pitch, coherence, fit, judged_at, middle_px, reduced

COARSE_PX: Final = 120
TURNS_DEG: Final = tuple(range(-24, 25, 3))
KEPT: Final = 5
"""Starts of each coarse search over all turns; one more is the best without a turn."""

TEXTURE_PX: Final = 768
TEXTURE_KEPT: Final = 2
MIN_OVERLAP: Final = 0.25
"""Least overlap of a start, as a fraction of the field."""

RIM: Final = 0.25
"""Fraction of the map's height, above which skin counts as pressed."""

FINE_PX: Final = 1024
REFINED: Final = 3
"""Coarse fits that are refined."""

MAX_SIGMA_PX: Final = 1.0 / 6.0
"""Largest standard uncertainty of an accepted shift, px: half a pixel is three of them."""

MIN_AGREEMENT: Final = 0.6
"""Least correlation of the slopes of two presses of one object. The same object with 1 µm of noise gives 0.99,
unrelated textures after registration at most 0.35, unrelated fields of three or four broad hills 0.65."""

APART_PX: Final = 2.0
"""Fits closer than so many coarse pixels are one answer."""

TURN_GAIN: Final = 0.97
"""A turn is accepted when the mean squared slope difference falls below this fraction of that without a turn."""

HOPS_DEG: Final = (-8.0, -4.0, 4.0, 8.0)
HOP_FRACTION: Final = 0.05
"""Turns and shifts (fraction of the field) around the best coarse fit that are tried as well."""

SEEN_TURN_DEG: Final = 0.05
"""Turn between two answers from which it is stated."""

START_PX: Final = 4.0
"""Starts closer than so many coarse pixels lead to one answer."""

RIVAL: Final = 1.5
"""Another answer competes unless its residual is larger than the best one's by this factor."""

RIVAL_UNLIKE: Final = 2.0
"""… and only if its slopes agree about as well: one less the agreement is at most so many times that of the best."""

RIVAL_ENERGY: Final = 0.6
"""… over at least this fraction of the squared slopes that the best answer has in common."""

UNLIKE_FLOOR: Final = 0.01
RIVAL_SIGMAS: Final = 3.0
"""… and by so many standard deviations over the tiles of the field."""

MIN_COHERENCE: Final = 0.5
"""Least correlation of both maps' change of slope along any direction: noise alone changes along a prism."""

SLIDES: Final = "the shift along one direction is not seen: the relief is the same there"
NOTHING_IN_COMMON: Final = "the two scans hardly overlap: choose two of the same place"

Start = tuple[Pose, str]
"""A pose to start from, and what it was found by."""

Answer = tuple[Fit, str]
"""A fit, and what its start was found by."""


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Place of the first map's object in the second map.

    pose : shift (px of the first map) and turn (rad) of the object, about the middle of the field
    covariance : float64 array of shape (3, 3) of down, right and turn, px and rad; infinite where undetermined
    agreement : correlation of the slopes over the common field, 1 for identical maps
    overlap_share : common field as a fraction of the first map
    by : what found it: "relief", "rim", "texture", "as they lie", "nudged" or "pinned"
    refused : why it is not to be used, one clause; empty when it is accepted
    """

    pose: Pose
    covariance: Float64Array
    agreement: float
    overlap_share: float
    by: str
    refused: str = ""

    @property
    def accepted(self) -> bool:
        """True if it may be used."""
        return not self.refused

    @property
    def sigma_px(self) -> float:
        """Standard uncertainty of the shift along the direction that is known least, px."""
        if not np.isfinite(self.covariance[:2, :2]).all():
            return float("inf")
        return float(np.sqrt(max(np.linalg.eigvalsh(self.covariance[:2, :2])[-1], 0.0)))


def register(
    first: HeightMap,
    second: HeightMap,
    *,
    frames: tuple[Float32Array, Float32Array] | None = None,
    near: Pose | None = None,
    pinned: bool = False,
) -> Registration:
    """Return the registration of two height maps.

    frames : grey frames of both on one gel, float32 arrays of shape (H, W), as one more source of starts
    near : the only start: a person saw that the answer is near to it
    pinned : take `near` as it is

    Raises
    ------
    ViewError
        They hardly overlap, or a map has no valid pixel.
    """
    other = at_pitch(second, first.pitch_um)
    for z_um in (first.z_um, other):
        if not np.isfinite(z_um).any():
            raise ViewError("one of the scans has no valid pixel: choose another")
    fine = Pair.of(first.z_um, other, FINE_PX)
    if near is not None:
        return _from_person(fine, near, pinned=pinned)
    found = _starts(first.z_um, other, frames)
    coarse = Pair.of(first.z_um, other, COARSE_PX)
    answers = _answers(fine, coarse, found)
    if not answers:
        raise ViewError(NOTHING_IN_COMMON)
    best, by = answers[0]
    rivals = [one for one, _ in answers[1:]]
    straight, straight_by = _straight(fine, coarse, found)
    if straight is not None and not _turn_is_seen(best, straight):
        # What is round is not turned: answers that turn it about itself are one.
        middle = middle_px(coarse)
        rivals = [
            one for one in (best, *rivals) if one.pose.distance_at(straight.pose, middle) > APART_PX * coarse.step
        ]
        best, by = straight, straight_by
    sure = max(coherence(pair, best.pose) for pair in (coarse, fine))
    refused = _rivalry(best, rivals)
    if sure < MIN_COHERENCE:
        refused = SLIDES
    return _judged(best, by, refused=refused)


def _from_person(pair: Pair, near: Pose, *, pinned: bool) -> Registration:
    """Return the registration near to a pose that a person gave, or that pose itself."""
    found = judged_at(pair, near) if pinned else fit(pair, near)
    if found is None:
        raise ViewError(NOTHING_IN_COMMON)
    if not pinned:
        straight = fit(pair, near, turning=False)
        if straight is not None and not _turn_is_seen(found, straight):
            found = straight
        return _judged(found, "nudged", SLIDES if coherence(pair, found.pose) < MIN_COHERENCE else "")
    return Registration(near, np.diag([np.inf] * 3), found.agreement, found.share, "pinned")


def _turn_is_seen(turned: Fit, straight: Fit) -> bool:
    """Return whether a fit with a turn of its own is enough better than one that keeps the turn it started from."""
    return bool(np.nanmean(turned.residual) <= TURN_GAIN * np.nanmean(straight.residual))


def _judged(found: Fit, by: str, refused: str = "") -> Registration:
    if found.agreement < MIN_AGREEMENT:
        refused = (
            f"their slopes agree by only {100.0 * max(found.agreement, 0.0):.0f} % (the same object: over "
            f"{100.0 * MIN_AGREEMENT:.0f} %): they may show different things"
        )
    elif not found.sigma_px <= MAX_SIGMA_PX:
        refused = refused or (
            f"the shift is known to ± {found.sigma_px:.2g} px only (at most {MAX_SIGMA_PX:.2g}): the relief is the "
            "same along one direction, or too little of it is seen"
        )
    return Registration(found.pose, found.covariance, found.agreement, found.share, by, refused)


def _answers(fine: Pair, coarse: Pair, given: list[Start]) -> list[Answer]:
    """Return the different fits that the starts lead to, best first."""
    different: list[Start] = []
    for start in given:
        if all(start[0].distance(one, coarse.reach_px) > START_PX * coarse.step for one, _ in different):
            different.append(start)
    rough = _fits(coarse, different, APART_PX * coarse.step)
    if rough:
        best, by = rough[0]
        rough = _fits(coarse, [(pose, by) for pose in _around(best.pose, coarse)], APART_PX * coarse.step, rough)
    return _fits(fine, [(one.pose, by) for one, by in rough[:REFINED]], APART_PX * coarse.step)


def _straight(fine: Pair, coarse: Pair, given: list[Start]) -> tuple[Fit | None, str]:
    """Return the best fit without a turn, and what found it; None where no start leads to one."""
    rough = _fits(coarse, [start for start in given if start[0].turn == 0.0], 0.0, turning=False)
    return (fit(fine, rough[0][0].pose, turning=False), rough[0][1]) if rough else (None, "")


def _fits(
    pair: Pair, given: list[Start], apart_px: float, known: Sequence[Answer] = (), *, turning: bool = True
) -> list[Answer]:
    """Return the fits that are known, and those that starts lead to and that lie apart from all others, best first."""
    found = list(known)
    for start, by in given:
        new = fit(pair, start, turning=turning)
        if new and all(new.pose.distance(one.pose, pair.reach_px) >= apart_px for one, _ in found):
            found.append((new, by))
    return sorted(found, key=lambda one: -one[0].agreement)


def _around(pose: Pose, coarse: Pair) -> Iterator[Pose]:
    """Yield poses around one: turned about the middle of the object, and shifted."""
    place = middle_px(coarse)
    for turn_deg in HOPS_DEG:
        turned = pose.moved_by(0.0, 0.0, float(np.radians(turn_deg)))
        yield turned.moved_by(*(pose.of(place) - turned.of(place)))
    hop = HOP_FRACTION * max(coarse.first.shape) * coarse.step
    for down, right in ((hop, 0.0), (-hop, 0.0), (0.0, hop), (0.0, -hop)):
        yield pose.moved_by(down, right)


def _rivalry(best: Fit, others: list[Fit]) -> str:
    """Return why another answer is as good as the best; empty where none is."""
    for one in others:
        unlike = 1.0 - one.agreement > RIVAL_UNLIKE * max(1.0 - best.agreement, UNLIKE_FLOOR)
        if unlike or one.energy < RIVAL_ENERGY * best.energy:
            continue
        ratio = float(np.nanmean(one.residual) / max(float(np.nanmean(best.residual)), 1e-30))
        more = (one.residual - best.residual)[np.isfinite(one.residual) & np.isfinite(best.residual)]
        sure = more.size > 2 and more.mean() > RIVAL_SIGMAS * more.std() / np.sqrt(more.size)
        if ratio < RIVAL or not sure:
            return f"two places compete: the maps agree about as well {_apart(one.pose, best.pose)} from the best one"
    return ""


def _apart(one: Pose, best: Pose) -> str:
    """Return where one pose lies from another, in words: "3.1 px up and 2.0 px right, turned by 0.40°"."""
    down, right = one.down - best.down, one.right - best.right
    words = f"{abs(down):.1f} px {'down' if down >= 0.0 else 'up'} and {abs(right):.1f} px "
    words += "right" if right >= 0.0 else "left"
    turn_deg = float(np.degrees(one.turn - best.turn))
    return words if abs(turn_deg) < SEEN_TURN_DEG else f"{words}, turned by {abs(turn_deg):.2f}°,"


# Starts of a registration: the best places of several coarse searches over shift and turn.
#
# Each search can be led astray by itself: slopes by an object that slides along itself, the rim of contact by another
# depth, the texture of the frames by what is fixed to the gel. So all of them give starts, and none decides.


def _starts(
    first: Float32Array, second: Float32Array, frames: tuple[Float32Array, Float32Array] | None = None
) -> list[Start]:
    """Return starts from relief and rim, best first within each, and from the texture of frames of one gel.

    frames : grey arrays (H, W) of one size
    """
    step = -(-max(*first.shape, *second.shape) // COARSE_PX)
    small = [reduced(z_um, step) for z_um in (first, second)]
    found = [(Pose(), "as they lie")]
    for by, maps in (("relief", small), ("rim", [_rim(z_um) for z_um in small])):
        slopes = [relief_slopes(z_um)[0] for z_um in maps]
        for turns_deg, count in ((TURNS_DEG, KEPT), ((0,), 1)):
            found += [(pose, by) for pose in _poses(slopes, step, turns_deg, count)]
    if frames is not None:
        step = -(-max(frames[0].shape) // TEXTURE_PX)
        textures = [np.log(np.maximum(reduced(frame, step), np.float32(1e-4))) for frame in frames]
        slopes = [relief_slopes(texture)[0] for texture in textures]
        found += [(pose, "texture") for pose in _poses(slopes, step, (0,), TEXTURE_KEPT)]
    return found


def _poses(slopes: list[Complex], step: int, turns_deg: tuple[int, ...], count: int) -> list[Pose]:
    """Return the best poses by the slopes of two maps that are reduced by `step`, px of the first."""
    one, other = slopes
    search = PlaceSearch(np.maximum(one.shape, other.shape).tolist(), turns_deg, MIN_OVERLAP)
    # A registration counts from where the first's middle lies in the second when both lie corner on corner.
    middle = [0.5 * step * (there - here) for here, there in zip(one.shape, other.shape, strict=True)]
    return [
        place.pose.in_units_of(1.0 / step).moved_by(*middle)
        for place in search.places(search.first(one), search.second(other), count)
    ]


def _rim(z_um: Float32Array) -> Float32Array:
    """1 where the skin is pressed, 0 elsewhere, NaN where invalid: float32 array of shape (h, w)."""
    known = z_um[np.isfinite(z_um)]
    if not known.size:
        return z_um
    low, high = np.percentile(known, [5.0, 99.0])
    pressed = (z_um > low + RIM * (high - low)).astype(np.float32)
    return np.where(np.isfinite(z_um), pressed, np.float32(np.nan)).astype(np.float32)

"""The files of a mosaic: an ordinary result, and beside it the record of its links."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from device.align import Pose
from device.surface import Float32Array, HeightMap
from host_sync.mosaic.adjustment import Adjusted
from host_sync.mosaic.blending import Blend, Canvas, Levels, Meeting
from host_sync.mosaic.links import Link
from host_sync.mosaic.presses import MOSAIC_FILE, Press
from host_sync.registration.fit import reduced
from host_sync.render.relief_sheet import write_relief
from host_sync.results.doubts import record_doubts
from host_sync.results.field_file import write_field, write_mask
from host_sync.results.files import EXTRAPOLATED_FILE, HEIGHT_FILE, HEIGHT_SIGMA_FILE, RECORD_FILE, RELIEF_FILE
from host_sync.results.record import HeightScale, ResultRecord, encode_record
from host_sync.text import some_of

MOSAIC_SCHEMA: Final = "retrograph.mosaic/1"

STATED_BY_FIGURES: Final = frozenset({"failed calibration", "extrapolated slopes", "no zero"})
"""Doubts of presses that the mosaic's own record states."""


class PlaceRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Place of a press in the mosaic, and the plane that was added to it.

    row_px, column_px : its middle, px of the mosaic from the middle of the first pixel
    turn_deg : of the press, clockwise on the screen
    sigma_um : standard uncertainty of its place relative to the press at the root
    added_um, added_slope : height at its middle, and slopes along columns and rows (µm/µm)
    """

    name: str
    row_px: float
    column_px: float
    turn_deg: float
    sigma_um: float
    added_um: float
    added_slope: tuple[float, float]


class LinkRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Relative place of two presses; None where it was not found.

    down_um, right_um, turn_deg : of the object from the first to the second
    sigma_um : standard uncertainty of the shift at the overlap, along the direction that is known least
    agreement : correlation of the slopes over the overlap
    overlap_share : overlap as a fraction of the first press
    stretch : by how much the second is larger than the first, relative
    loops : loops of three or four presses that it closes
    used : whether the mosaic holds to it
    rejected : why it does not, one clause
    residual_um, residual_sigmas : how far the places of the mosaic are from it
    seam_um, seam_sigmas : root mean square of what lies between both heights over the overlap
    seam_beyond_2_sigmas : share of the overlap that differs by more than 2 σ
    """

    first: str
    second: str
    down_um: float
    right_um: float
    turn_deg: float
    sigma_um: float | None
    agreement: float
    overlap_share: float
    stretch: float | None = None
    loops: int = 0
    used: bool = False
    rejected: str = ""
    residual_um: float | None = None
    residual_sigmas: float | None = None
    seam_um: float | None = None
    seam_sigmas: float | None = None
    seam_beyond_2_sigmas: float | None = None


class MosaicRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Record of a mosaic.

    root : the press that uncertainties of places are relative to
    left_out : presses that no link joins to the others
    unusable : a sentence for each press that was asked for and has no results, or none that can be read
    stretch_median : median of the links' stretch, and the median of its absolute value; None without links
    span_um, span_sigma_um : distance of the two presses farthest apart, and its standard uncertainty from the links
    covered_share : fraction of the mosaic's pixels with a height
    period_um : distance after which the relief repeats itself, where places may be off by it; else None
    without_sigma : presses that state no uncertainty of their heights; with one of them the mosaic has none
    """

    schema: str = MOSAIC_SCHEMA
    name: str
    pixel_pitch_um: float
    press_pixels: int
    root: str
    presses: tuple[PlaceRecord, ...]
    left_out: tuple[str, ...] = ()
    unusable: tuple[str, ...] = ()
    links: tuple[LinkRecord, ...] = ()
    stretch_median: float | None = None
    stretch_spread: float | None = None
    span_um: float
    span_sigma_um: float
    covered_share: float
    period_um: float | None = None
    without_sigma: tuple[str, ...] = ()

    @property
    def used(self) -> tuple[LinkRecord, ...]:
        """The links that the mosaic holds to."""
        return tuple(link for link in self.links if link.used)

    @property
    def rejected(self) -> tuple[LinkRecord, ...]:
        """Links that looked right by themselves and do not fit the others."""
        return tuple(link for link in self.links if not link.used and link.residual_um is not None)


def encode_mosaic(record: MosaicRecord) -> bytes:
    """Return the bytes of `mosaic.json`."""
    return msgspec.json.format(msgspec.json.encode(record), indent=2)


METHOD: Final = "mosaic"
PICTURE_PX: Final = 1600
SAMPLES: Final = 1_000_000
SEAM_SIGMAS: Final = 2.0


def write_mosaic(
    folder: Path, name: str, members: list[Press], record: MosaicRecord, canvas: Canvas, blended: Blend
) -> None:
    """Write the mosaic's fields, picture and records to a folder."""
    pitch_um = record.pixel_pitch_um
    write_field(folder / HEIGHT_FILE, blended.z_um, pitch_um, "height, um")
    if not record.without_sigma:
        write_field(folder / HEIGHT_SIGMA_FILE, blended.sigma_um, pitch_um, "standard uncertainty of height, um")
    if blended.extrapolated.any():
        write_mask(folder / EXTRAPOLATED_FILE, blended.extrapolated > 0)
    step = max(1, -(-max(canvas.shape) // PICTURE_PX))
    write_relief(folder / RELIEF_FILE, HeightMap(reduced(blended.z_um, step), pitch_um * step), name)
    (folder / MOSAIC_FILE).write_bytes(encode_mosaic(record))
    (folder / RECORD_FILE).write_bytes(encode_record(_result_record(name, members, record, blended)))
    for path in folder.glob("*.sum"):
        path.unlink()


def mosaic_record(
    name: str, presses: list[Press], plan: Plan, canvas: Canvas, covered: float, unusable: Sequence[str] = ()
) -> MosaicRecord:
    """Return what is known of the mosaic's places and links.

    unusable : why presses that were asked for are not among `presses`
    """
    pitch_um = presses[0].record.pixel_pitch_um
    stretches = [link.stretch for link, used in zip(plan.links, plan.adjusted.used, strict=True) if used]
    stretches = [value for value in stretches if np.isfinite(value)]
    ends = max(
        itertools.combinations(sorted(plan.places), 2),
        key=lambda pair: plan.places[pair[0]].distance(plan.places[pair[1]], 0.0),
    )
    return MosaicRecord(
        name=name,
        pixel_pitch_um=pitch_um * canvas.step,
        press_pixels=canvas.step,
        root=presses[plan.adjusted.root].name,
        presses=tuple(_place_records(presses, plan, canvas)),
        left_out=tuple(press.name for number, press in enumerate(presses) if number not in plan.places),
        unusable=tuple(unusable),
        links=tuple(_link_records(presses, plan)),
        stretch_median=float(np.median(stretches)) if stretches else None,
        stretch_spread=float(np.median(np.abs(stretches))) if stretches else None,
        span_um=plan.places[ends[0]].distance(plan.places[ends[1]], 0.0) * pitch_um,
        span_sigma_um=plan.adjusted.distance_sigma_px(*ends) * pitch_um,
        covered_share=covered,
        period_um=None if plan.period_px is None else plan.period_px * pitch_um,
        without_sigma=tuple(presses[number].name for number in sorted(plan.without_sigma)),
    )


def _place_records(presses: list[Press], plan: Plan, canvas: Canvas) -> Iterator[PlaceRecord]:
    pitch_um = presses[0].record.pixel_pitch_um
    for number, plane in zip(sorted(plan.places), plan.levels.planes, strict=True):
        place = plan.places[number]
        variance = plan.adjusted.covariance[3 * number : 3 * number + 2, 3 * number : 3 * number + 2]
        yield PlaceRecord(
            name=presses[number].name,
            row_px=(place.down - canvas.top) / canvas.step,
            column_px=(place.right - canvas.left) / canvas.step,
            turn_deg=float(np.degrees(place.turn)),
            sigma_um=float(np.sqrt(max(np.linalg.eigvalsh(variance)[-1], 0.0))) * pitch_um,
            added_um=float(plane[0]),
            added_slope=(float(plane[1]) / pitch_um, float(plane[2]) / pitch_um),
        )


def _link_records(presses: list[Press], plan: Plan) -> Iterator[LinkRecord]:
    pitch_um, found = presses[0].record.pixel_pitch_um, plan.adjusted
    for number, link in enumerate(plan.links):
        residual_px, sigmas = found.residual_px[number], found.residual_sigmas[number]
        known, used = np.isfinite(residual_px), found.used[number]
        why = ""
        if not used:
            why = f"off by {residual_px * pitch_um:.3g} µm ({sigmas:.1f} σ) from the other links"
            if not known:
                why = "joins presses that are left out"
        yield msgspec.structs.replace(
            _link_record(presses, link, pitch_um),
            loops=found.loops[number],
            used=used,
            rejected=why,
            residual_um=residual_px * pitch_um if known else None,
            residual_sigmas=sigmas if known else None,
            **_seam(plan, number),
        )
    for link in plan.refused:
        yield _link_record(presses, link, pitch_um)


def _link_record(presses: list[Press], link: Link, pitch_um: float) -> LinkRecord:
    pose = link.pose
    sigma_um = link.sigma_px * pitch_um if np.isfinite(link.covariance).all() else None
    return LinkRecord(
        first=presses[link.first].name,
        second=presses[link.second].name,
        down_um=pose.down * pitch_um,
        right_um=pose.right * pitch_um,
        turn_deg=float(np.degrees(link.turn)),
        sigma_um=sigma_um,
        agreement=link.agreement,
        overlap_share=link.overlap_share,
        stretch=link.stretch if np.isfinite(link.stretch) else None,
        rejected=link.refused,
    )


def _seam(plan: Plan, number: int) -> dict[str, float]:
    """Return what lies between both presses of a link after levelling; empty where it is not in use."""
    one = plan.meetings.get(number)
    if one is None or not one.apart_um.size:
        return {}
    apart_um = plan.levels.apart_um(one)
    seam_um = float(np.sqrt(np.mean(apart_um**2)))
    if plan.without_sigma & {plan.links[number].first, plan.links[number].second}:
        return {"seam_um": seam_um}
    sigmas = np.abs(apart_um) / one.sigma_um
    return {
        "seam_um": seam_um,
        "seam_sigmas": float(np.sqrt(np.mean(sigmas**2))),
        "seam_beyond_2_sigmas": float(np.mean(sigmas > SEAM_SIGMAS)),
    }


def _result_record(name: str, members: list[Press], mosaic: MosaicRecord, blended: Blend) -> ResultRecord:
    """Return the record of the mosaic as a result."""
    records = [press.record for press in members]
    rows, columns = blended.z_um.shape
    step = max(1, int(np.sqrt(rows * columns / SAMPLES)))
    sigma_um = blended.sigma_um[::step, ::step]
    known = sigma_um[np.isfinite(sigma_um)]
    calibrations = sorted({record.calibration_id for record in records} - {""})
    passed = [record.calibration_passed for record in records]
    scales = {record.height_scale for record in records}
    return ResultRecord(
        name=name,
        program=f"retrograph {version('retrograph')}",
        written_utc=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        method=METHOD,
        calibration_id=" ".join(calibrations),
        surface_detail=records[0].surface_detail,
        rows=rows,
        columns=columns,
        pixel_pitch_um=mosaic.pixel_pitch_um,
        height_min_um=_extreme(blended.z_um, np.fmin),
        height_max_um=_extreme(blended.z_um, np.fmax),
        height_sigma_median_um=float(np.median(known)) if known.size and not mosaic.without_sigma else None,
        height_zero="none: heights are relative, as each press has a level of its own",
        masked_share=1.0 - mosaic.covered_share,
        extrapolated_share=float(blended.extrapolated.mean()),
        warnings=tuple(_warnings(members, mosaic)),
        calibration_passed=False if False in passed else None if None in passed else True,
        calibration_failed_checks=tuple(dict.fromkeys(one for own in records for one in own.calibration_failed_checks)),
        height_scale=scales.pop() if len(scales) == 1 else HeightScale(),
    )


def _extreme(z_um: Float32Array, which: np.ufunc) -> float | None:
    value = float(which.reduce(which.reduce(z_um, axis=0)))
    return value if np.isfinite(value) else None


def _warnings(members: list[Press], mosaic: MosaicRecord) -> Iterator[str]:
    """Yield why to distrust the mosaic, and what its presses warn of."""
    if mosaic.left_out:
        yield f"left out, as no overlap was found: {some_of(mosaic.left_out)}"
    if mosaic.unusable:
        yield f"left out: {some_of(mosaic.unusable)}"
    linked = {name for link in mosaic.used for name in (link.first, link.second) if link.loops > 0}
    alone = [place.name for place in mosaic.presses if place.name not in linked]
    if alone:
        yield f"the place of {some_of(alone)} rests on overlaps that no other overlap confirms"
    if mosaic.period_um is not None:
        yield (
            f"the relief repeats every {mosaic.period_um * 1e-3:.2g} mm: places may be off by that, as the "
            "layout is no closer than half of it"
        )
    if mosaic.without_sigma:
        yield f"uncertainty is unknown, as it is of {some_of(mosaic.without_sigma)}"
    steps = [link for link in mosaic.used if (link.seam_sigmas or 0.0) > SEAM_SIGMAS]
    steps.sort(key=lambda one: -(one.seam_sigmas or 0.0))
    if steps:
        seams = [f"{one.first} and {one.second} ({one.seam_um:.3g} µm, {one.seam_sigmas:.1f} σ)" for one in steps]
        yield f"heights differ by more than {SEAM_SIGMAS:g} σ where presses overlap: {some_of(seams)}"
    counts: dict[str, list[str]] = {}
    for press in members:
        for doubt in record_doubts(press.record):
            if doubt.kind not in STATED_BY_FIGURES:
                counts.setdefault(doubt.reason, []).append(press.name)
    for words, names in counts.items():
        yield f"{words} ({some_of(names)})"


# All that a mosaic is made from, but the heights.


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Links, places and levels.

    refused : links that were refused by themselves
    links : the others
    adjusted : of `links`
    places : of the presses that have one, by number, in a mosaic that is not turned in the mean
    meetings : of the links in use, by their number among `links`; presses are numbered as in `levels`
    levels : planes of the presses in `places`, in their order
    without_sigma : presses that state no uncertainty of their heights, by number
    period_px : distance after which the relief repeats itself, where places may be off by it; else None
    """

    refused: list[Link]
    links: list[Link]
    adjusted: Adjusted
    places: dict[int, Pose]
    meetings: dict[int, Meeting]
    levels: Levels
    without_sigma: frozenset[int] = frozenset()
    period_px: float | None = None

"""A mosaic of presses: overlaps found and verified, places and levels adjusted, heights blended and written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from scipy import fft
from scipy.ndimage import map_coordinates

from device.align import APART_PX, Pose, relief_slopes
from device.io.atomic import atomic_directory
from host_sync.errors import MosaicError
from host_sync.mosaic.adjustment import adjusted
from host_sync.mosaic.blending import Meeting, blend, canvas_of, levelled, meeting
from host_sync.mosaic.links import COARSE_PX, RIVALLED, Layout, candidates, verified
from host_sync.mosaic.presses import Press, Small, check_together, read_small, small_of
from host_sync.mosaic.writing import MosaicRecord, Plan, mosaic_record, write_mosaic
from host_sync.registration.fit import reduced
from host_sync.results.files import RECORD_FILE

ALIKE: Final = 0.6
"""Correlation of slopes with themselves at a distance from which they repeat."""

BETWEEN: Final = 0.5
"""Share of it below which the correlation must fall on the way."""

MIN_OVERLAP: Final = 0.3
"""Least part of a press that is compared with itself."""


def period_px(press: Small) -> float | None:
    """Return the shortest distance at which a press looks like itself, px of the press; None where none does."""
    step = -(-max(press.z_um.shape) // COARSE_PX)
    slopes, _ = relief_slopes(reduced(press.z_um, step))
    rows, columns = slopes.shape
    shape = (fft.next_fast_len(2 * rows), fft.next_fast_len(2 * columns))
    known = (slopes != 0.0).astype(np.float32)
    power = np.abs(slopes) ** 2
    agreement = fft.ifft2(np.abs(fft.fft2(slopes, shape)) ** 2).real
    # The power of both pieces where they overlap.
    covers = fft.ifft2(np.conj(fft.fft2(power, shape)) * fft.fft2(known, shape)).real
    covers = 0.5 * (covers + np.roll(covers[::-1, ::-1], 1, (0, 1)))
    overlap = fft.ifft2(np.abs(fft.fft2(known, shape)) ** 2).real
    enough = overlap >= MIN_OVERLAP * float(known.sum())
    correlation = fft.fftshift(np.where(enough, agreement / np.maximum(covers, 1e-9), 0.0))
    middle = np.array([size // 2 for size in shape])
    row, column = np.meshgrid(*(np.arange(size) - at for size, at in zip(shape, middle, strict=True)), indexing="ij")
    distance = np.hypot(row, column)
    alike = np.argwhere((correlation > ALIKE) & (distance > APART_PX))
    for at in sorted(alike, key=lambda one: float(distance[tuple(one)])):
        way = middle[:, None] + np.linspace(0.0, 1.0, 33) * (at - middle)[:, None]
        if float(map_coordinates(correlation, way, order=1).min()) < BETWEEN * correlation[tuple(at)]:
            return float(distance[tuple(at)] * step * press.step)
    return None


def repeats_px(presses: list[Small]) -> float | None:
    """Return the shortest period of a mosaic's presses, px; None where fewer than half of them repeat."""
    found = [period for period in map(period_px, presses) if period is not None]
    return min(found) if 2 * len(found) >= len(presses) and found else None


Progress = Callable[[str], None]


def stitch(
    presses: list[Press],
    out: Path,
    *,
    layout: Layout | None = None,
    left_out: Sequence[str] = (),
    report_progress: Progress = lambda _: None,
) -> MosaicRecord:
    """Return the mosaic of the presses, written to the directory `out` as a result; returns its record.

    left_out : a sentence for each press that is missing among `presses`; those that cannot be read are added

    Raises
    ------
    MosaicError
        The presses do not go together, fewer than two can be read, or no two of them overlap.
    OutputError
        The place cannot be written; what stood there stands.
    """
    check_together(presses, left_out)
    small, unread = read_small(presses, report_progress)
    unusable = (*left_out, *unread)
    presses = [presses[number] for number in small]
    check_together(presses, unusable)
    if layout is not None:
        layout = Layout(layout.places_px[list(small)], layout.within_px)
    plan = _plan(presses, list(small.values()), layout, report_progress)
    numbers = sorted(plan.places)
    members = [presses[number] for number in numbers]
    places = [plan.places[number] for number in numbers]
    canvas = canvas_of(places, [press.shape for press in members])
    with atomic_directory(out, RECORD_FILE) as folder:
        blended = blend(
            members,
            places,
            plan.levels,
            canvas,
            folder,
            lambda done: report_progress(f"blending: {done} of {len(members)}"),
        )
        report_progress("writing")
        record = mosaic_record(out.name, presses, plan, canvas, blended.covered, unusable)
        write_mosaic(folder, out.name, members, record, canvas, blended)
    return record


def planned(presses: list[Press], *, layout: Layout | None = None, report_progress: Progress = lambda _: None) -> Plan:
    """Return where the presses lie and how they are levelled; errors as for `stitch`."""
    check_together(presses)
    return _plan(presses, [small_of(press) for press in presses], layout, report_progress)


def _plan(presses: list[Press], small: list[Small], layout: Layout | None, report_progress: Progress) -> Plan:
    """Return the plan of presses that were read."""
    report_progress("looking for overlaps")
    period_px = repeats_px(small)
    if period_px is not None and layout is None:
        period_mm = period_px * presses[0].record.pixel_pitch_um * 1e-3
        raise MosaicError(
            f"the relief repeats every {period_mm:.2g} mm, so that overlaps agree at several places: say with --layout "
            "where the presses are, closer than half of that"
        )
    wanted = candidates(small, layout)
    links = verified(small, wanted, lambda done: report_progress(f"registering: {done} of {len(wanted)}"))
    good = [link for link in links if not link.refused]
    if not good and any(link.refused == RIVALLED for link in links):
        raise MosaicError("the presses agree at several places, as a pattern repeats: say where they are with --layout")
    if not good:
        raise MosaicError("no two presses overlap with one relief: press with a third of the field in common")
    report_progress("adjusting")
    reach_px = 0.5 * float(np.hypot(*presses[0].shape))
    found = adjusted(good, len(presses), reach_px)
    known = {number: place for number, place in enumerate(found.places) if place is not None}
    mean = Pose(0.0, 0.0, -float(np.mean([place.turn for place in known.values()])))
    known = {number: place.then(mean) for number, place in known.items()}
    order = {number: at for at, number in enumerate(sorted(known))}
    meetings = {}
    for number, (link, used) in enumerate(zip(good, found.used, strict=True)):
        if used:
            between = known[link.first].then(known[link.second].back())
            meetings[number] = _renumbered(meeting(small, link.first, link.second, between), order)
    levels = levelled(list(meetings.values()), len(known), reach_px)
    without_sigma = frozenset(number for number in known if not small[number].has_sigma)
    return Plan(
        [link for link in links if link.refused],
        good,
        found,
        known,
        meetings,
        levels,
        without_sigma,
        _doubted(period_px, layout),
    )


def _doubted(period_px: float | None, layout: Layout | None) -> float | None:
    """Return the period that a layout leaves room for; None where none does."""
    if period_px is None or layout is None or layout.within_px < 0.5 * period_px:
        return None
    return period_px


def _renumbered(one: Meeting, order: dict[int, int]) -> Meeting:
    return Meeting(order[one.first], order[one.second], one.here, one.there, one.apart_um, one.sigma_um)

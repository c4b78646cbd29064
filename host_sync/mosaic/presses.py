"""The presses of a mosaic, read from their results when they are needed and kept reduced for what compares them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from device.align import Pose
from device.surface import Float32Array, Float64Array, MaskArray
from host_sync.errors import MosaicError, UnreadableResult
from host_sync.registration.difference import are_copies
from host_sync.registration.fit import reduced
from host_sync.results.files import RECORD_FILE
from host_sync.results.reader import read_result
from host_sync.results.record import ResultRecord, read_record
from host_sync.text import some_of

MOSAIC_FILE: Final = "mosaic.json"


REDUCED_PX: Final = 480
"""Rows or columns of the reduced height map, at most."""

SAME_PITCH: Final = 1e-3
"""Relative difference of pixel pitches of one mosaic."""


@dataclass(frozen=True, slots=True, eq=False)
class Fields:
    """Fields of a press, arrays of shape (H, W).

    z_um : float32, height, NaN where invalid
    sigma_um : float32, standard uncertainty of the height, NaN where invalid; None if unknown
    extrapolated : bool, slopes beyond the calibration's where skin is not known to be untouched; None if unknown
    """

    z_um: Float32Array
    sigma_um: Float32Array | None = None
    extrapolated: MaskArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """One press: its record and, on demand, its fields."""

    name: str
    record: ResultRecord
    read: Callable[[], Fields]

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of its fields."""
        return self.record.rows, self.record.columns


@dataclass(frozen=True, slots=True, eq=False)
class Small:
    """A press reduced by `step`.

    z_um, sigma_um : float32 arrays of shape (h, w); σ is 0 where it is not known
    full : (H, W) of the press
    has_sigma : whether the press states one at all
    """

    z_um: Float32Array
    sigma_um: Float32Array
    step: int
    full: tuple[int, int]
    has_sigma: bool = True

    def centred(self, places: ArrayLike) -> Float64Array:
        """Return places of the reduced map (row, column) as px of the press from its middle."""
        return (np.asarray(places) + 0.5) * self.step - 0.5 * np.array(self.full)

    def in_cells(self, other: Small, pose: Pose) -> Pose:
        """Return a pose to another press (px of a press) in cells of the reduced maps, from their middles."""
        here, there = (press.centred(0.5 * np.array(press.z_um.shape) - 0.5) for press in (self, other))
        return Pose(turn=pose.turn).moved_by(*(pose.of(here) - there) / self.step)


def press_of(folder: Path, library: Path | None = None) -> Press:
    """Return the press whose result is in a folder; its fields are read later.

    library : in which the result is one of a scan, whose name the press then has

    Raises
    ------
    UnreadableResult
        There is no readable record.
    """
    record = read_record(folder)

    def read() -> Fields:
        found = read_result(folder, samples=False)
        return Fields(found.height.z_um, found.sigma_um, found.extrapolated)

    name = record.scan_id if library is not None and record.scan_id else folder.absolute().name
    return Press(name, record, read)


def presses_of(
    folders: Sequence[Path], out: Path, library: Path | None = None, left_out: list[str] | None = None
) -> list[Press]:
    """Return the presses whose results are in the folders.

    out : where their mosaic will be written
    library : as for `press_of`
    left_out : receives a sentence for each result without a readable record; None raises the first

    Raises
    ------
    MosaicError
        One is a mosaic itself, or the mosaic would replace a press or lie among the library's scans.
    UnreadableResult
        There is no readable record, and `left_out` is None.
    """
    _check_apart(folders, out)
    if library is not None and (library / "scans").resolve() in out.resolve().parents:
        raise MosaicError(f"{out}: lies in the library's scans, which hold results of one scan each: name another")
    presses = []
    for folder in folders:
        try:
            presses.append(press_of(folder, library))
        except UnreadableResult as error:
            if left_out is None:
                raise
            left_out.append(str(error))
    return presses


def _check_apart(folders: Iterable[Path], out: Path) -> None:
    """Refuse inputs that are mosaics, and an output that would replace a press."""
    target = out.resolve()
    for folder in folders:
        own = folder.resolve()
        if (own / MOSAIC_FILE).is_file():
            raise MosaicError(f"{folder}: is a mosaic: name the results of its presses")
        if own == target or own in target.parents or target in own.parents:
            raise MosaicError(f"{out}: would replace or lie in {folder}, which is a press of it: name another folder")
    if (target / RECORD_FILE).is_file() and not (target / MOSAIC_FILE).is_file():
        raise MosaicError(f"{out}: holds a result that is no mosaic: name another folder")


def check_together(presses: Sequence[Press], left_out: Sequence[str] = ()) -> None:
    """Refuse presses that no mosaic can be made of.

    left_out : why others cannot be used, for the message

    Raises
    ------
    MosaicError
        There are fewer than two, two have one name, or their pixel pitches or sizes differ.
    """
    if len(presses) < 2:
        what = f"; left out: {some_of(left_out)}" if left_out else ": name their results"
        raise MosaicError(f"a mosaic needs two presses or more{what}")
    names = [press.name for press in presses]
    for name in names:
        if names.count(name) > 1:
            raise MosaicError(f"two presses are named {name}: name each result once, or rename a folder")
    pitch_um = presses[0].record.pixel_pitch_um
    for press in presses:
        if abs(press.record.pixel_pitch_um / pitch_um - 1.0) > SAME_PITCH:
            raise MosaicError(
                f"{press.name}: has a pixel pitch of {press.record.pixel_pitch_um:g} µm and {names[0]} one of "
                f"{pitch_um:g} µm: presses of one mosaic need one pitch, so stitch those of each pitch by themselves"
            )
        if press.shape != presses[0].shape:
            raise MosaicError(
                f"{press.name}: has {press.shape[1]}x{press.shape[0]} pixels and {names[0]} "
                f"{presses[0].shape[1]}x{presses[0].shape[0]}: presses of one mosaic need one size"
            )


def small_of(press: Press) -> Small:
    """Return the press reduced to `REDUCED_PX`.

    Raises
    ------
    MosaicError
        It has no valid pixel, or is too small.
    """
    fields = press.read()
    step = max(1, -(-max(press.shape) // REDUCED_PX))
    z_um = reduced(fields.z_um, step)
    if min(z_um.shape) < 16 or not np.isfinite(z_um).any():
        raise MosaicError(f"{press.name}: holds too few heights for a mosaic: leave it out")
    sigma_um = np.zeros(z_um.shape, np.float32)
    if fields.sigma_um is not None:
        sigma_um = np.nan_to_num(reduced(fields.sigma_um, step))
    return Small(z_um, sigma_um, step, press.shape, fields.sigma_um is not None)


def read_small(presses: Sequence[Press], report_progress: Callable[[str], None]) -> tuple[dict[int, Small], list[str]]:
    """Return the presses that can be used, reduced, by number; and a sentence for each other one."""
    small: dict[int, Small] = {}
    left_out: list[str] = []
    for number, press in enumerate(presses):
        report_progress(f"reading: {number + 1} of {len(presses)}")
        try:
            found = small_of(press)
            copied = next((other for other, one in small.items() if are_copies(one.z_um, found.z_um)), None)
            if copied is not None:
                left_out.append(f"{press.name}: is a copy of {presses[copied].name}, not another press")
                continue
            small[number] = found
        except (MosaicError, UnreadableResult) as error:
            left_out.append(str(error))
    return small, left_out

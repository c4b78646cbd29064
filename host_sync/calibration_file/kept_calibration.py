"""A calibration as it is kept: the models, their report, and what it was made from, in one file.

What was just made is used as its own file would be read: a later run with the file gives the same bits.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Final

from device.bundles.calibration import CalibrationBundle
from device.errors import RecordError
from device.io.atomic import atomic_directory, check_output, write_output
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.frames import CalibrationFrames, calibrate_frames
from host_sync.calibration_file.archive import Facts, read_archive, write_archive
from host_sync.calibration_file.soundness import check_sound
from host_sync.calibration_report.report import (
    BALL_PICTURES,
    PAPER_PICTURES,
    REPORT_FILE,
    calibration_lines,
    report_files,
)
from host_sync.errors import CalibrationFileError
from host_sync.frames.frame_set_file import Encoding
from host_sync.results.files import OVERVIEW_FILE
from host_sync.results.typed_members import READ_ERRORS, as_members, from_members

REPORT_MEMBERS: Final = "report/"
REPORT_NAMES: Final = frozenset({REPORT_FILE, *BALL_PICTURES})
PAPER_REPORT_NAMES: Final = frozenset(PAPER_PICTURES)
"""Of a report whose calibration holds the paper's model, too. No other member of a file is written to a folder of
reports."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class KeptCalibration:
    """A calibration with its report and its origin.

    report : files of the report by name
    """

    calibration: Calibration
    report: dict[str, bytes]
    facts: Facts

    def __repr__(self) -> str:
        return f"<KeptCalibration {self.facts.calibration_id} of {self.facts.made_from}: {self.summary[0]}>"

    @property
    def summary(self) -> tuple[str, ...]:
        """Verdict and key values; then what to press next, and notes, one sentence each."""
        return calibration_lines(self.calibration)

    def write_report(self, target: Path) -> None:
        """Write the report to the directory `target`, replacing its contents.

        Raises
        ------
        OutputError
            The directory cannot be written.
        """
        with atomic_directory(target, REPORT_FILE) as folder:
            for name, data in self.report.items():
                (folder / name).write_bytes(data)

    def as_file(self) -> bytes:
        """Return contents of its file."""
        members = as_members(self.calibration)
        members |= {f"{REPORT_MEMBERS}{name}": data for name, data in self.report.items()}
        stream = BytesIO()
        write_archive(stream, self.facts, members)
        return stream.getvalue()

    def write(self, path: str | Path) -> None:
        """Write its file.

        Raises
        ------
        OutputError
            The place cannot be written; an old file stays.
        """
        check_output(Path(path))
        write_output(Path(path), self.as_file())


def make_calibration(
    frames: CalibrationFrames, facts: Callable[[Calibration], Facts], tell: Callable[[str], None] = lambda _: None
) -> KeptCalibration:
    """Return the calibration that frames carry, with its report; errors as for `calibrate`."""
    calibration = calibrate_frames(frames, tell)
    tell("drawing the calibration's report")
    report = report_files(calibration)
    return KeptCalibration(from_members(as_members(calibration), Calibration), report, facts(calibration))


def facts_of(
    calibration: Calibration,
    made_from: str,
    key: str = "",
    *,
    encoding: Encoding | None = None,
    full_scale: int | None = None,
    pixel_shape: float = 1.0,
    marks_px: float = 0.0,
    bundle: CalibrationBundle | None = None,
) -> Facts:
    """Return what the file of a calibration that is made now says of itself."""
    record = None if bundle is None else bundle.record
    return Facts(
        calibration_id=calibration.calibration_id,
        program=f"retrograph {version('retrograph')}",
        made_utc=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        made_from=made_from,
        key=key,
        encoding=encoding,
        full_scale=full_scale,
        pixel_shape=pixel_shape,
        marks_px=marks_px,
        bundle_id=None if record is None else record.calibration_id,
        gel_id=None if record is None else record.gel_id,
        fingerprint=None if record is None else record.fingerprint,
        channel_order=None if bundle is None else bundle.reference().bayer_order,
    )


def read_calibration_file(source: Path | bytes, name: str | None = None) -> KeptCalibration:
    """Return the calibration in a file, or in the bytes of one that is called `name`.

    Raises
    ------
    CalibrationFileError
        It is missing, damaged, of another version of the program, or no calibration.
    """
    called = name or str(source)
    facts, members = read_archive(source, called)
    report = {
        file.removeprefix(REPORT_MEMBERS): data for file, data in members.items() if file.startswith(REPORT_MEMBERS)
    }
    try:
        calibration = from_members(members, Calibration)
        check_sound(calibration, called)
    except (*READ_ERRORS, RecordError) as error:
        raise CalibrationFileError(
            f"{called}: is no calibration of this version of retrograph ({error}): calibrate again"
        ) from error
    pictures = REPORT_NAMES if calibration.paper is None else REPORT_NAMES | PAPER_REPORT_NAMES
    if set(report) - {OVERVIEW_FILE} != pictures or facts.calibration_id != calibration.calibration_id:
        raise CalibrationFileError(f"{called}: its report is not that of its calibration: calibrate again")
    return KeptCalibration(calibration, report, facts)

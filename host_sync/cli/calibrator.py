"""Calibrations as commands name them, and what is said of where each came from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from device.bundles.calibration import read_calibration
from host_sync.cli.console import print_line
from host_sync.errors import CalibrationFileError
from host_sync.frames.frame_set import load_frame_set
from host_sync.library.library import Library

if TYPE_CHECKING:
    from host_sync.calibration_file.calibrator import Calibrator
    from host_sync.calibration_file.kept_calibration import KeptCalibration

Tell = Callable[[str], None]


def calibrator_for(
    named: Path | None, tell: Tell, facts: list[dict[str, object]] | None = None, *, paper: bool = False
) -> Calibrator:
    """Return the calibrator of a command: the named file, else the user's cache or the frames themselves.

    facts : receives those of each calibration, instead of the output
    paper : whether the paper's model is needed

    Raises
    ------
    CalibrationFileError
        The named file cannot be read, or does not hold the paper's model.
    """
    from host_sync.calibration_file.cache import CalibrationCache
    from host_sync.calibration_file.calibrator import Calibrator

    def obtained(kept: KeptCalibration, source: str) -> None:
        if facts is None:
            say_calibration(kept, source)
        else:
            facts.append(calibration_facts(kept, source))

    if named is None:
        return Calibrator(CalibrationCache.of_user(), tell=tell, obtained=obtained, paper=paper)
    if named.is_dir():
        raise CalibrationFileError(f"{named} is a folder: name a file that `retrosync calibrate` wrote")
    tell("reading the calibration")
    return Calibrator.of_file(named, obtained=obtained, paper=paper)


def obtain_calibration(name: str, library: Path | None, tell: Tell, *, paper: bool = False) -> KeptCalibration:
    """The calibration of that name: a file of `retrosync calibrate`, a frame set, a calibration's folder, or its id.

    library : folder of pulled calibrations, of which `name` is an id or its beginning or end
    paper : whether the paper's model is needed

    Raises
    ------
    HostError, DeviceError
        There is none, or it is damaged.
    """
    from host_sync.calibration_file.archive import is_archive
    from host_sync.calibration_file.cache import CalibrationCache
    from host_sync.calibration_file.calibrator import Calibrator

    calibrator = Calibrator(CalibrationCache.of_user(), tell=tell, obtained=say_source, paper=paper)
    path = Path(name)
    if library is not None:
        return calibrator.of_bundle(Library(library).find_calibration(name))
    if path.is_dir():
        return calibrator.of_bundle(read_calibration(path))
    if is_archive(path):
        tell("reading the calibration")
        return Calibrator.of_file(path, obtained=say_source, paper=paper).named()
    return calibrator.of_frame_set(load_frame_set(path))


def calibration_facts(kept: KeptCalibration, source: str) -> dict[str, object]:
    """Return which calibration is used, where it came from, and its verdict."""
    calibration = kept.calibration
    return {
        "calibration_id": kept.facts.calibration_id,
        "made_from": kept.facts.made_from,
        "made_utc": kept.facts.made_utc,
        "source": source,
        "passed": calibration.assessment.passed,
        "balls": sum(len(press.balls) for press in calibration.presses),
        "held_out_error_deg": calibration.held_out_deg,
        "pixel_pitch_um": calibration.pitch_um,
        "notes": calibration.assessment.notes,
    }


def say_source(kept: KeptCalibration, source: str) -> None:
    """Print which calibration is used and where it came from."""
    print_line(f"calibration {kept.facts.calibration_id} of {kept.facts.made_from}, {source}")


def say_calibration(kept: KeptCalibration, source: str) -> None:
    """Print the calibration and its verdict."""
    from host_sync.calibration_report.summary import calibration_lines

    say_source(kept, source)
    for line in calibration_lines(kept.calibration):
        print_line(line)

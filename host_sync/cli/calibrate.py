"""`retrosync calibrate`: a calibration as one file; or, with certified specimens, the certificate of an instrument."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from device.bundles.calibration import CALIBRATION_MANIFEST, read_calibration
from device.command_line import Folder
from device.io.atomic import check_output, write_output
from host_sync.cli.console import DONE, PARTLY, announce_compiling, print_error, print_line, status_spinner
from host_sync.errors import CalibrationFileError, FrameSetError
from host_sync.frames.frame_set import load_frame_set
from host_sync.frames.frame_set_file import SET_FILE, set_file
from host_sync.frames.linear_light import read_frame
from host_sync.library.library import Library

if TYPE_CHECKING:
    from device.imaging.flat_field import LinearFrame
    from host_sync.calibration_file.calibrator import Calibrator
    from host_sync.calibration_file.kept_calibration import KeptCalibration
    from host_sync.certificate.certificate import Certificate


def calibrate_command(
    source: str,
    /,
    *,
    out: Folder,
    library: Folder | None = None,
    paper: bool = False,
    check: Annotated[tuple[Path, ...], Parameter(consume_multiple=True)] = (),
) -> int:
    """Calibrate once and keep the calibration in a file; with --check, judge the instrument by certified specimens.

    A picture next to the file shows every press with its ball, used or not and why, the error by place, and the
    reference read as a scan. Ends with 1 when the calibration did not pass, or the instrument does not agree with a
    specimen or cannot be judged by it. The file is written in any case.

    Parameters
    ----------
    source
        A frame set with calibration presses, its file or its folder; or a calibration's folder; with --library, a
        calibration's id.
    out
        The calibration's file. With --check, the folder for certificate.pdf, certificate.json, the calibration's
        report, and the result of every scan.
    library
        Folder of pulled calibrations.
    paper
        Also fit the model of Johnson & Adelson's paper, which `--method paper` needs.
    check
        TOML files of certified specimens: step, groove, sphere, roughness, period or flat.
    """
    if check:
        if library is not None:
            raise FrameSetError("--check judges the instrument of a frame set: leave out --library")
        return _certify(Path(source), check, out)
    if out.is_dir():
        raise FrameSetError(f"{out} is a folder: name a file for the calibration, such as {out / 'gel.calibration'}")
    check_output(out)
    announce_compiling()
    from host_sync.reconstruction.scans import with_overview
    from host_sync.results.files import OVERVIEW_FILE

    with status_spinner() as report_progress:
        report_progress("loading compiled code")
        kept = obtain_calibration(source, library, report_progress, paper=paper)
        report_progress("drawing the overview")
        kept = with_overview(kept, None if library else _reference_of(set_file(Path(source))))
        kept.write(out)
        picture = out.with_name(f"{out.name}.png")
        write_output(picture, kept.report[OVERVIEW_FILE])
    for line in kept.summary:
        print_line(line)
    print_line(str(out))
    print_line(str(picture))
    return DONE if kept.calibration.assessment.passed else PARTLY


def _reference_of(source: Path) -> LinearFrame | None:
    """Return the frame of untouched skin of a frame set; None of another source, or where the set names none."""
    if source.suffix != ".toml":
        return None
    reference = load_frame_set(source).reference
    return read_frame(reference) if reference else None


def _certify(frame_set: Path, check: tuple[Path, ...], out: Path) -> int:
    """Measure the specimens and write the certificate."""
    described = load_frame_set(frame_set)
    announce_compiling()
    from host_sync.certificate.certificate import certificate_of_frame_set, verdict_words
    from host_sync.report.writing import NO_BROWSER

    with status_spinner() as report_progress:
        certificate, pages = certificate_of_frame_set(
            described, check, out, report_progress, calibrator_for(None, report_progress)
        )
    for line in _lines(certificate):
        print_line(line)
    for one in certificate.specimens:
        for words in one.words:
            print_error(f"{one.name}: {words}", PARTLY)
    print_line(verdict_words(certificate))
    for page in pages:
        print_line(str(page))
    if len(pages) == 1:
        print_error(NO_BROWSER, PARTLY)
    return DONE if certificate.agrees and len(pages) > 1 else PARTLY


def _lines(certificate: Certificate) -> list[str]:
    """Return specimens and characteristics, one a line."""
    from host_sync.certificate.certificate import pages_of

    specimens, characteristics, *_ = pages_of(certificate).tables
    return [" | ".join(row) for row in (*specimens.rows, *characteristics.rows)]


# Calibrations as commands name them, and what is said of where each came from.

Progress = Callable[[str], None]


def calibrator_for(
    named: Path | None,
    report_progress: Progress,
    facts: list[dict[str, object]] | None = None,
    *,
    paper: bool = False,
) -> Calibrator:
    """Return the calibrator of a command: the named file, else the user's cache or the frames themselves.

    facts : receives those of each calibration, instead of the output
    paper : whether the paper's model is needed

    Raises
    ------
    CalibrationFileError
        The named file cannot be read, or does not hold the paper's model.
    """
    from host_sync.calibration_file.calibrator import Calibrator
    from host_sync.calibration_file.inputs import CalibrationCache

    def obtained(kept: KeptCalibration, source: str) -> None:
        if facts is None:
            say_calibration(kept, source)
        else:
            facts.append(calibration_facts(kept, source))

    if named is None:
        return Calibrator(CalibrationCache.of_user(), report_progress=report_progress, obtained=obtained, paper=paper)
    if named.is_dir():
        raise CalibrationFileError(f"{named} is a folder: name a file that `retrosync calibrate` wrote")
    report_progress("reading the calibration")
    return Calibrator.of_file(named, obtained=obtained, paper=paper)


def obtain_calibration(
    name: str, library: Path | None, report_progress: Progress, *, paper: bool = False
) -> KeptCalibration:
    """Return the calibration of that name: a calibration file, a frame set, a folder, or an id.

    library : folder of pulled calibrations, of which `name` is an id or its beginning or end
    paper : whether the paper's model is needed

    Raises
    ------
    HostError, DeviceError
        There is none, or it is damaged.
    """
    from host_sync.calibration_file.calibrator import Calibrator
    from host_sync.calibration_file.inputs import CalibrationCache
    from host_sync.calibration_file.kept_calibration import is_archive

    calibrator = Calibrator(
        CalibrationCache.of_user(), report_progress=report_progress, obtained=say_source, paper=paper
    )
    if library is not None:
        return calibrator.of_bundle(Library(library).find_calibration(name))
    path = set_file(Path(name))
    if path.is_dir():
        if not os.path.lexists(path / CALIBRATION_MANIFEST):
            raise FrameSetError(
                f"{path}: holds no {SET_FILE} and no {CALIBRATION_MANIFEST}: `retrosync import` describes its images"
            )
        return calibrator.of_bundle(read_calibration(path))
    if is_archive(path):
        report_progress("reading the calibration")
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
    from host_sync.calibration_report.report import calibration_lines

    say_source(kept, source)
    for line in calibration_lines(kept.calibration):
        print_line(line)

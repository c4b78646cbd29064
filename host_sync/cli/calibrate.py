"""`retrosync calibrate`: a calibration as one file; or, with certified specimens, the certificate of an instrument."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from device.command_line import Folder
from device.io.atomic import check_output, write_output
from host_sync.cli.calibrator import calibrator_for, obtain_calibration
from host_sync.cli.console import DONE, PARTLY, print_error, print_line, status_spinner, tell_of_compiling
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import load_frame_set
from host_sync.frames.linear_light import read_frame

if TYPE_CHECKING:
    from device.imaging.flat_field import LinearFrame
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

    A picture beside the file shows every press with its ball, used or not and why, the error by place, and the
    reference read as a scan. Ends with 1 when the calibration did not pass, or the instrument does not agree with a
    specimen or cannot be judged by it. The file is written all the same.

    Parameters
    ----------
    source
        The frame set's file, whose presses calibrate; or a calibration's folder; with --library, a calibration's id.
    out
        The calibration's file. With --check, the folder for certificate.pdf, certificate.json, the calibration's
        report, and the result of every scan.
    library
        Folder of pulled calibrations.
    paper
        Also fit the model of the paper's method, which `--method paper` needs.
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
    tell_of_compiling()
    from host_sync.reconstruction.calibration_overview import with_overview
    from host_sync.results.files import OVERVIEW_FILE

    with status_spinner() as tell:
        tell("loading compiled code")
        kept = obtain_calibration(source, library, tell, paper=paper)
        tell("drawing the overview")
        kept = with_overview(kept, _reference_of(source))
        kept.write(out)
        picture = out.with_name(f"{out.name}.png")
        write_output(picture, kept.report[OVERVIEW_FILE])
    for line in kept.summary:
        print_line(line)
    print_line(str(out))
    print_line(str(picture))
    return DONE if kept.calibration.assessment.passed else PARTLY


def _reference_of(source: str) -> LinearFrame | None:
    """The frame of untouched skin of a frame set; None of another source, or where the set names none."""
    if not source.endswith(".toml"):
        return None
    reference = load_frame_set(Path(source)).reference
    return read_frame(reference) if reference else None


def _certify(frame_set: Path, check: tuple[Path, ...], out: Path) -> int:
    """Measure the specimens and write the certificate."""
    described = load_frame_set(frame_set)
    tell_of_compiling()
    from host_sync.certificate.certificate import verdict_words
    from host_sync.certificate.certificate_job import certificate_of_frame_set
    from host_sync.report.writing import NO_BROWSER

    with status_spinner() as tell:
        certificate, pages = certificate_of_frame_set(described, check, out, tell, calibrator_for(None, tell))
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
    """Specimens and characteristics, one a line."""
    from host_sync.certificate.certificate_pages import pages_of

    specimens, characteristics, *_ = pages_of(certificate).tables
    return [" | ".join(row) for row in (*specimens.rows, *characteristics.rows)]

"""`retrosync calibrate`: judges an instrument by certified specimens and writes its calibration certificate."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from host_sync.cli.compile_notice import tell_of_compiling
from host_sync.cli.console import DONE, PARTLY, Folder, print_error, print_line, status_spinner
from host_sync.frames.frame_set import load_frame_set

if TYPE_CHECKING:
    from host_sync.certificate.certificate import Certificate


def register(app: App) -> None:
    """Add the command."""
    app.command(calibrate_command, name="calibrate")


def calibrate_command(
    frame_set: Path,
    *,
    out: Folder,
    check: Annotated[tuple[Path, ...], Parameter(consume_multiple=True)],
) -> int:
    """Calibrate from a frame set, measure certified specimens, and write the calibration certificate.

    Ends with 1 when the instrument does not agree with a specimen, or cannot be judged by it.

    Parameters
    ----------
    frame_set
        The frame set's file; its presses calibrate.
    out
        Folder for certificate.pdf, certificate.json, the calibration's report, and the result of every scan.
    check
        TOML files of certified specimens: step, groove, sphere, roughness, period or flat.
    """
    described = load_frame_set(frame_set)
    tell_of_compiling()
    from host_sync.certificate.certificate import verdict_words
    from host_sync.certificate.certificate_job import PAGES_FILE, certificate_of_frame_set

    with status_spinner() as tell:
        certificate = certificate_of_frame_set(described, check, out, tell)
    for line in _lines(certificate):
        print_line(line)
    for one in certificate.specimens:
        for words in one.words:
            print_error(f"{one.name}: {words}", PARTLY)
    print_line(verdict_words(certificate))
    print_line(str(out / PAGES_FILE))
    return DONE if certificate.agrees else PARTLY


def _lines(certificate: Certificate) -> list[str]:
    """Specimens and characteristics, one a line."""
    from host_sync.certificate.certificate_pages import pages_of

    specimens, characteristics, *_ = pages_of(certificate).tables
    return [" | ".join(row) for row in (*specimens.rows, *characteristics.rows)]

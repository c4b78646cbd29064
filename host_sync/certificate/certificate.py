"""The certificate of an instrument as a report: every specimen measured, and JSON, HTML and PDF written."""

from __future__ import annotations

import hashlib
import io
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Final, Literal

import msgspec
from matplotlib.figure import Figure

from device.errors import DeviceError
from device.io.atomic import check_replaceable, write_output
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.calibration_report.report import REPORT_FILE
from host_sync.certificate.characteristics import Characteristic, CheckedSpecimen, characteristics
from host_sync.certificate.specimen_measurement import (
    MAX_E_N,
    ScanTable,
    SpecimenFile,
    SpecimenResult,
    judge,
    measured_quantity,
    read_specimen,
)
from host_sync.errors import HostError, MeasurementError
from host_sync.frames.frame_set import FrameSet, FrameSpec
from host_sync.frames.frame_set_file import CALIBRATION_FOLDER, read_frame_set_file
from host_sync.frames.linear_light import read_frame
from host_sync.measurement.quantity import Quantity, decimals
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.reconstruction.result_writer import write_result
from host_sync.registration.difference import are_copies
from host_sync.report.writing import Picture, Report, Table, find_browser, write_report
from host_sync.results.doubts import CERTIFICATE_FILE
from host_sync.results.reader import ResultSurface, read_result
from host_sync.text import printable

# The calibration certificate of an instrument: what it is, how it agrees with specimens, and its characteristics.

SCHEMA: Final = "retrograph.certificate/1"
Verdict = Literal["agrees", "does not agree", "not judged"]


class HashedFile(msgspec.Struct, frozen=True):
    """A file that the certificate rests on: its name, size and SHA-256."""

    name: str
    size: int
    sha256: str


class Certificate(msgspec.Struct, frozen=True, kw_only=True):
    """The whole certificate; lengths µm, expanded uncertainties with k = 2.

    verdict : "agrees" when every specimen's |E_n| is at most one and none failed
    calibration_checks : the calibration's own checks, a sentence each
    """

    schema: str = SCHEMA
    program: str
    written_utc: str
    instrument: str
    calibration_id: str
    calibration_passed: bool
    calibration_notes: tuple[str, ...]
    pixel_pitch_um: float
    rows: int
    columns: int
    balls: int
    held_out_error_deg: float | None
    verdict: Verdict
    specimens: tuple[SpecimenResult, ...]
    characteristics: tuple[Characteristic, ...]
    files: tuple[HashedFile, ...]

    @property
    def agrees(self) -> bool:
        """True if every specimen was judged and agrees."""
        return self.verdict == "agrees"


def certify(
    instrument: str, calibration: Calibration, checked: Sequence[CheckedSpecimen], files: Sequence[HashedFile]
) -> Certificate:
    """Return the certificate of a calibration from its checked specimens.

    instrument : the frame set's name
    """
    rows, columns, _ = calibration.flat_field.shape
    results = tuple(one.result for one in checked)
    held_out = calibration.held_out_deg[calibration.preferred]
    return Certificate(
        program=f"retrograph {version('retrograph')}",
        written_utc=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        instrument=instrument,
        calibration_id=calibration.calibration_id,
        calibration_passed=calibration.assessment.passed,
        calibration_notes=(*calibration.assessment.notes, *calibration.frame_model.blind),
        pixel_pitch_um=calibration.pitch_um,
        rows=rows,
        columns=columns,
        balls=sum(len(press.balls) for press in calibration.presses),
        held_out_error_deg=held_out if held_out == held_out else None,
        verdict=verdict_of(results),
        specimens=results,
        characteristics=characteristics(checked),
        files=tuple(files),
    )


def verdict_of(results: Sequence[SpecimenResult]) -> Verdict:
    """Return what all specimens together say: one that disagrees decides, and one that failed leaves it open."""
    judged = [result for result in results if result.kind != "flat"]
    if any(result.agrees is False for result in judged):
        return "does not agree"
    if not judged or any(result.agrees is None for result in judged):
        return "not judged"
    return "agrees"


def verdict_words(certificate: Certificate) -> str:
    """Return the verdict as a sentence."""
    if certificate.verdict == "agrees":
        return f"The instrument agrees with every specimen: no |E_n| is above {MAX_E_N:g}."
    if certificate.verdict == "does not agree":
        off = [one.name for one in certificate.specimens if one.agrees is False]
        return f"The instrument does not agree with {', '.join(off)}: |E_n| is above {MAX_E_N:g}."
    return "The instrument is not judged: a specimen is missing, or its number or uncertainty is not known."


PAGES = "certificate"
Progress = Callable[[str], None]


def certificate_of_frame_set(
    frame_set: FrameSet,
    specimens: Sequence[Path],
    out: Path,
    report_progress: Progress = lambda _: None,
    calibrator: Calibrator | None = None,
) -> tuple[Certificate, list[Path]]:
    """Judge the instrument that a frame set calibrates, and return its certificate's pages; all is written to `out`.

    specimens : files as `read_specimen` reads them
    calibrator : gives the calibration; by default it is made now

    Raises
    ------
    FrameSetError, DeviceError
        There is no calibration to judge.
    MeasurementError
        A specimen's file cannot be used.
    ResultError, OSError
        Nothing can be written to `out`.
    """
    read = [(path, read_specimen(path)) for path in specimens]  # before minutes of work
    check_replaceable(out / CALIBRATION_FOLDER, REPORT_FILE)
    kept = (calibrator or Calibrator(report_progress=report_progress)).of_frame_set(frame_set)
    kept.write_report(out / CALIBRATION_FOLDER)
    calibration = kept.calibration
    form = FrameSpec((), read_frame_set_file(frame_set.path).encoding, frame_set.full_scale, frame_set.pixel_shape)
    checked = [
        check_specimen(path, one, calibration, form, out / f"{number:02d}-{path.stem}", report_progress)
        for number, (path, one) in enumerate(read, start=1)
    ]
    certificate = certify(frame_set.name, calibration, checked, list(_hashed(frame_set.path, read)))
    return certificate, write_certificate(certificate, out)


def write_certificate(certificate: Certificate, out: Path) -> list[Path]:
    """Write `certificate.json`, `.html` and, where there is a browser, `.pdf` to a folder; return the last two."""
    write_output(out / CERTIFICATE_FILE, msgspec.json.format(msgspec.json.encode(certificate), indent=2))
    return write_report(pages_of(certificate), out / PAGES, find_browser())


def check_specimen(
    path: Path,
    specimen: SpecimenFile,
    calibration: Calibration,
    form: FrameSpec,
    out: Path,
    report_progress: Progress,
) -> CheckedSpecimen:
    """Reconstruct and measure every scan of a specimen, and judge the values.

    A scan that fails or copies an earlier one is named in the specimen's result.

    form : of its images, which are not named in it
    """
    surfaces: list[ResultSurface] = []
    quantities: list[Quantity] = []
    failures: list[str] = []
    for number, scan in enumerate(specimen.scan, start=1):
        report_progress(f"{specimen.name}: scan {number} of {len(specimen.scan)}")
        try:
            surface = _surface(path.parent, scan, calibration, form, out / f"scan-{number:02d}", specimen.name)
            if any(are_copies(one.height.z_um, surface.height.z_um) for one in surfaces):
                raise MeasurementError(f"scan {number} is a copy of an earlier one: it is not used")
            quantity = measured_quantity(specimen, surface)
        except (DeviceError, HostError) as error:
            failures.append(str(error))
            continue
        surfaces.append(surface)
        quantities.append(quantity)
    return CheckedSpecimen(specimen, judge(specimen, quantities, failures), tuple(surfaces))


def _surface(
    folder: Path, scan: ScanTable, calibration: Calibration, form: FrameSpec, out: Path, name: str
) -> ResultSurface:
    """Return the surface of one scan: read where it was reconstructed before, else reconstructed now."""
    if scan.result is not None:
        surface = read_result(folder / scan.result)
        if surface.record.calibration_id != calibration.calibration_id:
            raise MeasurementError(
                f"{folder / scan.result}: was reconstructed with calibration {surface.record.calibration_id} and "
                f"{calibration.calibration_id} is to be judged: name the image, or reconstruct it again"
            )
        return surface
    frame = replace(form, images=tuple(folder / image for image in _images(scan)))
    reconstruction = reconstruct(read_frame(frame), calibration, frame.name, keep_noise=True)
    write_result(out, reconstruction, calibration, name)
    return read_result(out)


def _images(scan: ScanTable) -> tuple[str, ...]:
    assert scan.image is not None  # noqa: S101 - checked where the file was read
    return (scan.image,) if isinstance(scan.image, str) else scan.image


def _hashed(frame_set: Path, specimens: Sequence[tuple[Path, SpecimenFile]]) -> Iterator[HashedFile]:
    """Yield the files that were judged: the frame set's description, each specimen's, and its images."""
    yield _hash(frame_set)
    for path, specimen in specimens:
        yield _hash(path)
        for scan in specimen.scan:
            if scan.image is not None:
                yield from (_hash(path.parent / image) for image in _images(scan) if (path.parent / image).is_file())


def _hash(path: Path) -> HashedFile:
    data = path.read_bytes()
    return HashedFile(path.name, len(data), hashlib.sha256(data).hexdigest())


# Pages and pictures.

STANDARDS = "in the manner of ISO 25178-700:2022; terms after ISO 25178-600, E_n after ISO/IEC 17043"


def pages_of(certificate: Certificate) -> Report:
    """Return the report of a certificate."""
    specimens = Table(
        "Agreement with specimens",
        ("specimen", "certified, µm", "measured, µm", "error", "E_n"),
        tuple(_specimen(one) for one in certificate.specimens),
    )
    characteristics = Table(
        "Metrological characteristics",
        ("symbol", "characteristic", "value", "from"),
        tuple(_characteristic(one) for one in certificate.characteristics),
    )
    return Report(
        title=f"Calibration certificate: {certificate.instrument}",
        operations=STANDARDS,
        facts=tuple(_facts(certificate)),
        warnings=tuple(_warnings(certificate)),
        pictures=tuple(pictures_of(certificate)),
        tables=(
            specimens,
            characteristics,
            Table("Calibration", ("what", "value"), tuple(_calibration(certificate))),
            Table(
                "Files",
                ("file", "bytes", "SHA-256"),
                tuple((file.name, str(file.size), file.sha256) for file in certificate.files),
            ),
        ),
        notes=(
            "± are expanded uncertainties with coverage factor k = 2; a measured value is the mean of its scans.",
            "± of a measured value: the instrument's own uncertainty, which scans share, and the scans' scatter.",
            "E_n = error / √(U² measured + U² certified); specimen and instrument agree where |E_n| ≤ 1.",
            "Characteristics hold for this gel, these lights, this exposure and the specimens named with them.",
            "Skin bridges what is narrow: a groove or pit that it cannot reach into is measured as it lies in it.",
        ),
    )


def _facts(certificate: Certificate) -> Iterator[tuple[str, str]]:
    pitch = certificate.pixel_pitch_um
    size_mm = (certificate.columns * pitch / 1e3, certificate.rows * pitch / 1e3)
    yield "instrument", certificate.instrument
    yield "calibration", certificate.calibration_id
    yield (
        "field",
        (f"{certificate.columns} x {certificate.rows} pixels of {pitch:g} µm, {size_mm[0]:.2f} x {size_mm[1]:.2f} mm"),
    )
    yield "written", f"{certificate.written_utc} by {certificate.program}"
    yield "verdict", verdict_words(certificate)


def _warnings(certificate: Certificate) -> Iterator[str]:
    if not certificate.calibration_passed:
        yield "the calibration itself did not pass its own checks"
    if certificate.verdict != "agrees":
        yield verdict_words(certificate)
    for one in certificate.specimens:
        yield from (f"{one.name}: {words}" for words in one.words)


def _specimen(one: SpecimenResult) -> tuple[str, ...]:
    """Name, certified, measured, error and E_n of a specimen."""
    serial = f"no. {one.serial}" if one.serial else ""
    about = "; ".join(part for part in (one.name, one.kind, serial, one.certificate) if part)
    certified = _with(one.certified_um, one.certified_expanded_um)
    if one.mean_um is None or one.error_um is None:
        return about, certified, "not measured", "", "not judged"
    scans = f"{len(one.values_um)} scan{'s' if len(one.values_um) > 1 else ''}"
    measured = f"{_with(one.mean_um, one.expanded_um)} ({one.quantity}, {scans})"
    if one.kind == "flat":
        return about, certified, measured, "see z_FLT", ""
    error = f"{one.error_um:+.3g} µm ({one.error_um / one.certified_um:+.2%})"
    judged = "not judged" if one.e_n is None else f"{one.e_n:+.2f}{'' if one.agrees else ': DOES NOT AGREE'}"
    return about, certified, measured, error, judged


def _characteristic(one: Characteristic) -> tuple[str, ...]:
    """Symbol, name, value and basis of a characteristic."""
    if one.value is None:
        return one.symbol, one.name, "not determined", one.basis
    unit = f" {one.unit}" if one.unit else ""
    if one.expanded is None:
        return one.symbol, one.name, f"{one.value:.4g}{unit} (± not known)", one.basis
    return one.symbol, one.name, f"{_with(one.value, one.expanded)}{unit}", one.basis


def _calibration(certificate: Certificate) -> Iterator[tuple[str, str]]:
    yield "own checks", "passed" if certificate.calibration_passed else "did not pass"
    yield "balls", str(certificate.balls)
    if certificate.held_out_error_deg is not None:
        yield "held-out error of the normal", f"{certificate.held_out_error_deg:.2f} degrees"
    for note in certificate.calibration_notes:
        yield "note", note


def _with(value: float, expanded: float | None) -> str:
    """Return a value with its U, to two digits of it."""
    if expanded is None:
        return f"{value:.4g} (± not known)"
    places = max(decimals(expanded), 0)
    return f"{value:.{places}f} ± {expanded:.{places}f}"


DPI: Final = 130

SIZE_IN: Final = (7.0, 2.4)

_RED: Final = "#b03020"

_BLUE: Final = "#24527a"


def pictures_of(certificate: Certificate) -> Iterator[Picture]:
    """Yield the picture, where a specimen was measured."""
    shown = [one for one in certificate.specimens if one.error_um is not None and one.certified_um > 0.0]
    if not shown:
        return
    figure = Figure(figsize=SIZE_IN, layout="constrained")
    axes = figure.add_subplot()
    axes.grid(visible=True, axis="y", linewidth=0.3, alpha=0.5)
    axes.axhline(0.0, color="black", linewidth=0.6)
    for place, one in enumerate(shown):
        percent = 100.0 / one.certified_um
        colour = _RED if one.agrees is False else _BLUE
        own = percent * one.certified_expanded_um
        axes.fill_between([place - 0.3, place + 0.3], -own, own, color="black", alpha=0.15, linewidth=0.0)
        off = percent * (one.error_um or 0.0)
        if one.expanded_um is None:
            axes.plot([place], [off], "x", color=colour)
        else:
            axes.errorbar([place], [off], [percent * one.expanded_um], fmt="o", color=colour, capsize=4, linewidth=1.1)
    names = [printable(one.name).replace("$", r"\$")[:24] for one in shown]
    axes.set_xticks(range(len(shown)), names, fontsize=7)
    axes.set_xlim(-0.6, len(shown) - 0.4)
    axes.set_ylabel("error, % of certified")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=DPI, metadata={"Software": None})
    size = (round(SIZE_IN[0] * DPI), round(SIZE_IN[1] * DPI))
    yield Picture("Error of each specimen with its ± (k = 2); grey: ± of the certified value", stream.getvalue(), size)

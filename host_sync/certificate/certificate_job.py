"""Calibrates, reconstructs and measures every specimen, and writes the certificate as JSON, HTML and PDF."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import msgspec

from device.errors import DeviceError
from device.io.atomic import check_replaceable, write_output
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration_file.calibrator import Calibrator
from host_sync.calibration_report.report import REPORT_FILE
from host_sync.certificate.certificate_pages import Certificate, HashedFile, certify, pages_of
from host_sync.certificate.characteristics import CheckedSpecimen
from host_sync.certificate.specimen_measurement import ScanTable, SpecimenFile, judge, measured_quantity, read_specimen
from host_sync.errors import HostError, MeasurementError
from host_sync.frames.frame_set import FrameSet, FrameSpec
from host_sync.frames.frame_set_file import read_frame_set_file
from host_sync.frames.linear_light import read_frame
from host_sync.measurement.quantity import Quantity
from host_sync.reconstruction.from_frame_set import CALIBRATION_FOLDER
from host_sync.reconstruction.pipeline import reconstruct
from host_sync.reconstruction.result_writer import write_result
from host_sync.registration.difference import are_copies
from host_sync.report.writing import find_browser, write_report
from host_sync.results.reader import ResultSurface, read_result

RECORD_FILE = "certificate.json"
PAGES = "certificate"
Tell = Callable[[str], None]


def certificate_of_frame_set(
    frame_set: FrameSet,
    specimens: Sequence[Path],
    out: Path,
    tell: Tell = lambda _: None,
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
    kept = (calibrator or Calibrator(tell=tell)).of_frame_set(frame_set)
    kept.write_report(out / CALIBRATION_FOLDER)
    calibration = kept.calibration
    form = FrameSpec((), read_frame_set_file(frame_set.path).encoding, frame_set.full_scale, frame_set.pixel_shape)
    checked = [
        check_specimen(path, one, calibration, form, out / f"{number:02d}-{path.stem}", tell)
        for number, (path, one) in enumerate(read, start=1)
    ]
    certificate = certify(frame_set.name, calibration, checked, list(_hashed(frame_set.path, read)))
    return certificate, write_certificate(certificate, out)


def write_certificate(certificate: Certificate, out: Path) -> list[Path]:
    """Write `certificate.json`, `.html` and, where there is a browser, `.pdf` to a folder; return the last two."""
    write_output(out / RECORD_FILE, msgspec.json.format(msgspec.json.encode(certificate), indent=2))
    return write_report(pages_of(certificate), out / PAGES, find_browser())


def check_specimen(
    path: Path, specimen: SpecimenFile, calibration: Calibration, form: FrameSpec, out: Path, tell: Tell
) -> CheckedSpecimen:
    """Reconstruct and measure every scan of a specimen, and judge the values.

    A scan that fails or copies an earlier one is named in the specimen's result.

    form : of its images, which are not named in it
    """
    surfaces: list[ResultSurface] = []
    quantities: list[Quantity] = []
    failures: list[str] = []
    for number, scan in enumerate(specimen.scan, start=1):
        tell(f"{specimen.name}: scan {number} of {len(specimen.scan)}")
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

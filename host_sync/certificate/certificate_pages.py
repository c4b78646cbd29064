"""The certificate as a report, which `host_sync.report` sets into pages."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from typing import Final, Literal

import msgspec
from matplotlib.figure import Figure

from host_sync.calibration.calibrate import Calibration
from host_sync.certificate.characteristics import Characteristic, CheckedSpecimen, characteristics
from host_sync.certificate.specimen_measurement import MAX_E_N, SpecimenResult
from host_sync.measurement.quantity import decimals
from host_sync.report.content import Picture, Report, Table
from host_sync.text import printable

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

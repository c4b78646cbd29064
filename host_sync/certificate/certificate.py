"""The calibration certificate of an instrument: what it is, how it agrees with specimens, and its characteristics."""

from __future__ import annotations

import time
from collections.abc import Sequence
from importlib.metadata import version
from typing import Final, Literal

import msgspec

from host_sync.calibration.calibrate import Calibration
from host_sync.certificate.characteristics import Characteristic, CheckedSpecimen, characteristics
from host_sync.certificate.specimen_measurement import MAX_E_N, SpecimenResult

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
    """The certificate of a calibration from its checked specimens.

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
    """The verdict as a sentence."""
    if certificate.verdict == "agrees":
        return f"The instrument agrees with every specimen: no |E_n| is above {MAX_E_N:g}."
    if certificate.verdict == "does not agree":
        off = [one.name for one in certificate.specimens if one.agrees is False]
        return f"The instrument does not agree with {', '.join(off)}: |E_n| is above {MAX_E_N:g}."
    return "The instrument is not judged: a specimen is missing, or its number or uncertainty is not known."

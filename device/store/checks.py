"""The check standard of an instrument and the history of its checks: small files in `checks/`."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Final

from device.bundles.check import CheckRecord, CheckStandard, StandardKind, ambiguity_um
from device.bundles.record import Identity
from device.store.choices import RecordFile

_REMEDY: Final = "remove it, and enter the check standard again"
STANDARD: Final = RecordFile(CheckStandard, "checks/standard.json", _REMEDY)
CHECKS: Final = RecordFile(CheckRecord, "checks/{}.json", _REMEDY)

MAX_OWN_ERROR: Final[dict[StandardKind, float]] = {"ball": 0.12, "step": 0.15, "roughness": 0.4}
"""Relative error of the quick look itself, allowed beyond the standard's ±: it reads balls that are pressed gently up
to 10 % large, steps up to 10 % low where the skin bridges them, and fine roughness low."""

MAX_CORRECTED_ERROR: Final = 0.07
"""The same for a ball whose reading was corrected by the calibration's own balls: they read up to 6 % large on the
twin, 2 to 5 mm, pressed 0.15 to 0.65 mm deep."""

MAX_CHECK_DRIFT: Final[dict[StandardKind, float]] = {"ball": 0.05, "step": 0.05, "roughness": 0.1}
"""Allowed change since the first check with a calibration: what pressing elsewhere and deeper changes."""


@dataclass(frozen=True, slots=True)
class CheckMeasure:
    """A check standard as a press shows it: its value, or None and what is wrong with the light that hides it.

    own_error : relative error of the reading itself; None: as usual for its kind
    """

    value_um: float | None
    light_fault: str = ""
    own_error: float | None = None

    def share_of(self, kind: StandardKind) -> float:
        """Return relative error of the reading itself."""
        return MAX_OWN_ERROR[kind] if self.own_error is None else self.own_error

    def question(self, standard: CheckStandard) -> str:
        """Return the question to the operator about a ball that reads as another common one; empty without doubt."""
        if standard.kind != "ball" or self.value_um is None:
            return ""
        share = self.share_of(standard.kind)
        if ambiguity_um(standard.value_um, standard.tolerance_um + share * standard.value_um, self.value_um) is None:
            return ""
        read, error, stated = (value / 1e3 for value in (self.value_um, share * self.value_um, standard.value_um))
        return (
            f"The ball reads radius {read:.2f} ± {error:.2f} mm; the check standard is {stated:.2f} mm. "
            "Is the right ball on the gel?"
        )


def read_standard(root: Path) -> CheckStandard | None:
    """Return the check standard; None when none was entered or its file is damaged."""
    return STANDARD.read_sound(root)


def write_standard(root: Path, standard: CheckStandard) -> None:
    """Store the check standard durably; the history stays.

    Raises
    ------
    StoreError
        The disk refused.
    """
    STANDARD.write(root, standard)


def read_checks(root: Path) -> tuple[CheckRecord, ...]:
    """Return every check, oldest first; damaged ones are left out."""
    return tuple(sorted(CHECKS.all_sound(root), key=lambda check: check.counter))


def write_check(root: Path, check: CheckRecord) -> None:
    """Store a check durably. Errors as for `write_standard`."""
    CHECKS.write(root, check, check.scan_id)


def judged_check(
    root: Path,
    standard: CheckStandard,
    identity: Identity,
    calibration_id: str,
    checked: datetime,
    measured: CheckMeasure,
) -> CheckRecord:
    """Return the result of a check, compared with the certificate and the first passed check with this calibration."""
    first = next(
        (
            check
            for check in read_checks(root)
            if check.calibration_id == calibration_id and check.standard == standard.identity and check.passed
        ),
        None,
    )
    return CheckRecord(
        scan_id=identity.id,
        counter=identity.counter,
        checked=checked,
        calibration_id=calibration_id,
        name=standard.name,
        kind=standard.kind,
        value_um=standard.value_um,
        limit_um=standard.tolerance_um + measured.share_of(standard.kind) * standard.value_um,
        measured_um=measured.value_um,
        light_fault=measured.light_fault,
        first_um=first.measured_um if first else None,
        drift_limit_um=MAX_CHECK_DRIFT[standard.kind] * standard.value_um if first else None,
    )

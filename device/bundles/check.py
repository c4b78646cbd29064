"""A check standard, and the result of pressing it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Literal

from device.bundles.record import (
    BundleId,
    Count,
    NotNegative,
    Positive,
    Record,
    ShortText,
    Time,
)

CHECK_FILE: Final = "check.json"
CHECK_SCHEMA: Final = "retrograph.check/1"
STANDARD_SCHEMA: Final = "retrograph.check-standard/1"

StandardKind = Literal["ball", "step", "roughness"]
UNITS: Final[dict[StandardKind, tuple[str, float]]] = {
    "ball": ("mm", 1e3),
    "step": ("µm", 1.0),
    "roughness": ("µm", 1.0),
}
"""Unit in which a kind's value is typed, and µm in it."""

COMMON_RADII_UM: Final = (1000.0, 1500.0, 2000.0, 2500.0, 3000.0, 4000.0, 5000.0)
"""Radii of commercially available balls."""


def ambiguity_um(value_um: float, limit_um: float, measured_um: float) -> float | None:
    """Return the common ball radius that fits a reading where the certified one does not, µm, else None.

    limit_um : allowed deviation from the certified radius `value_um`
    """
    nearest = min(COMMON_RADII_UM, key=lambda radius_um: abs(measured_um - radius_um))
    is_other = min(abs(measured_um - value_um), abs(nearest - value_um)) > limit_um
    return nearest if is_other and abs(measured_um - nearest) <= limit_um * nearest / value_um else None


class CheckStandard(Record, frozen=True, tag_field="schema", tag=STANDARD_SCHEMA):
    """A certified specimen: radius of a ball, height of a step or Ra of a roughness specimen, µm, and its ±."""

    name: ShortText
    kind: StandardKind
    value_um: Positive
    tolerance_um: NotNegative

    @property
    def identity(self) -> tuple[StandardKind, str, float]:
        """Return what its checks have in common, see `CheckRecord.standard`."""
        return self.kind, self.name, self.value_um


class CheckRecord(Record, frozen=True, tag_field="schema", tag=CHECK_SCHEMA):
    """One press of a check standard.

    scan_id, counter : of the scan that shows it
    checked : by the device's clock
    value_um, limit_um : certified value, and the deviation that is allowed
    measured_um : as the quick look shows it; None where wrong light hides the standard
    light_fault : what is wrong with the light then
    first_um, drift_limit_um : the first passed check with the same calibration, and the deviation from it that is
        allowed; None at the first
    """

    scan_id: BundleId
    counter: Count
    checked: Time
    calibration_id: BundleId
    name: ShortText
    kind: StandardKind
    value_um: Positive
    limit_um: Positive
    measured_um: NotNegative | None
    first_um: Positive | None = None
    drift_limit_um: Positive | None = None
    light_fault: ShortText = ""

    @property
    def standard(self) -> tuple[StandardKind, str, float]:
        """The standard that was pressed: kind, name and certified value (µm)."""
        return self.kind, self.name, self.value_um

    @property
    def passed(self) -> bool:
        """True if the measured value deviates by no more than is allowed, from the certificate and the first check."""
        if self.measured_um is None:
            return False
        return abs(self.measured_um - self.value_um) <= self.limit_um and not self.has_drifted

    @property
    def has_drifted(self) -> bool:
        """True if it deviates from the first check by more than is allowed."""
        if self.measured_um is None or self.first_um is None or self.drift_limit_um is None:
            return False
        return abs(self.measured_um - self.first_um) > self.drift_limit_um

    @property
    def sentence(self) -> str:
        """The result in words."""
        unit, factor = UNITS[self.kind]
        value, limit = self.value_um / factor, self.limit_um / factor
        measured = f"{self.measured_um / factor:.4g} {unit}" if self.measured_um is not None else self._unmeasured
        verdict = "passed" if self.passed else "FAILED"
        first = self._other
        if self.has_drifted and self.first_um is not None and self.drift_limit_um is not None:
            first += f", {self.first_um / factor:.4g} ± {self.drift_limit_um / factor:.2g} {unit} after calibration"
        return (
            f"check of {self.name} {verdict}: {measured}, {value:.4g} ± {limit:.2g} {unit} expected{first} "
            f"(scan #{self.counter}, {self.checked:%Y-%m-%d})"
        )

    @property
    def _other(self) -> str:
        """The other ball that the reading fits, in words; empty if none."""
        if self.kind != "ball" or self.measured_um is None:
            return ""
        other_um = ambiguity_um(self.value_um, self.limit_um, self.measured_um)
        return f", it reads as a ball of {other_um / UNITS[self.kind][1]:g} mm" if other_um else ""

    @property
    def _unmeasured(self) -> str:
        return f"it does not show under this light ({self.light_fault})"


def doubt_of_checks(counter: int, checks: Iterable[CheckRecord]) -> CheckRecord | None:
    """Return the failed check that makes a scan doubtful, None if there is none.

    Of each standard, the next check after the scan or the last one before it counts. A check that passed clears its own
    standard's failures only, and is not doubtful itself by that standard.

    counter : of the scan
    checks : with the scan's calibration
    """
    doubts = (_doubt_of_standard(counter, known) for known in _by_standard(checks))
    return next((failed for failed in doubts if failed), None)


def last_of_standards(checks: Iterable[CheckRecord]) -> CheckRecord | None:
    """Return the last check of a standard whose last check failed; without one the last check of all."""
    last = [known[-1] for known in _by_standard(checks)]
    failed = [check for check in last if not check.passed]
    return max(failed or last, key=lambda check: check.counter, default=None)


def _by_standard(checks: Iterable[CheckRecord]) -> list[list[CheckRecord]]:
    """Return the checks of each standard, oldest first."""
    known: dict[tuple[StandardKind, str, float], list[CheckRecord]] = {}
    for check in sorted(checks, key=lambda check: check.counter):
        known.setdefault(check.standard, []).append(check)
    return list(known.values())


def _doubt_of_standard(counter: int, known: list[CheckRecord]) -> CheckRecord | None:
    if any(check.counter == counter and check.passed for check in known):
        return None
    after = next((check for check in known if check.counter >= counter), None)
    before = next((check for check in reversed(known) if check.counter < counter), None)
    return next((check for check in (after, before) if check is not None and not check.passed), None)

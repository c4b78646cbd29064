"""A check standard, and the result of pressing it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Literal

from device.bundles.record import BundleId, Count, NotNegative, Positive, Record, ShortText, Time

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


class CheckStandard(Record, frozen=True, tag_field="schema", tag=STANDARD_SCHEMA):
    """A certified specimen: radius of a ball, height of a step or Ra of a roughness specimen, µm, and its ±."""

    name: ShortText
    kind: StandardKind
    value_um: Positive
    tolerance_um: NotNegative


class CheckRecord(Record, frozen=True, tag_field="schema", tag=CHECK_SCHEMA):
    """One press of a check standard.

    scan_id, counter : of the scan that shows it
    checked : by the device's clock
    value_um, limit_um : certified value, and the deviation that is allowed
    measured_um : as the quick look shows it
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
    measured_um: NotNegative
    first_um: Positive | None = None
    drift_limit_um: Positive | None = None

    @property
    def passed(self) -> bool:
        """Whether the measured value deviates by no more than is allowed, from the certificate and the first check."""
        return abs(self.measured_um - self.value_um) <= self.limit_um and not self.has_drifted

    @property
    def has_drifted(self) -> bool:
        """Whether it deviates from the first check by more than is allowed."""
        if self.first_um is None or self.drift_limit_um is None:
            return False
        return abs(self.measured_um - self.first_um) > self.drift_limit_um

    @property
    def sentence(self) -> str:
        """The result in words."""
        unit, factor = UNITS[self.kind]
        measured, value, limit = (one / factor for one in (self.measured_um, self.value_um, self.limit_um))
        verdict = "passed" if self.passed else "FAILED"
        first = ""
        if self.has_drifted and self.first_um is not None and self.drift_limit_um is not None:
            first = f", {self.first_um / factor:.4g} ± {self.drift_limit_um / factor:.2g} {unit} after calibration"
        return (
            f"check of {self.name} {verdict}: {measured:.4g} {unit}, {value:.4g} ± {limit:.2g} {unit} expected{first} "
            f"(scan #{self.counter}, {self.checked:%Y-%m-%d})"
        )


def doubt_of_checks(counter: int, checks: Iterable[CheckRecord]) -> CheckRecord | None:
    """The failed check of the standard that makes a scan doubtful: the next one after it, or the last one before it.

    A check that passed is not doubtful itself.

    counter : of the scan
    checks : with the scan's calibration
    """
    known = sorted(checks, key=lambda check: check.counter)
    if any(check.counter == counter and check.passed for check in known):
        return None
    after = next((check for check in known if check.counter >= counter), None)
    before = next((check for check in reversed(known) if check.counter < counter), None)
    return next((check for check in (after, before) if check is not None and not check.passed), None)

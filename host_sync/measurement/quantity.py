"""A measured number with its unit and uncertainty, and its text."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, Literal

import msgspec
import numpy as np

from device.surface import Float64Array
from host_sync.iso25178.areal_parameters import NoiseLaw
from host_sync.measurement.recipe import ToleranceTable
from host_sync.results.record import DoubtKind

MIN_DRAWS: Final = 4
NOISE_WARNING: Final = 0.5
NOISE_FRACTION: Final = 0.05
"""Noise bias, as a fraction of the uncertainty and of the value: above both, the number gets a warning."""

DIRECTION_STEP_DEG: Final = 0.5
"""Resolution of directions."""


Verdict = Literal["pass", "fail", "undecided"]


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """The tolerance of a number, in its unit, and whether the number passes."""

    low: float | None = None
    high: float | None = None
    verdict: Verdict

    @property
    def words(self) -> str:
        """For example "pass: 90 to 110"."""
        if self.low is None:
            return f"{self.verdict}: at most {plain(self.high or 0.0)}"
        if self.high is None:
            return f"{self.verdict}: at least {plain(self.low)}"
        return f"{self.verdict}: {plain(self.low)} to {plain(self.high)}"


DIRECTION: Final = "Std"
"""Number that is a direction of the texture, which repeats after 180 degrees."""


class Quantity(msgspec.Struct, frozen=True, kw_only=True):
    """One measured number.

    subject : the surface, or the recipe's name of a line, place or region
    name, unit : the parameter; a pure number has an empty unit
    value : None where it is not defined
    uncertainty : expanded uncertainty (coverage factor times standard uncertainty); None without samples
    coverage_factor : k
    offset : noise bias, estimated from the samples; it is not subtracted
    noise_taken_off : noise bias of the pixels that was subtracted; None where nothing was
    samples : number of Monte Carlo samples that gave a value; `draws` in files
    masked_share : fraction of the subject without a height
    left_out_share : fraction of the subject that is left out as its slopes lie beyond the calibration's balls
    warnings : reasons to distrust the number; `doubts` in files
    limits : its tolerance and the verdict, where the recipe has one
    """

    subject: str
    name: str
    unit: str
    value: float | None
    uncertainty: float | None
    coverage_factor: int
    offset: float | None
    samples: int = msgspec.field(name="draws")
    masked_share: float
    warnings: tuple[str, ...] = msgspec.field(default=(), name="doubts")
    noise_taken_off: float | None = None
    limits: Limits | None = None
    left_out_share: float = 0.0

    def __repr__(self) -> str:
        return f"<Quantity {self.subject}: {self.sentence}>"

    @property
    def number(self) -> str:
        """For example "1.83 ± 0.06 µm": two digits of the uncertainty, the value to the same decimal place."""
        if self.value is None:
            return "not defined"
        factor, name = shown_in(self.unit, self.value)
        unit = f" {name}" if name else ""
        if self.uncertainty is None:
            return f"{plain(factor * self.value)}{unit}, ± not known"
        places = decimals(factor * self.uncertainty)
        value, uncertainty = (round(factor * one, places) for one in (self.value, self.uncertainty))
        shown = max(places, 0)
        return f"{value:.{shown}f} ± {uncertainty:.{shown}f}{unit}"

    @property
    def sentence(self) -> str:
        """For example "Sa 1.83 ± 0.06 µm (k = 1), 4 % masked"."""
        known = "" if self.uncertainty is None else f" (k = {self.coverage_factor})"
        return f"{self.name} {self.number}{known}, {self.coverage}"

    @property
    def coverage(self) -> str:
        """For example "4 % masked, 15 % left out"."""
        left_out = f", {100.0 * self.left_out_share:.2g} % left out" if self.left_out_share else ""
        return f"{100.0 * self.masked_share:.2g} % masked{left_out}"


LONG_UM: Final = 1e4
"""Lengths from here on are shown in mm."""


def shown_in(unit: str, value: float) -> tuple[float, str]:
    """Return the factor and unit for display: lengths of 10 mm and more in mm, volumes of 0.01 mm³ and more in mm³."""
    if unit == "µm" and abs(value) >= LONG_UM:
        return 1e-3, "mm"
    return (1e-9, "mm³") if unit == "µm³" and abs(value) >= 1e7 else (1.0, unit)


def plain(value: float) -> str:
    """Return the value to four digits without an exponent where a person reads it so: 17500 and not 1.75e+04."""
    if value == 0.0:
        return "0"
    if not 1e-4 <= abs(value) < 1e9:
        return f"{value:.4g}"
    places = max(0, 3 - int(np.floor(np.log10(abs(value)))))
    text = f"{round(value, 3 - int(np.floor(np.log10(abs(value))))):.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def decimals(uncertainty: float) -> int:
    """Decimal places that show two digits of an uncertainty, negative for a large one; 4 if it is 0 or infinite."""
    if not 0.0 < uncertainty < float("inf"):
        return 4
    return int(np.clip(1 - np.floor(np.log10(uncertainty)), -12, 9))


def uncertainty_of(
    value: float, drawn: Float64Array, *, is_direction: bool = False, law: NoiseLaw = "squares"
) -> tuple[float, float, int] | None:
    """Return a number's standard uncertainty, its noise bias, and the number of samples with a value.

    None with too few samples. The uncertainty combines the spread of the samples about their mean with the noise bias,
    which is not subtracted.

    drawn : float64 array of shape (K,), NaN where a sample gave no value
    is_direction : an angle in degrees with a period of 180°
    law : of the noise bias
    """
    seen = drawn[np.isfinite(drawn)]
    if not np.isfinite(value) or seen.size < max(MIN_DRAWS, drawn.size / 2):
        return None
    off = seen - value
    if is_direction:
        off = (off + 90.0) % 180.0 - 90.0
        return float(np.sqrt((off**2).mean() + DIRECTION_STEP_DEG**2 / 12.0)), float(off.mean()), int(seen.size)
    raised = noise_bias(value, float(off.mean()), law)
    return float(np.hypot(off.std(), raised)), raised, int(seen.size)


def noise_bias(value: float, offset: float, law: NoiseLaw = "squares") -> float:
    """Return the noise bias of a number that the same noise, added once more, changes by `offset`.

    Noise and surface add in squares (Sq² = surface² + noise²), so the first noise raised the number by more than the
    second; on a flat surface that shows only noise, by the whole number. A negative `offset` is returned as it is.

    A maximum grows in proportion: N independent values of noise σ raise it by about σ √(2 ln N), so that the second
    noise added √2 - 1 of what the first did. Where it is either, the root mean square of both is returned.
    """
    squares = offset
    if offset > 0.0 and value > 0.0:
        squares = value - float(np.sqrt(max(value**2 - 2.0 * value * offset - offset**2, 0.0)))
    if law == "squares":
        return squares
    proportion = offset / (np.sqrt(2.0) - 1.0)
    return float(proportion if law == "extreme" else np.copysign(np.hypot(squares, proportion) / np.sqrt(2.0), offset))


NOISE_BIAS_SIGMA: Final = 0.2
"""Standard uncertainty of what noise adds to a number, relative to it."""


def bias_taken_off(value: float, steps: Float64Array, law: NoiseLaw) -> tuple[float, float]:
    """Return the noise bias that is subtracted from a number, and its standard uncertainty.

    Noise adds to an extreme in proportion where many places compete for it, in squares where few do: the middle is
    subtracted, and half of the difference is in the uncertainty. Of other numbers it is taken to add in squares.

    steps : what draws of the noise, added once more, raise the number by; of mean above 0
    """
    offset = float(steps.mean())
    least = noise_bias(value, offset)
    most = max(min(noise_bias(value, offset, law), value), least) if law == "extreme" else least
    taken = 0.5 * (least + most)
    scatter = taken / offset * float(steps.std()) / np.sqrt(steps.size - 1)
    return taken, float(np.linalg.norm([NOISE_BIAS_SIGMA * taken, 0.5 * (most - least), scatter]))


def uncertainty_of_uncertainty(samples: int) -> float:
    """Return relative standard uncertainty of an uncertainty from K samples, 1 / sqrt(2 K)."""
    return float(1.0 / np.sqrt(2.0 * samples)) if samples else float("nan")


# Tolerances: whether a number passes, by the decision rule of ISO 14253-1 with its default of 95 %.
#
# A number passes when it lies inside its limits by 1.65 standard uncertainties, and fails when it lies outside by as
# much. Between the two, without an uncertainty, where a doubt says that the uncertainty does not hold, or where the
# uncertainty lacks that of the pixel pitch, which heights and lengths depend on, nothing is decided.

GUARD: Final = 1.65
"""Guard band in standard uncertainties: 95 % on one side of a normal distribution."""

NO_PITCH_SIGMA: Final = "± without that of the pixel pitch, which is not known: set scale.pixel_pitch_share"

VOID_DOUBTS: Final[tuple[DoubtKind, ...]] = (
    "failed calibration",
    "failed check standard",
    "uncovered sector",
    "drifted light",
    "frame unlike calibration",
    "no zero",
    "not converged",
)
"""Doubts under which an uncertainty does not hold."""

VOID: Final = (*VOID_DOUBTS, NO_PITCH_SIGMA)
"""Beginnings of warnings under which a verdict is not given."""

PITCH_FREE: Final = frozenset({"", "%", "°"})
"""Units of numbers that do not depend on the pitch, unless their warnings say so: heights and lengths do."""


def judged(
    quantities: Iterable[Quantity], tolerances: Iterable[ToleranceTable], *, pitch_is_known: bool
) -> tuple[Quantity, ...]:
    """Return the quantities, each with its limits and verdict where the recipe has a tolerance of it.

    pitch_is_known : whether uncertainties hold that of the pixel pitch
    """
    wanted = {(one.of, one.number): one for one in tolerances}
    found = []
    for quantity in quantities:
        table = wanted.get((quantity.subject, quantity.name))
        if table is None:
            found.append(quantity)
            continue
        if not pitch_is_known and quantity.uncertainty is not None and quantity.unit not in PITCH_FREE:
            warnings = tuple(dict.fromkeys((*quantity.warnings, NO_PITCH_SIGMA)))
            quantity = msgspec.structs.replace(quantity, warnings=warnings)
        limits = Limits(low=table.low, high=table.high, verdict=verdict_of(quantity, table.low, table.high))
        found.append(msgspec.structs.replace(quantity, limits=limits))
    return tuple(found)


def verdict_of(quantity: Quantity, low: float | None, high: float | None) -> Verdict:
    """Return the verdict on a number under its limits, which are in the number's unit."""
    if quantity.value is None or quantity.uncertainty is None or any(w.startswith(VOID) for w in quantity.warnings):
        return "undecided"
    guard = GUARD * quantity.uncertainty / quantity.coverage_factor
    below = -float("inf") if low is None else low
    above = float("inf") if high is None else high
    if below + guard <= quantity.value <= above - guard:
        return "pass"
    if quantity.value < below - guard or quantity.value > above + guard:
        return "fail"
    return "undecided"


def unmet(quantities: Iterable[Quantity], tolerances: Iterable[ToleranceTable]) -> tuple[str, ...]:
    """Return names of numbers that have a tolerance and were not measured."""
    known = {(one.subject, one.name) for one in quantities if one.value is not None}
    return tuple(f"{one.of}: {one.number}" for one in tolerances if (one.of, one.number) not in known)

"""Gage R&R: the share of the gage in the spread of repeated measurements (crossed ANOVA, AIAG conventions).

Every operator scans every part equally often. The mean squares of parts, operators, interaction and repeats give the
variances. An interaction with p > 0.25 in the F-test is pooled with the repeats; a negative variance counts as zero.

Confidence intervals are generalised: mean squares are drawn from their chi-squared distributions and every figure is
computed for each draw. For repeatability this equals the chi-squared interval.

Rows of a study come from a CSV file or from results, arranged by parts, operators and repeats.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from scipy.stats import f as f_distribution

from device.surface import Float64Array
from host_sync.csv_table import number_in, read_table
from host_sync.errors import MeasurementError

POOLING_P: Final = 0.25
CATEGORIES: Final = 1.41
TOLERANCE_SIGMAS: Final = 6.0
TRIALS: Final = 20_000
CONFIDENCE: Final = 0.95
SEED: Final = 5

COPIES_FRACTION: Final = 1e-15
"""Sum of squares between repeats, as a fraction of all, that rounding alone explains."""


class Estimate(msgspec.Struct, frozen=True):
    """A figure with its confidence interval; None where it is unbounded."""

    value: float | None
    low: float | None
    high: float | None


class MeanSquares(msgspec.Struct, frozen=True):
    """The ANOVA table: sums of squares and degrees of freedom by source.

    interaction_p : p of the F-test of the interaction; None with one operator
    pooled : whether the interaction is pooled with the repeats
    """

    sums: dict[str, float]
    freedoms: dict[str, int]
    interaction_p: float | None
    pooled: bool


class GageStudy(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a study; standard deviations in the unit of the values.

    percent_* : of the total variation; percent_tolerance: six standard deviations of the gage over the tolerance
    ndc : number of distinct categories: 1.41 times part over gage, rounded down
    """

    parts: tuple[str, ...]
    operators: tuple[str, ...]
    repeats: int
    anova: MeanSquares
    confidence: float
    repeatability: Estimate
    reproducibility: Estimate
    gage: Estimate
    part_to_part: Estimate
    total: Estimate
    percent_gage: Estimate
    percent_repeatability: Estimate
    percent_reproducibility: Estimate
    percent_part: Estimate
    percent_tolerance: Estimate | None
    ndc: Estimate


class _Spread:
    """Standard deviations from mean squares; each a float or an array of shape (TRIALS,)."""

    def __init__(self, mean: dict[str, Float64Array], sizes: tuple[int, int, int], *, pooled: bool) -> None:
        parts, operators, repeats = sizes
        error = mean["repeats"]
        between = error if pooled else mean["interaction"]
        interaction = _positive(between - error) / repeats if not pooled else 0.0 * error
        operator = _positive(mean["operators"] - between) / (parts * repeats) if operators > 1 else 0.0 * error
        part = _positive(mean["parts"] - between) / (operators * repeats)
        self.repeatability = np.sqrt(error)
        self.reproducibility = np.sqrt(operator + interaction)
        self.gage = np.sqrt(error + operator + interaction)
        self.part = np.sqrt(part)
        self.total = np.sqrt(error + operator + interaction + part)


def study(
    values: Float64Array, parts: Sequence[str], operators: Sequence[str], tolerance: float | None = None
) -> GageStudy:
    """Return the study of measured values.

    values : float64 array of shape (parts, operators, repeats), each finite
    tolerance : tolerance width, in the unit of the values

    Raises
    ------
    MeasurementError
        There are too few parts or repeats, or no spread at all.
    """
    sizes = (values.shape[0], values.shape[1], values.shape[2])
    if sizes[0] < 2 or sizes[2] < 2:
        raise MeasurementError(
            f"a gage study needs two parts and two repeats, found {sizes[0]} and {sizes[2]}: scan more"
        )
    anova = _analyse(values)
    if not anova.sums["repeats"] > COPIES_FRACTION * sum(anova.sums.values()):
        raise MeasurementError("repeats do not differ: they are copies, not repeated measurements")
    names = [name for name in anova.sums if anova.freedoms[name]]
    mean = {name: np.array(anova.sums[name] / anova.freedoms[name]) for name in names}
    found = _Spread(mean, sizes, pooled=anova.pooled)
    rng = np.random.default_rng(SEED)
    drawn = {name: mean[name] * anova.freedoms[name] / rng.chisquare(anova.freedoms[name], TRIALS) for name in names}
    trials = _Spread(drawn, sizes, pooled=anova.pooled)

    def figure(of: Callable[[_Spread], Float64Array]) -> Estimate:
        with np.errstate(divide="ignore"):
            return _estimate(of(found), of(trials))

    ndc = figure(lambda one: CATEGORIES * one.part / one.gage)
    return GageStudy(
        parts=tuple(parts),
        operators=tuple(operators),
        repeats=sizes[2],
        anova=anova,
        confidence=CONFIDENCE,
        repeatability=figure(lambda one: one.repeatability),
        reproducibility=figure(lambda one: one.reproducibility),
        gage=figure(lambda one: one.gage),
        part_to_part=figure(lambda one: one.part),
        total=figure(lambda one: one.total),
        percent_gage=figure(lambda one: 100.0 * one.gage / one.total),
        percent_repeatability=figure(lambda one: 100.0 * one.repeatability / one.total),
        percent_reproducibility=figure(lambda one: 100.0 * one.reproducibility / one.total),
        percent_part=figure(lambda one: 100.0 * one.part / one.total),
        percent_tolerance=figure(lambda one: 100.0 * TOLERANCE_SIGMAS * one.gage / tolerance) if tolerance else None,
        ndc=Estimate(*(None if one is None else float(np.floor(one)) for one in (ndc.value, ndc.low, ndc.high))),
    )


def _analyse(values: Float64Array) -> MeanSquares:
    """Return the analysis of variance of values of shape (parts, operators, repeats)."""
    p, o, r = values.shape
    grand = values.mean()
    cells = values.mean(axis=2)
    by_part, by_operator = values.mean(axis=(1, 2)), values.mean(axis=(0, 2))
    sums = {
        "parts": float(o * r * ((by_part - grand) ** 2).sum()),
        "operators": float(p * r * ((by_operator - grand) ** 2).sum()),
        "interaction": float(r * ((cells - by_part[:, None] - by_operator + grand) ** 2).sum()),
        "repeats": float(((values - cells[..., None]) ** 2).sum()),
    }
    freedoms = {"parts": p - 1, "operators": o - 1, "interaction": (p - 1) * (o - 1), "repeats": p * o * (r - 1)}
    interaction_p = None
    if freedoms["interaction"] and sums["repeats"] > 0.0:
        ratio = sums["interaction"] / freedoms["interaction"] / (sums["repeats"] / freedoms["repeats"])
        interaction_p = float(f_distribution.sf(ratio, freedoms["interaction"], freedoms["repeats"]))
    pooled = interaction_p is None or interaction_p > POOLING_P
    if pooled:
        sums["repeats"] += sums.pop("interaction")
        freedoms["repeats"] += freedoms.pop("interaction")
    return MeanSquares(sums, freedoms, interaction_p, pooled)


def _positive(variance: Float64Array) -> Float64Array:
    return np.maximum(variance, 0.0)


def _estimate(value: Float64Array, trials: Float64Array) -> Estimate:
    low, high = np.quantile(trials, [0.5 - CONFIDENCE / 2.0, 0.5 + CONFIDENCE / 2.0], method="nearest")
    return Estimate(*(float(one) if np.isfinite(one) else None for one in (value, low, high)))


GOOD_PERCENT: Final = 10.0
USABLE_PERCENT: Final = 30.0
MIN_CATEGORIES: Final = 5


def study_text(study: GageStudy, what: str, unit: str) -> str:
    """Return the tables of a study: ANOVA, spreads with confidence intervals, and the verdict."""
    anova = study.anova
    lines = [
        f"gage R&R of {what}: {len(study.parts)} parts, {len(study.operators)} operators, {study.repeats} repeats; "
        f"standard deviations with {study.confidence:.0%} confidence intervals",
        "",
        f"  {'source':<14}{'sum of squares':>16}{'freedom':>9}{'mean square':>14}",
    ]
    lines += [
        f"  {name:<14}{value:>16.6g}{anova.freedoms[name]:>9}{value / anova.freedoms[name]:>14.6g}"
        for name, value in anova.sums.items()
        if anova.freedoms[name]
    ]
    if anova.interaction_p is not None:
        pooled = "pooled with the repeats" if anova.pooled else "kept"
        lines.append(f"  interaction of part and operator: p = {anova.interaction_p:.3f}, {pooled}")
    rows = (
        ("repeatability", study.repeatability, study.percent_repeatability),
        ("reproducibility", study.reproducibility, study.percent_reproducibility),
        ("gage R&R", study.gage, study.percent_gage),
        ("part to part", study.part_to_part, study.percent_part),
        ("total", study.total, None),
    )
    lines += ["", *(f"  {name:<16}{_shown(one, unit)}{_share(share)}" for name, one, share in rows), ""]
    if study.percent_tolerance is not None:
        lines.append(
            f"  six standard deviations of the gage fill {_shown(study.percent_tolerance, '%')} of the tolerance"
        )
    lines.append(f"  distinct categories: {_shown(study.ndc, '')}")
    return "\n".join([*lines, f"  {verdict(study)}"])


def verdict(study: GageStudy) -> str:
    """Return the verdict by the AIAG rule of thumb."""
    percent = study.percent_gage.value
    if percent is None:
        return "the gage cannot be judged: nothing varies"
    word = (
        "good" if percent <= GOOD_PERCENT else "usable for some purposes" if percent <= USABLE_PERCENT else "too coarse"
    )
    few = study.ndc.value is not None and study.ndc.value < MIN_CATEGORIES
    tail = f", and it distinguishes fewer than {MIN_CATEGORIES} categories" if few else ""
    return f"the gage's spread is {percent:.1f} % of the total: {word} (up to 10 % good, up to 30 % usable){tail}"


def _shown(one: Estimate, unit: str) -> str:
    unit = f" {unit}" if unit else ""
    value, low, high = ("∞" if end is None else f"{end:.4g}" for end in (one.value, one.low, one.high))
    return f"{value}{unit} ({low} to {high})"


def _share(one: Estimate | None) -> str:
    return "" if one is None else f",  {_shown(one, '%')} of the total"


@dataclass(frozen=True, slots=True)
class GageRow:
    """One measurement of a part by an operator; `value` is a number, or a result folder to measure."""

    part: str
    operator: str
    value: str


def read_rows(path: Path, value_column: str) -> list[GageRow]:
    """Return the rows of a CSV file whose header names the columns part, operator and the value column.

    Raises
    ------
    MeasurementError
        The file cannot be read, or lacks a column or a cell.
    """
    wanted = ("part", "operator", value_column)
    table = read_table(path, MeasurementError, wanted)
    if not table:
        raise MeasurementError(f"{path}: has no row below its line of names")
    rows = []
    for number, cells in enumerate(table, start=1):
        part, operator, value = (cells[name] for name in wanted)
        if not (part and operator and value):
            raise MeasurementError(f"{path}: row {number} below the line of names: a cell is empty: fill it in")
        rows.append(GageRow(part, operator, value))
    return rows


def numbers(rows: Iterable[GageRow], source: str) -> list[tuple[str, str, float]]:
    """Part, operator and number of each row.

    Raises
    ------
    MeasurementError
        A value is no finite number, or signs are written between thousands.
    """
    found = []
    rows = list(rows)
    texts = "".join(row.value for row in rows)
    if "," in texts and "." in texts:
        raise MeasurementError(f"{source}: values hold points and commas: write no sign between thousands")
    for row in rows:
        number = number_in(row.value)
        if not np.isfinite(number):
            raise MeasurementError(f"{source}: part {row.part}, operator {row.operator}: {row.value!r} is not a number")
        found.append((row.part, row.operator, number))
    return found


def crossed(
    measured: Sequence[tuple[str, str, float]],
) -> tuple[Float64Array, tuple[str, ...], tuple[str, ...]]:
    """Return values of shape (parts, operators, repeats), part names and operator names, in order of appearance.

    Raises
    ------
    MeasurementError
        Some operator scanned some part more or less often than others.
    """
    parts = tuple(dict.fromkeys(part for part, _, _ in measured))
    operators = tuple(dict.fromkeys(operator for _, operator, _ in measured))
    counts = Counter((part, operator) for part, operator, _ in measured)
    usual = Counter(counts.values()).most_common(1)[0][0] if counts else 0
    for part in parts:
        for operator in operators:
            if counts[part, operator] != usual:
                raise MeasurementError(
                    f"part {part} was measured {counts[part, operator]} times by operator {operator} and others "
                    f"{usual} times: a crossed study needs every part equally often by every operator"
                )
    cells = {key: [value for part, operator, value in measured if (part, operator) == key] for key in counts}
    values = np.array([[cells[part, operator] for operator in operators] for part in parts], np.float64)
    return values.reshape(len(parts), len(operators), usual), parts, operators

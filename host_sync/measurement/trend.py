"""One number over many results in order: mean, range, control limits of the individuals chart, and capability.

Control limits are the mean ± 2.66 mean moving ranges (ISO 7870-2, individuals). Cp and Cpk hold the spread from one
result to the next (mean moving range over 1.128) against the tolerance, Ppk the spread of all.

Uncertainty: what the calibration does not know is common to all results, so it does not average out. It is taken as the
median standard uncertainty of the numbers. The mean has that and s/√n; Cpk has that over three spreads, and the
chance of so few results: 1/(9 n) for their mean, and for their mean moving range Cpk² (0.826 n - 1)/(n - 1)². Both are
expanded by the numbers' coverage factor, and not known where a doubt voids the ± of a number that takes part.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, Final, get_args

import msgspec
import numpy as np

from device.surface import Float64Array
from host_sync.measurement.measurement import COPY, Measurement
from host_sync.measurement.quantity import DIRECTION, NO_PITCH_SIGMA, VOID, Limits, Quantity, decimals, plain
from host_sync.results.record import REPLACED, DoubtKind

INDIVIDUALS: Final = 2.66
PER_RANGE: Final = 1.128
"""Mean range of two normal values, in standard deviations."""

RANGES_VARIANCE: Final = 0.826
"""Relative variance of the mean of n - 1 moving ranges of normal values, times n, for many of them."""

MIN_COUNT: Final = 2

SCHEMA: Final = "retrograph.trend/1"


class Trend(msgspec.Struct, frozen=True, kw_only=True):
    """One number over many results.

    Lengths and limits are in its unit, uncertainties are expanded by `coverage_factor`, and None is not known.

    count : results with a value
    range : largest minus smallest
    deviation : standard deviation of all
    control_low, control_high : control limits of the individuals
    beyond : which results lie outside them, counted over all from 0
    cp, cpk, ppk : None without a tolerance, or without a spread
    doubts : what is doubted of the results that take part, and of how many
    replaced, copies : results with a value that do not take part, for their scans were taken again or are copies
    """

    count: int
    mean: float
    mean_uncertainty: float | None
    smallest: float
    largest: float
    range: float
    deviation: float
    control_low: float
    control_high: float
    beyond: tuple[int, ...] = ()
    cp: float | None = None
    cpk: float | None = None
    cpk_uncertainty: float | None = None
    ppk: float | None = None
    coverage_factor: int = 1
    doubts: tuple[str, ...] = ()
    replaced: int = 0
    copies: int = 0

    def text(self, unit: str) -> str:
        """For example "12 results: mean 1.83 ± 0.06 µm, range 0.2 µm, s 0.05 µm; Cpk 1.4 ± 0.3, Ppk 1.2; k = 1"."""
        after = f" {unit}" if unit else ""
        parts = [
            f"mean {with_uncertainty(self.mean, self.mean_uncertainty, after)}",
            f"range {plain(self.range)}{after}",
        ]
        parts.append(f"s {plain(self.deviation)}{after}")
        words = f"{self.count} results: {', '.join(parts)}"
        words += f"; control limits {plain(self.control_low)} to {plain(self.control_high)}{after}"
        words += f", {len(self.beyond)} beyond" if self.beyond else ""
        if self.cpk is not None and self.ppk is not None:
            cp = "" if self.cp is None else f"Cp {self.cp:.2f}, "
            words += f"; {cp}Cpk {with_uncertainty(self.cpk, self.cpk_uncertainty)}, Ppk {self.ppk:.2f}"
        words += "" if self.mean_uncertainty is None else f"; k = {self.coverage_factor}"
        words += f"; without {self.replaced} that were taken again" if self.replaced else ""
        words += f"; without {self.copies} that copy another" if self.copies else ""
        return f"{words}; doubts: {', '.join(self.doubts)}" if self.doubts else words


def trend_of(
    values: Sequence[float | None],
    sigmas: Sequence[float | None],
    low: float | None = None,
    high: float | None = None,
    *,
    coverage_factor: int = 1,
    warnings: Sequence[Sequence[str]] = (),
) -> Trend | None:
    """Return the trend of values in order, None where one is not known; None with fewer than two.

    sigmas : standard uncertainty of each value; the trend has none where a value that takes part has none
    low, high : the tolerance
    coverage_factor : of the trend's own uncertainties
    warnings : reasons to distrust each value, its doubts among them; empty where there are none. A value whose scan was
        taken again, or that is a copy, takes no part, as if it had not been asked for
    """
    said = list(warnings) if warnings else [()] * len(values)
    again, copies = (
        np.array([any(one.startswith(kind) for one in words) for words in said], bool) for kind in (REPLACED, COPY)
    )
    replaced = again | copies
    every = np.array([np.nan if value is None else value for value in values], np.float64)
    counts = [int((which & np.isfinite(every)).sum()) for which in (again, copies & ~again)]
    every[replaced] = np.nan
    seen = every[np.isfinite(every)]
    if seen.size < MIN_COUNT:
        return None
    mean, deviation = float(seen.mean()), float(seen.std(ddof=1))
    steps = np.abs(np.diff(every[~replaced]))
    steps = steps[np.isfinite(steps)]  # over a missing result nothing is known of neighbours
    if not steps.size:
        return None
    step = float(steps.mean())
    bounds = mean - INDIVIDUALS * step, mean + INDIVIDUALS * step
    said = [words for value, words in zip(every, said, strict=True) if np.isfinite(value)]
    own = [sigma for sigma, value in zip(sigmas, every, strict=True) if np.isfinite(value)]
    holds = not any(one.startswith(VOID) for words in said for one in words)
    common = None
    if holds and all(sigma is not None and np.isfinite(sigma) for sigma in own):
        common = float(np.sqrt(np.mean([sigma**2 for sigma in own if sigma is not None])))
    cp, cpk, ppk = _capability(seen, step / PER_RANGE, deviation, low, high)
    cpk_uncertainty = None
    if cpk is not None and common is not None:
        count = steps.size
        chance = 1.0 / (9.0 * seen.size) + cpk**2 * (RANGES_VARIANCE * (count + 1) - 1.0) / count**2
        cpk_uncertainty = coverage_factor * float(np.sqrt(chance + (common / (3.0 * step / PER_RANGE)) ** 2))
    return Trend(
        count=int(seen.size),
        mean=mean,
        mean_uncertainty=(
            None if common is None else coverage_factor * float(np.hypot(common, deviation / np.sqrt(seen.size)))
        ),
        smallest=float(seen.min()),
        largest=float(seen.max()),
        range=float(np.ptp(seen)),
        deviation=deviation,
        control_low=bounds[0],
        control_high=bounds[1],
        beyond=tuple(int(at) for at in np.flatnonzero((every < bounds[0]) | (every > bounds[1]))),
        cp=cp,
        cpk=cpk,
        cpk_uncertainty=cpk_uncertainty,
        ppk=ppk,
        coverage_factor=coverage_factor,
        doubts=tuple(_doubted(said)),
        replaced=counts[0],
        copies=counts[1],
    )


def is_doubt(warning: str) -> bool:
    """Return whether a number's warning is one that its trend states: a doubt, or a ± that is not whole."""
    return warning.startswith((*get_args(DoubtKind), NO_PITCH_SIGMA))


def _doubted(warnings: Sequence[Sequence[str]]) -> Iterable[str]:
    """For example "failed calibration (3 of 12)", the most frequent first."""
    count = Counter(kind for words in warnings for kind in {w.partition(":")[0] for w in words if is_doubt(w)})
    return (f"{kind} ({many} of {len(warnings)})" for kind, many in count.most_common())


def _capability(
    seen: Float64Array, spread: float, deviation: float, low: float | None, high: float | None
) -> tuple[float | None, float | None, float | None]:
    """Cp, Cpk and Ppk."""
    sides = [None if low is None else seen.mean() - low, None if high is None else high - seen.mean()]
    room = [side for side in sides if side is not None]
    if not room or not spread > 0.0 or not deviation > 0.0:
        return None, None, None
    cp = None if low is None or high is None else (high - low) / (6.0 * spread)
    return cp, float(min(room)) / (3.0 * spread), float(min(room)) / (3.0 * deviation)


def trends(measurements: Sequence[Measurement]) -> dict[tuple[str, str], tuple[Quantity, list[Quantity | None], Trend]]:
    """Return each number that two results or more have: an example of it, one per result, and its trend."""
    rows: dict[tuple[str, str], list[Quantity | None]] = {}
    for at, measurement in enumerate(measurements):
        for one in measurement.quantities:
            rows.setdefault((one.subject, one.name), [None] * len(measurements))[at] = one
    found = {}
    for key, row in rows.items():
        known = [one for one in row if one is not None]
        limits = known[0].limits
        values = [None if one is None else one.value for one in row]
        trend = trend_of(
            _about_their_mean(values) if key[1] == DIRECTION else values,
            [None if one is None or one.uncertainty is None else one.uncertainty / one.coverage_factor for one in row],
            *((limits.low, limits.high) if limits else ()),
            coverage_factor=known[0].coverage_factor,
            warnings=[() if one is None else one.warnings for one in row],
        )
        if trend is not None:
            found[key] = known[0], row, trend
    return found


def _about_their_mean(directions_deg: Sequence[float | None]) -> list[float | None]:
    """Return directions of a texture, which repeat after 180 degrees, within 90 degrees of their mean."""
    known = np.array([one for one in directions_deg if one is not None and np.isfinite(one)])
    mean = 0.5 * float(np.degrees(np.angle(np.exp(2j * np.radians(known)).sum())))
    return [None if one is None else mean + (one - mean + 90.0) % 180.0 - 90.0 for one in directions_deg]


def trend_record(measurements: Sequence[Measurement]) -> dict[str, Any]:
    """Return the record of all trends that `--json` writes after the results'; uncertainties as in `Trend`."""
    return {
        "schema": SCHEMA,
        "results": [str(one.folder) for one in measurements],
        "trends": [
            {"subject": subject, "name": name, "unit": example.unit, "limits": example.limits and _ends(example.limits)}
            | {"values": [None if one is None else one.value for one in row]}
            | msgspec.to_builtins(trend)
            for (subject, name), (example, row, trend) in trends(measurements).items()
        ],
    }


def _ends(limits: Limits) -> dict[str, float | None]:
    return {"low": limits.low, "high": limits.high}


def with_uncertainty(value: float, uncertainty: float | None, after: str = "") -> str:
    """For example "1.83 ± 0.06 µm"; `after` is the unit with a space before it."""
    if uncertainty is None:
        return f"{plain(value)}{after} (± not known)"
    places = max(decimals(uncertainty), 0)
    return f"{value:.{places}f} ± {uncertainty:.{places}f}{after}"

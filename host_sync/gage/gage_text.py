"""Text of a gage study."""

from __future__ import annotations

from typing import Final

from host_sync.gage.gage import Estimate, GageStudy

GOOD_PERCENT: Final = 10.0
USABLE_PERCENT: Final = 30.0
MIN_CATEGORIES: Final = 5


def study_text(study: GageStudy, what: str, unit: str) -> str:
    """The tables of a study: ANOVA, spreads with confidence intervals, and the verdict."""
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
    """The verdict by the AIAG rule of thumb."""
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

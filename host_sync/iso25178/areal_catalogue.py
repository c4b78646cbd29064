"""Areal parameters by name: group, unit, and dependence on lateral lengths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

AREAL_SUBJECT: Final = "surface"
"""Subject of areal parameters; other subjects are names from the recipe."""


@dataclass(frozen=True, slots=True)
class ParameterKind:
    """Kind of a parameter.

    unit : empty for a pure number
    stretch_power : exponent of its dependence on lateral lengths
    """

    unit: str
    stretch_power: float = 0.0


_UM: Final = ParameterKind("µm")
_NUMBER: Final = ParameterKind("")
_PERCENT: Final = ParameterKind("%")
_PER_AREA: Final = ParameterKind("µm³/µm²")

HEIGHT: Final = {"Sa": _UM, "Sq": _UM, "Sp": _UM, "Sv": _UM, "Sz": _UM, "Ssk": _NUMBER, "Sku": _NUMBER}
HYBRID: Final = {"Sdq": ParameterKind("µm/µm", -1.0), "Sdr": ParameterKind("%", -2.0)}
SPATIAL: Final = {"Sal": ParameterKind("µm", 1.0), "Str": _NUMBER, "Std": ParameterKind("°")}
FUNCTIONAL: Final = {
    "Sk": _UM,
    "Spk": _UM,
    "Svk": _UM,
    "Smr1": _PERCENT,
    "Smr2": _PERCENT,
    "Sxp": _UM,
    "Vmp": _PER_AREA,
    "Vmc": _PER_AREA,
    "Vvc": _PER_AREA,
    "Vvv": _PER_AREA,
}
SHAPE: Final = frozenset({"Ssk", "Spk", "Smr1", "Str"})
"""Parameters of shape. Without an L-filter, waviness dominates them; slopes determine it least and the samples do not
contain
its error, so no uncertainty is stated."""

GROUPS: Final = {"height": HEIGHT, "hybrid": HYBRID, "spatial": SPATIAL, "functional": FUNCTIONAL}
AREAL: Final = HEIGHT | HYBRID | SPATIAL | FUNCTIONAL

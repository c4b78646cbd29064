"""Between which two Gaussian filters the detail of a height map lies."""

from __future__ import annotations

from dataclasses import dataclass

from host_sync.errors import FilterError


@dataclass(frozen=True, slots=True)
class DetailBand:
    """Nesting indices, µm; None leaves the filter out.

    Raises
    ------
    FilterError
        An index is not a positive length, or the S-filter takes away what the L-filter leaves.
    """

    s_um: float | None
    l_um: float | None

    def __post_init__(self) -> None:
        for name, index_um in (("S", self.s_um), ("L", self.l_um)):
            if index_um is not None and not 0.0 < index_um < float("inf"):
                raise FilterError(f"the {name}-filter's nesting index is {index_um:g} µm: give a positive length")
        if self.s_um is not None and self.l_um is not None and self.s_um >= self.l_um:
            raise FilterError(
                f"the S-filter at {self.s_um:g} µm takes away all that the L-filter at {self.l_um:g} µm leaves: "
                "give it the smaller nesting index"
            )

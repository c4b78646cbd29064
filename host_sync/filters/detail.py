"""Detail of a height map between an S-filter and an L-filter (paper, section 6.1; ISO 16610-61).

Both are areal Gaussian filters with 50 % transmission at the nesting index. The S-filter removes shorter wavelengths,
the L-filter longer ones: detail = S-filtered surface minus its L-filtered mean.
"""

from __future__ import annotations

from dataclasses import dataclass

from device.surface.fields import HeightMap
from host_sync.errors import FilterError


@dataclass(frozen=True, slots=True)
class DetailBand:
    """Nesting indices of the S-filter and the L-filter, µm; None for no filter.

    Raises
    ------
    FilterError
        An index is not a positive length, or the S-filter removes all that the L-filter leaves.
    """

    s_um: float | None
    l_um: float | None

    def __post_init__(self) -> None:
        for name, index_um in (("S", self.s_um), ("L", self.l_um)):
            if index_um is not None and not 0.0 < index_um < float("inf"):
                raise FilterError(f"the {name}-filter's nesting index is {index_um:g} µm: give a positive length")
        if self.s_um is not None and self.l_um is not None and self.s_um >= self.l_um:
            raise FilterError(
                f"the S-filter at {self.s_um:g} µm removes all that the L-filter at {self.l_um:g} µm leaves: "
                "give it a smaller nesting index"
            )


def detail(height: HeightMap, band: DetailBand) -> HeightMap:
    """Return the height map between the band's nesting indices, NaN where the height map is invalid."""
    from host_sync.filters.gaussian_regression import gaussian_mean  # compiled code, loaded when it is needed

    z_um = height.z_um if band.s_um is None else gaussian_mean(height.z_um, band.s_um / height.pitch_um)
    if band.l_um is not None:
        z_um = z_um - gaussian_mean(z_um, band.l_um / height.pitch_um)
    return HeightMap(z_um, height.pitch_um)

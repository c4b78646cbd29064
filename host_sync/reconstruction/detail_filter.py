"""Detail of a height map: what lies between an S-filter and an L-filter (paper, section 6.1; ISO 16610-61).

Both are areal Gaussian filters, which pass one half of a sinusoid whose period is the nesting index. The S-filter takes
away what is shorter, the L-filter what is longer: detail = S-filtered surface less its L-filtered mean.
"""

from __future__ import annotations

from device.surface import HeightMap
from host_sync.detail_band import DetailBand
from host_sync.measurement.gaussian_regression import gaussian_mean


def detail(height: HeightMap, band: DetailBand) -> HeightMap:
    """The height map between the band's nesting indices, NaN where the height map has none."""
    z_um = height.z_um if band.s_um is None else gaussian_mean(height.z_um, band.s_um / height.pitch_um)
    if band.l_um is not None:
        z_um = z_um - gaussian_mean(z_um, band.l_um / height.pitch_um)
    return HeightMap(z_um, height.pitch_um)

"""Float TIFF: page 1 the height in µm, page 2 its standard uncertainty; float32, not compressed, NaN where invalid."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np
import tifffile

from host_sync.export.source_surface import SourceSurface, ascii_line


def write_float_tiff(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map and its uncertainty, with the pixel pitch as resolution."""
    per_cm = 1e4 / surface.pitch_um
    pages = [("height", surface.z_um)]
    if surface.sigma_um is not None:
        pages.append(("standard uncertainty of height", surface.sigma_um))
    with tifffile.TiffWriter(file, bigtiff=sum(page.nbytes for _, page in pages) > 2**32 - 2**20) as tiff:
        for title, values in pages:
            said = f"{title}, um; pixel pitch {surface.pitch_um:g} um; NaN is invalid; {surface.name}; {surface.origin}"
            tiff.write(
                values.astype(np.float32, copy=False),
                photometric="minisblack",
                rowsperstrip=64,
                resolution=(per_cm, per_cm),
                resolutionunit="CENTIMETER",
                description=ascii_line(said).decode(),
                software="retrograph",
                metadata=None,
            )

"""16-bit greyscale PNG: 0 is invalid, 1 to 65535 span the lowest to the highest valid height.

The scale is stored in text chunks (under our names and those that Gwyddion reads), in the resolution (pHYs), and in a
JSON file beside the picture for programs that drop text.
"""

from __future__ import annotations

from typing import Any, BinaryIO, Final

import msgspec
import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from host_sync.export.row_blocks import ROWS
from host_sync.export.source_surface import SourceSurface

UM: Final = 1e-6
TOP: Final = 65535


def write_png16(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map, quantised to 65,534 steps; the uncertainty is not written."""
    scale = png_scale(surface)
    zero_um, step_um = scale["height_at_0_um"], scale["height_step_um"]
    grey = np.empty(surface.z_um.shape, np.uint16)
    for first in range(0, surface.rows, ROWS):
        counts = np.rint((surface.z_um[first : first + ROWS] - np.float64(zero_um)) / step_um)
        grey[first : first + ROWS] = np.nan_to_num(counts, nan=0.0)
    chunks = PngInfo()
    texts = {
        "Title": surface.name,
        "Description": "height map: height_um = height_at_0_um + grey * height_step_um; grey 0 is invalid",
        **{key: repr(value) for key, value in scale.items() if isinstance(value, float)},
        "Gwy::Title": surface.name,
        "Gwy::XReal": repr(surface.columns * surface.pitch_um * UM),
        "Gwy::YReal": repr(surface.rows * surface.pitch_um * UM),
        "Gwy::XYUnit": "m",
        "Gwy::ZUnit": "m",
        "Gwy::ZMin": repr(zero_um * UM),
        "Gwy::ZMax": repr((zero_um + TOP * step_um) * UM),
    }
    for key, value in texts.items():
        chunks.add_itxt(key, value) if not value.isascii() else chunks.add_text(key, value)
    picture = Image.fromarray(grey)
    picture.save(file, "png", pnginfo=chunks, dpi=(25400.0 / surface.pitch_um,) * 2, compress_level=3)


def write_png_scale(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the scale of the picture as JSON."""
    file.write(msgspec.json.format(msgspec.json.encode(png_scale(surface)), indent=2) + b"\n")


def png_scale(surface: SourceSurface) -> dict[str, Any]:
    """Scale of the picture: `height_um = height_at_0_um + grey * height_step_um`, grey 0 is invalid."""
    lowest, highest = float(np.nanmin(surface.z_um)), float(np.nanmax(surface.z_um))
    step_um = (highest - lowest) / (TOP - 1) or 1e-6
    return {
        "name": surface.name,
        "origin": surface.origin,
        "pixel_pitch_um": surface.pitch_um,
        "height_at_0_um": lowest - step_um,
        "height_step_um": step_um,
        "grey_of_invalid": 0,
    }

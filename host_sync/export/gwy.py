"""Gwyddion's native format: height, uncertainty and mask of invalid pixels, float64 in metres.

A mask marks pixels and does not replace their values, so invalid pixels must hold a number: the mean of the valid ones.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO, Final

import numpy as np

from device.surface.fields import Float32Array
from host_sync.errors import ExportError
from host_sync.export.source_surface import SourceSurface, row_blocks

UM: Final = 1e-6
LARGEST: Final = 2**32 - 1
"""Limit of the 32-bit sizes."""


def write_gwy(file: BinaryIO, surface: SourceSurface) -> None:
    """Write channel 0, the height, and channel 1, its standard uncertainty, each with its mask.

    Raises
    ------
    ExportError
        The field is too large for the format.
    """
    channels = [("Height", surface.z_um)]
    if surface.sigma_um is not None:
        channels.append(("Standard uncertainty of height", surface.sigma_um))
    fields = 2 * len(channels) * (8 * surface.z_um.size + 1000)
    if fields > LARGEST:
        raise ExportError(f"{surface.name}: a GWY file ends at 4 GB and this needs {fields / 1e9:.1f}: use gsf or npz")
    parts: list[bytes | _Field] = []
    for number, (title, values_um) in enumerate(channels):
        parts += [
            _component(f"/{number}/data/title", b"s" + _text(title)),
            _component(f"/{number}/data/visible", b"b\1"),
            _Field(f"/{number}/data", values_um, surface.pitch_um, is_mask=False),
            _component(f"/{number}/meta", b"o" + _object("GwyContainer", _meta(surface))),
        ]
        if np.isnan(values_um).any():
            parts.append(_Field(f"/{number}/mask", values_um, surface.pitch_um, is_mask=True))
    size = sum(len(part) if isinstance(part, bytes) else part.size for part in parts)
    file.write(b"GWYPGwyContainer\0" + struct.pack("<I", size))
    for part in parts:
        file.writelines([part] if isinstance(part, bytes) else part.blocks())


class _Field:
    """A component with a GwyDataField, whose values are converted while they are written."""

    def __init__(self, key: str, values_um: Float32Array, pitch_um: float, *, is_mask: bool) -> None:
        rows, columns = values_um.shape
        self._values, self._is_mask = values_um, is_mask
        head = b"".join(
            _component(name, kind)
            for name, kind in (
                ("xres", struct.pack("<ci", b"i", columns)),
                ("yres", struct.pack("<ci", b"i", rows)),
                ("xreal", struct.pack("<cd", b"d", columns * pitch_um * UM)),
                ("yreal", struct.pack("<cd", b"d", rows * pitch_um * UM)),
                ("si_unit_xy", b"o" + _unit("m")),
                ("si_unit_z", b"o" + _unit("" if is_mask else "m")),
            )
        )
        head += b"data\0D" + struct.pack("<I", values_um.size)
        self._head = _component(key, b"oGwyDataField\0" + struct.pack("<I", len(head) + 8 * values_um.size) + head)
        self.size = len(self._head) + 8 * values_um.size

    def blocks(self) -> Iterator[bytes]:
        """The component's bytes."""
        yield self._head
        if self._is_mask:
            # 0 for valid pixels, 1 for invalid ones.
            yield from row_blocks(self._values, 0.0, "<f8", invalid=1.0)
        else:
            yield from row_blocks(self._values, UM, "<f8", invalid=float(np.nanmean(self._values, dtype=float)) * UM)


def _meta(surface: SourceSurface) -> bytes:
    said = {
        "Name": surface.name,
        "Origin": surface.origin,
        "Written": surface.written_utc,
        "Pixel pitch": f"{surface.pitch_um:g} µm",
        "Doubts": "; ".join(surface.doubts),
    }
    return b"".join(_component(key, b"s" + _text(value)) for key, value in said.items() if value)


def _component(key: str, value: bytes) -> bytes:
    return key.encode() + b"\0" + value


def _text(text: str) -> bytes:
    return text.encode() + b"\0"


def _object(kind: str, components: bytes) -> bytes:
    return kind.encode() + b"\0" + struct.pack("<I", len(components)) + components


def _unit(unit: str) -> bytes:
    return _object("GwySIUnit", _component("unitstr", b"s" + _text(unit)))

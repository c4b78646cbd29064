"""Formats of a height map with a fixed header: SUR, GSF, AL3D and SDF.

SUR, Digital Surf, classical: a header of 512 bytes, then int32, lengths in mm; min - 2 where not measured.

GSF, Gwyddion Simple Field 1.0: lines of text, then float32 in metres, top row first, NaN where invalid.

AL3D, Alicona, version 1: tags of 52 bytes, a comment, then float32 in metres, rows padded to 8 bytes.

SDF of ISO 25178-71, binary, ISO-1.0: 81 bytes, then float64 in µm with their scale to metres. Invalid pixels are NaN.
Gwyddion 2.62 takes the standard's own marker, the lowest number of the type, for a height of -1.8e308; it masks NaN, as
surfalize does, and no program can take NaN for a height.
"""

from __future__ import annotations

import hashlib
import struct
import zipfile
from collections.abc import Iterator
from datetime import datetime
from typing import BinaryIO, Final
from xml.sax.saxutils import escape

import numpy as np

from device.surface import Float32Array
from host_sync.errors import ExportError
from host_sync.export.source_surface import SourceSurface, ascii_line, integer_quantum, row_blocks

UM: Final = 1e-6
UM_TO_MM: Final = 1e-3
SUR_HEADER: Final = "<12shhhh30s30shhhhhf4xhiiiiifff16s16s16s16s16s16s16s16s16sfffhhh12xhhhhhhhfI6xhh128sfffff13s13s"
SUR_SURFACE: Final = 2
STRUCTURED_LIGHT: Final = 10


def write_sur(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map in steps of 1e-9 of its highest value; the uncertainty is not written."""
    step_mm = float(np.float32(integer_quantum(surface.z_um) * UM_TO_MM))
    counts_a_um = UM_TO_MM / step_mm
    lowest, highest = (round(float(limit(surface.z_um)) * counts_a_um) for limit in (np.nanmin, np.nanmax))
    gaps = bool(np.isnan(surface.z_um).any())
    mm = b"mm"
    pitch_mm = surface.pitch_um * UM_TO_MM
    comment = ascii_line(surface.origin)[: 2**15 - 1]
    head = struct.pack(
        SUR_HEADER,
        b"DIGITAL SURF", 0, 1, 1, SUR_SURFACE,
        ascii_line(surface.name)[:30].ljust(30), b"".ljust(30),
        0, STRUCTURED_LIGHT, 0, gaps, 0, 0.0,
        32, lowest, highest, surface.columns, surface.rows, surface.z_um.size,
        pitch_mm, pitch_mm, step_mm,
        *(name.ljust(16) for name in (b"X", b"Y", b"Z", *(mm,) * 6)),
        1.0, 1.0, 1.0,
        0, 0, 0,
        *_clock(surface.written_utc),
        0.0, 0,
        len(comment), 0, b"",
        0.0, 0.0, 0.0, 0.0, 0.0, b"", b"",
    )  # fmt: skip
    file.write(head + comment)
    file.writelines(row_blocks(surface.z_um, counts_a_um, "<i4", invalid=lowest - 2))


def _clock(written_utc: str) -> tuple[int, ...]:
    """Second, minute, hour, day, month, year, day of the week (Sunday is 0); zeros when unknown."""
    try:
        at = datetime.fromisoformat(written_utc)
    except ValueError:
        return (0,) * 7
    return at.second, at.minute, at.hour, at.day, at.month, at.year, at.isoweekday() % 7


def write_gsf(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map; the format has one field, so the uncertainty is not written."""
    lines = {
        "XRes": surface.columns,
        "YRes": surface.rows,
        "XReal": repr(surface.columns * surface.pitch_um * UM),
        "YReal": repr(surface.rows * surface.pitch_um * UM),
        "XYUnits": "m",
        "ZUnits": "m",
        "Title": surface.name,
        "Origin": surface.origin,
        "Doubts": "; ".join(surface.doubts),
    }
    text = "Gwyddion Simple Field 1.0\n" + "".join(f"{key} = {value}\n" for key, value in lines.items() if value)
    head = text.encode()
    file.write(head + b"\0" * (4 - len(head) % 4))
    file.writelines(row_blocks(surface.z_um, UM, "<f4"))


AL3D_MAGIC: Final = b"AliconaImaging\0\r\n"
AL3D_INVALID: Final = float(np.float32(3e15))
AL3D_COMMENT_BYTES: Final = 256
"""Including its line end."""


def write_al3d(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the depth image; the uncertainty is not written: the format's quality map means repeatability."""
    tags = {
        "Cols": surface.columns,
        "Rows": surface.rows,
        "PixelSizeXMeter": repr(surface.pitch_um * UM),
        "PixelSizeYMeter": repr(surface.pitch_um * UM),
        "InvalidPixelValue": repr(AL3D_INVALID),
        "DepthImageOffset": len(AL3D_MAGIC) + 52 * 11 + AL3D_COMMENT_BYTES,
        "TextureImageOffset": 0,
        "NumberOfPlanes": 0,
        "IconOffset": 0,
    }
    said = (surface.doubtful, surface.name, surface.origin)
    comment = ascii_line("; ".join(part for part in said if part))[: AL3D_COMMENT_BYTES - 3]
    file.write(AL3D_MAGIC)
    for key, value in {"Version": 1, "TagCount": len(tags), **tags}.items():
        file.write(struct.pack("20s30s2s", key.encode(), str(value).encode(), b"\r\n"))
    file.write(comment.ljust(AL3D_COMMENT_BYTES - 2, b"\0") + b"\r\n")
    file.writelines(row_blocks(surface.z_um, UM, "<f4", invalid=AL3D_INVALID, padding=-4 * surface.columns % 8))


SDF_DOUBLE: Final = 7
SDF_MAX_POINTS: Final = 2**16 - 1


def write_sdf(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map; the uncertainty is not written.

    Raises
    ------
    ExportError
        The field has more rows or columns than the format allows.
    """
    if max(surface.z_um.shape) > SDF_MAX_POINTS:
        raise ExportError(
            f"{surface.name}: SDF ends at {SDF_MAX_POINTS} and the field is {surface.columns}x{surface.rows}: use x3p"
        )
    written = _moment(surface.written_utc)
    file.write(
        struct.pack(
            "<8s10s12s12sHHddddBBB",
            b"bISO-1.0",
            b"Retrograph",
            written,
            written,
            surface.columns,
            surface.rows,
            surface.pitch_um * UM,
            surface.pitch_um * UM,
            UM,
            -1.0,
            0,
            SDF_DOUBLE,
            0,
        )
    )
    file.writelines(row_blocks(surface.z_um, 1.0, "<f8"))
    file.write(b"\r\nName = %b\r\nOrigin = %b\r\n" % (ascii_line(surface.name), ascii_line(surface.origin)))


def _moment(written_utc: str) -> bytes:
    """Day, month, year, hour and minute in twelve digits; zeros when unknown."""
    try:
        return datetime.fromisoformat(written_utc).strftime("%d%m%Y%H%M").encode()
    except ValueError:
        return b"0" * 12


# X3P of ISO 25178-72 (ISO 5436-2): a zip with an XML record and float32 heights in metres, NaN where invalid.
#
# Rows are stored from the top down, as other writers of areal instruments do and as readers show them.

NAMESPACE: Final = "http://www.opengps.eu/2008/ISO5436_2"
UNKNOWN_TIME: Final = "1970-01-01T00:00:00Z"
"""Date of a result without one: the format requires a date."""

_AXIS = """      <C{axis}>
        <AxisType>I</AxisType>
        <DataType>D</DataType>
        <Increment>{pitch!r}</Increment>
        <Offset>0.0</Offset>
      </C{axis}>
"""
_RECORD = """<?xml version="1.0" encoding="UTF-8" standalone="no"?>
<p:ISO5436_2 xmlns:p="{namespace}" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance">
  <Record1>
    <Revision>ISO5436 - 2000</Revision>
    <FeatureType>SUR</FeatureType>
    <Axes>
{x}{y}      <CZ>
        <AxisType>A</AxisType>
        <DataType>F</DataType>
        <Increment>1.0</Increment>
        <Offset>0.0</Offset>
      </CZ>
    </Axes>
  </Record1>
  <Record2>
    <Date>{written}</Date>
    <Instrument>
      <Manufacturer>Retrograph</Manufacturer>
      <Model>coated gel, one RGB frame</Model>
      <Serial>not available</Serial>
      <Version>{origin}</Version>
    </Instrument>
    <CalibrationDate>{written}</CalibrationDate>
    <ProbingSystem>
      <Type>NonContacting</Type>
      <Identification>photometric, through a gel</Identification>
    </ProbingSystem>
    <Comment>{comment}</Comment>
  </Record2>
  <Record3>
    <MatrixDimension>
      <SizeX>{columns}</SizeX>
      <SizeY>{rows}</SizeY>
      <SizeZ>1</SizeZ>
    </MatrixDimension>
    <DataLink>
      <PointDataLink>bindata/data.bin</PointDataLink>
      <MD5ChecksumPointData>{checksum}</MD5ChecksumPointData>
    </DataLink>
  </Record3>
  <Record4>
    <ChecksumFile>md5checksum.hex</ChecksumFile>
  </Record4>
</p:ISO5436_2>
"""


def write_x3p(file: BinaryIO, surface: SourceSurface) -> None:
    """Write the height map; the format has one field per layer, so the uncertainty is not written."""
    data = hashlib.md5(usedforsecurity=False)
    for block in _heights(surface):
        data.update(block)
    record = _RECORD.format(
        namespace=NAMESPACE,
        x=_AXIS.format(axis="X", pitch=surface.pitch_um * UM),
        y=_AXIS.format(axis="Y", pitch=surface.pitch_um * UM),
        written=escape(surface.written_utc or UNKNOWN_TIME),
        origin=escape(surface.origin or "not available"),
        comment=escape("; ".join((surface.name, *surface.doubts))),
        columns=surface.columns,
        rows=surface.rows,
        checksum=data.hexdigest(),
    ).encode()
    # Lower case: some readers compare the checksum as text.
    own = hashlib.md5(record, usedforsecurity=False).hexdigest()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr(_entry("main.xml"), record)
        with archive.open(_entry("bindata/data.bin"), "w", force_zip64=4 * surface.z_um.size > 2**31 - 1) as heights:
            heights.writelines(_heights(surface))
        archive.writestr(_entry("md5checksum.hex"), f"{own} *main.xml\n")


def _heights(surface: SourceSurface) -> Iterator[bytes]:
    return row_blocks(surface.z_um, UM, "<f4")


def _entry(name: str) -> zipfile.ZipInfo:
    """Return a zip entry with a fixed time, so that the same surface gives the same bytes."""
    entry = zipfile.ZipInfo(name)
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


# Gwyddion's native format: height, uncertainty and mask of invalid pixels, float64 in metres.
#
# A mask marks pixels and does not replace their values, so invalid pixels must hold a number: the mean of the valid
# ones.

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
        """Yield the component's bytes."""
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

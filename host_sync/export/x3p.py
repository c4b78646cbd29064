"""X3P of ISO 25178-72 (ISO 5436-2): a zip with an XML record and float32 heights in metres, NaN where invalid.

Rows are stored from the top down, as other writers of areal instruments do and as readers show them.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Iterator
from typing import BinaryIO, Final
from xml.sax.saxutils import escape

from host_sync.export.source_surface import SourceSurface, row_blocks

UM: Final = 1e-6
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
    """A zip entry with a fixed time, so that the same surface gives the same bytes."""
    entry = zipfile.ZipInfo(name)
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry

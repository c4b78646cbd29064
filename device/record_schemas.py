"""JSON Schema of every record, for other programs: `docs/schemas/` holds what this module says.

After a change: python -c "import pathlib, device.record_schemas as s; s.write_schemas(pathlib.Path('docs/schemas'))"
"""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any, Final

import msgspec

from device.active_calibration import ActiveCalibration
from device.calibration_bundle import CalibrationRecord
from device.calibration_slots import Slots
from device.device_identity import DeviceState
from device.gel_log import GelRecord, MountedGel
from device.raw_file import RawHeader
from device.receipts import Receipt
from device.records import Record
from device.scan_bundle import ScanRecord
from device.scan_marks import ScanMark

_RECORDS: Final[tuple[type[Record], ...]] = (
    ScanRecord,
    CalibrationRecord,
    RawHeader,
    DeviceState,
    ActiveCalibration,
    Receipt,
    ScanMark,
    GelRecord,
    MountedGel,
    Slots,
)


def schemas() -> dict[str, dict[str, Any]]:
    """JSON Schema by file name, such as "scan-1.json"."""
    return {_file_name(record): _tidied(msgspec.json.schema(record)) for record in _RECORDS}


def write_schemas(folder: Path) -> None:
    """Write every schema into a folder, one file a record."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, schema in schemas().items():
        (folder / name).write_bytes(schema_bytes(schema))


def schema_bytes(schema: dict[str, Any]) -> bytes:
    """A schema as the committed files hold it."""
    return msgspec.json.format(msgspec.json.encode(schema), indent=2) + b"\n"


def _tidied(schema: Any) -> Any:
    """The same with docstrings without their indentation, which some versions of Python keep and others do not."""
    if isinstance(schema, dict):
        return {
            key: inspect.cleandoc(value) if key == "description" and isinstance(value, str) else _tidied(value)
            for key, value in schema.items()
        }
    return [_tidied(part) for part in schema] if isinstance(schema, list) else schema


def _file_name(record: type[Record]) -> str:
    tag = str(record.__struct_config__.tag)
    return tag.removeprefix("retrograph.").replace("/", "-") + ".json"

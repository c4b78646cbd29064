"""JSON Schema of every record, for other programs: `docs/schemas/` holds what this module writes.

After a change: python -c "import pathlib, tests.apparatus.schemas as s; s.write_schemas(pathlib.Path('docs/schemas'))"
"""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any, Final

import msgspec

from device.bundles.bundle import Receipt
from device.bundles.calibration import CalibrationRecord
from device.bundles.check import CheckRecord, CheckStandard
from device.bundles.raw_frame import RawHeader
from device.bundles.record import Record
from device.bundles.scan import ScanRecord
from device.store.choices import BalanceRecord, GelRecord, MountedGel, Presets, ScanMark, Settings, StickyAnnotations
from device.store.device_id import DeviceState
from device.store.registry_file import ActiveCalibration, RegistryFile

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
    RegistryFile,
    StickyAnnotations,
    Presets,
    Settings,
    BalanceRecord,
    CheckStandard,
    CheckRecord,
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
    """Return a schema as the committed files hold it."""
    return msgspec.json.format(msgspec.json.encode(schema), indent=2) + b"\n"


def _tidied(schema: Any) -> Any:
    """Return the schema with docstrings without indentation, which some versions of Python keep."""
    if isinstance(schema, dict):
        return {
            key: inspect.cleandoc(value) if key == "description" and isinstance(value, str) else _tidied(value)
            for key, value in schema.items()
        }
    return [_tidied(part) for part in schema] if isinstance(schema, list) else schema


def _file_name(record: type[Record]) -> str:
    tag = str(record.__struct_config__.tag)
    return tag.removeprefix("retrograph.").replace("/", "-") + ".json"

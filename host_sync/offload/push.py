"""A calibration of the library into a device's inbox, where the device proves it before it takes it."""

from __future__ import annotations

from device.bundle_layout import partial_name
from device.calibration_bundle import CALIBRATION_MANIFEST, CalibrationBundle
from device.inbox import INBOX
from device.records import seal_name
from host_sync.errors import SourceError
from host_sync.offload.source import Source


def push_calibration(source: Source, bundle: CalibrationBundle) -> None:
    """Leave a calibration, re-hashed first, in the inbox; it appears there in one step.

    Raises
    ------
    RecordError
        The library's copy is damaged; nothing is sent.
    SourceError
        The device has it in its inbox already, or takes nothing.
    """
    bundle.verify()
    name = bundle.calibration_id
    if name in source.names(INBOX):
        raise SourceError(f"{source.name}: has calibration {name} in its inbox already: run `retroscan receive` on it")
    growing = f"{INBOX}/{partial_name(name)}"
    source.make_folder(growing)
    for file_name in (*bundle.record.files, CALIBRATION_MANIFEST, seal_name(CALIBRATION_MANIFEST)):
        source.write(f"{growing}/{file_name}", bundle.directory / file_name)
    source.rename(growing, f"{INBOX}/{name}")

"""Pushing a calibration of the library into a device's inbox; the device verifies it on import."""

from __future__ import annotations

from device.bundles.calibration import CALIBRATION_MANIFEST, CalibrationBundle
from device.bundles.layout import INBOX, partial_name
from device.bundles.record import checksum_name
from host_sync.errors import SourceError
from host_sync.offload.source import Source


def push_calibration(source: Source, bundle: CalibrationBundle) -> None:
    """Verify a calibration and put it into the inbox, where it appears in one step.

    Raises
    ------
    RecordError
        The library's copy is damaged; nothing is sent.
    SourceError
        The device has it in its inbox already, or cannot be written.
    """
    bundle.verify()
    name = bundle.calibration_id
    if name in source.names(INBOX):
        raise SourceError(
            f"{source.name}: has calibration {name} in its inbox already: "
            "run `retroscan calibrations import-inbox` on it"
        )
    growing = f"{INBOX}/{partial_name(name)}"
    source.make_folder(growing)
    for file_name in (*bundle.record.files, CALIBRATION_MANIFEST, checksum_name(CALIBRATION_MANIFEST)):
        source.write(f"{growing}/{file_name}", bundle.directory / file_name)
    source.rename(growing, f"{INBOX}/{name}")

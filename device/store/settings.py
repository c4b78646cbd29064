"""Settings of the instrument that an operator chooses on its screens: a small file, so that they survive a restart."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from device.bundles.record import Record, decode_record, encode_record, read_small
from device.bundles.scan import CaptureMode
from device.errors import RecordError, StoreError
from device.io.atomic import replace_file
from device.io.os_errors import explain_os_error

Display = Literal["dark", "light"]
SETTINGS_FILE: Final = "settings.json"
SETTINGS_SCHEMA: Final = "retrograph.settings/1"
_REMEDY: Final = "remove it, and choose the settings again"


class Settings(Record, frozen=True, tag_field="schema", tag=SETTINGS_SCHEMA):
    """Settings that hold until they are changed.

    capture : how presses are taken
    number_parts : whether the part's number grows with every scan
    display : colours of the screens
    """

    capture: CaptureMode = "single"
    number_parts: bool = False
    display: Display = "dark"


def read_settings(root: Path) -> Settings:
    """The settings; the usual ones when there are none or their file is damaged."""
    path = root / SETTINGS_FILE
    if not path.exists():
        return Settings()
    try:
        return decode_record(read_small(path, _REMEDY), Settings, path, _REMEDY)
    except RecordError:
        return Settings()


def write_settings(root: Path, settings: Settings) -> None:
    """Store them durably.

    Raises
    ------
    StoreError
        The disk refused; the ones before are kept.
    """
    path = root / SETTINGS_FILE
    try:
        replace_file(path, encode_record(settings))
    except OSError as error:
        raise StoreError(f"{path}: cannot be stored {explain_os_error(error)}") from error

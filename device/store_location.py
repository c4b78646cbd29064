"""Where the store lies when nobody says otherwise."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

SERVICE_STORE: Final = Path("/var/lib/retroscan")


def default_store(environment: Mapping[str, str], service_store: Path = SERVICE_STORE) -> Path:
    """The service's folder when it exists and may be written, else `retroscan` under the user's data folder."""
    if service_store.is_dir() and os.access(service_store, os.W_OK):
        return service_store
    data_home = environment.get("XDG_DATA_HOME", "")
    base = Path(data_home) if Path(data_home).is_absolute() else Path.home() / ".local" / "share"
    return base / "retroscan"

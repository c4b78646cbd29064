"""The board profile with the mounted gel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec

from device.store.gels import mounted_gel
from hal.board_profile import BoardProfile, GelConfig
from hal.hardware import Hardware


def with_active_gel(hardware: Hardware, root: Path) -> Hardware:
    """Return the same devices, with the mounted gel in the profile instead of the board's default gel.

    Raises
    ------
    RecordError
        The store's gel record is damaged.
    """
    return replace(hardware, profile=profile_with_mounted_gel(hardware.profile, root))


def profile_with_mounted_gel(profile: BoardProfile, root: Path) -> BoardProfile:
    """The board profile with the mounted gel. Errors as for `with_active_gel`."""
    gel = mounted_gel(root, profile.gel)
    mounted = GelConfig(id=gel.gel_id, slab_thickness_mm=gel.slab_thickness_mm)
    return msgspec.structs.replace(profile, gel=mounted)

"""The hardware as it is with the gel that is mounted now."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec

from device.gel_log import mounted_gel
from hal.board_profile import BoardProfile, GelFacts
from hal.hardware import Hardware


def with_mounted_gel(hardware: Hardware, root: Path) -> Hardware:
    """The same devices, with the gel that the store says is mounted in the place of the board's own.

    Raises
    ------
    RecordError
        What the store says of the gel is damaged.
    """
    return replace(hardware, profile=profile_with_mounted_gel(hardware.profile, root))


def profile_with_mounted_gel(profile: BoardProfile, root: Path) -> BoardProfile:
    """The board's profile with the mounted gel. Errors as for `with_mounted_gel`."""
    gel = mounted_gel(root, profile.gel)
    facts = GelFacts(id=gel.gel_id, slab_thickness_mm=gel.slab_thickness_mm)
    return msgspec.structs.replace(profile, gel=facts)

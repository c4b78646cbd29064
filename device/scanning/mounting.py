"""The hardware as it is with the gel that is mounted now."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec

from device.gel_log import mounted_gel
from hal.board_profile import GelFacts
from hal.hardware import Hardware


def with_mounted_gel(hardware: Hardware, root: Path) -> Hardware:
    """The same devices, with the gel that the store says is mounted in the place of the board's own.

    Raises
    ------
    RecordError
        What the store says of the gel is damaged.
    """
    gel = mounted_gel(root, hardware.profile.gel)
    facts = GelFacts(id=gel.gel_id, slab_thickness_mm=gel.slab_thickness_mm)
    return replace(hardware, profile=msgspec.structs.replace(hardware.profile, gel=facts))

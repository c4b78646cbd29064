"""Every array that a calibration file may hold has a stated shape: one without would make each such file unreadable."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import is_dataclass
from typing import Any, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from device.inverse_map.model import InverseMap
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration_file.soundness import SHAPES


def parts(hint: Any) -> Iterator[Any]:
    """A type and those within it, arrays whole."""
    yield hint
    if get_origin(hint) is not np.ndarray:
        for one in get_args(hint):
            yield from parts(one)


def is_record(kind: type) -> bool:
    return is_dataclass(kind) or issubclass(kind, msgspec.Struct) or hasattr(kind, "_fields")


def arrays_of(record: type, seen: set[type]) -> Iterator[tuple[str, str]]:
    """Record and field of every array within a record; what is within an inverse map is its own business."""
    seen.add(record)
    for name, hint in get_type_hints(record).items():
        for one in parts(hint):
            if get_origin(one) is np.ndarray:
                yield record.__name__, name
            elif isinstance(one, type) and one is not InverseMap and one not in seen and is_record(one):
                yield from arrays_of(one, seen)


def test_every_array_of_a_calibration_has_a_stated_shape() -> None:
    found = set(arrays_of(Calibration, set()))
    assert ("Calibration", "flat_field") in found
    assert {one for one in found if one[1] not in SHAPES.get(one[0], {})} == set()

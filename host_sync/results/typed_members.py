"""A tree of typed records and arrays as members of an archive, and back, bit for bit.

The records go to one MessagePack member, which is read by their own types: a missing field, or one of another type, is
an error. Every array is a `.npy` member, read without pickle and no larger than its member.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from io import BytesIO
from math import prod
from typing import Any, Final, TypeVar, get_args, get_origin

import msgspec
import numpy as np
from numpy.lib import format as npy

T = TypeVar("T")
RECORDS_MEMBER: Final = "records.msgpack"
MAX_RECORDS_BYTES: Final = 64 << 20
MAGIC: Final = b"\x93NUMPY\x01\x00"
_HEADER: Final = re.compile(
    rb"\{'descr': '([<|][bifuc]\d{1,2})', 'fortran_order': (True|False), 'shape': \(((?:\d{1,12},? ?)*)\), \} *\n"
)
"""The header that numpy writes; what numpy reads as a header is any Python literal."""

READ_ERRORS: Final = (msgspec.MsgspecError, ValueError, TypeError, LookupError, MemoryError)
"""What reading raises for members that nobody wrote so."""


def as_members(record: object) -> dict[str, bytes]:
    """Return the members of an archive that `from_members` reads as the same record.

    An array that occurs twice is kept once.
    """
    number_of: dict[int, int] = {}
    members: dict[str, bytes] = {}

    def hook(value: Any) -> Any:
        if isinstance(value, np.floating):
            return float(value)
        if not isinstance(value, np.ndarray):
            raise NotImplementedError(f"no place for a {type(value).__name__}")
        if id(value) not in number_of:
            number_of[id(value)] = len(number_of)
            members[_array_member(number_of[id(value)])] = _npy(value)
        return number_of[id(value)]

    return {RECORDS_MEMBER: msgspec.msgpack.encode(record, enc_hook=hook), **members}


def from_members(members: Mapping[str, bytes], kind: type[T]) -> T:
    """Return the record of a type that `as_members` made these members of; one of `READ_ERRORS` when malformed."""
    arrays: dict[int, np.ndarray[Any, Any]] = {}

    def hook(wanted: Any, value: Any) -> Any:
        if wanted is np.float32:
            return np.float32(value)
        if get_origin(wanted) is not np.ndarray or not isinstance(value, int):
            raise TypeError(f"no {wanted} can be read")
        if value not in arrays:
            arrays[value] = _array(members[_array_member(value)])
        (dtype,) = get_args(get_args(wanted)[1])
        if arrays[value].dtype != np.dtype(dtype):
            raise TypeError(f"an array of {arrays[value].dtype}, not of {np.dtype(dtype)}")
        return arrays[value]

    records = members[RECORDS_MEMBER]
    if len(records) > MAX_RECORDS_BYTES:
        raise ValueError("more records than any calibration has")
    return msgspec.msgpack.decode(records, type=kind, dec_hook=hook)


def _array_member(number: int) -> str:
    return f"arrays/{number:04d}.npy"


def _npy(array: np.ndarray[Any, Any]) -> bytes:
    stream = BytesIO()
    npy.write_array(stream, array, version=(1, 0), allow_pickle=False)
    return stream.getvalue()


def _array(data: bytes) -> np.ndarray[Any, Any]:
    begins = len(MAGIC) + 2 + int.from_bytes(data[len(MAGIC) : len(MAGIC) + 2], "little")
    header = _HEADER.fullmatch(data[len(MAGIC) + 2 : begins])
    if not data.startswith(MAGIC) or header is None:
        raise ValueError("an array of another format")
    dtype, shape = np.dtype(header[1].decode()), tuple(int(size) for size in header[3].split(b",") if size.strip())
    if prod(shape) * dtype.itemsize != len(data) - begins:
        raise ValueError("an array of another size than its header says")
    # A copy: the bytes are read-only, for which kernels would be compiled once more.
    flat = np.frombuffer(data, dtype, offset=begins).copy()
    return flat.reshape(shape, order="F" if header[2] == b"True" else "C")

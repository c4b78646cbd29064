"""X25519 of RFC 7748 and the map Elligator 2 of RFC 9380 onto its curve, on Python's integers.

Python's integers are not constant in time. Each scalar here serves one conversation, and a pairing code one window.
"""

from __future__ import annotations

from typing import Final

KEY_BYTES: Final = 32
_P: Final = 2**255 - 19
_A: Final = 486662
_A24: Final = (_A - 2) // 4
_SCALAR_BITS: Final = 255


def x25519(scalar: bytes, u: bytes) -> bytes:
    """The product of a clamped scalar and the point with coordinate u; zeros when u is of low order.

    scalar, u : 32 bytes each, little endian; the highest bit of u is ignored (RFC 7748, section 5)
    """
    k = (int.from_bytes(scalar, "little") & ((1 << 254) - 8)) | (1 << 254)
    x1 = field_element(u)
    x2, z2, x3, z3 = 1, 0, x1, 1
    swap = 0
    for bit in range(_SCALAR_BITS - 1, -1, -1):
        one = (k >> bit) & 1
        if swap ^ one:
            x2, z2, x3, z3 = x3, z3, x2, z2
        swap = one
        plus, minus = x2 + z2, x2 - z2
        plus_squared, minus_squared = plus * plus % _P, minus * minus % _P
        cross, other = (x3 - z3) * plus % _P, (x3 + z3) * minus % _P
        difference = plus_squared - minus_squared
        x3, z3 = (cross + other) ** 2 % _P, x1 * (cross - other) ** 2 % _P
        x2, z2 = plus_squared * minus_squared % _P, difference * (plus_squared + _A24 * difference) % _P
    if swap:
        x2, z2 = x3, z3
    return (x2 * pow(z2, _P - 2, _P) % _P).to_bytes(KEY_BYTES, "little")


def point_of(wide: bytes) -> bytes:
    """The coordinate u of the curve's point that Elligator 2 maps 32 bytes to."""
    r = field_element(wide)
    v = -_A * pow(1 + 2 * r * r, _P - 2, _P) % _P
    is_square = pow((v * v + _A * v + 1) * v, (_P - 1) // 2, _P) in (0, 1)
    return (v if is_square else (-v - _A) % _P).to_bytes(KEY_BYTES, "little")


def field_element(encoded: bytes) -> int:
    """32 bytes, little endian, as an element of the field; the highest bit is ignored."""
    return (int.from_bytes(encoded, "little") & ((1 << _SCALAR_BITS) - 1)) % _P

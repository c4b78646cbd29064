"""CPace with X25519 and SHA-512, initiator and responder, with key confirmation, as draft-irtf-cfrg-cpace has it.

From one password both sides get the same key; a listener learns nothing about the password, and an attacker in between
has one guess for each conversation. Names follow the draft: PRS (password), CI (channel), sid (session), AD (associated
data).
"""

from __future__ import annotations

import hashlib
import hmac
from dataclasses import dataclass
from typing import Final

from device.pairing.x25519 import KEY_BYTES, point_of, x25519

DSI: Final = b"CPace255"
_SHA512_BLOCK_BYTES: Final = 128
_LEB128_BITS: Final = 7


class WeakShare(ValueError):
    """A share of low order, which no honest side sends: the key would be known to everybody."""


@dataclass(frozen=True, slots=True)
class Message:
    """Message of one side: its share (32 bytes) and its associated data, both authenticated by the tags."""

    share: bytes
    associated_data: bytes

    def encoded(self) -> bytes:
        """Both with their lengths."""
        return lv_cat(self.share, self.associated_data)


def lv_cat(*parts: bytes) -> bytes:
    """The parts, each behind its length in LEB128."""
    return b"".join(_leb128(len(part)) + part for part in parts)


def generator(password: bytes, channel: bytes, session: bytes = b"") -> bytes:
    """The generator (32 bytes) that stands for a password."""
    filled = len(lv_cat(password)) + len(lv_cat(DSI)) + 1
    padding = bytes(max(0, _SHA512_BLOCK_BYTES - filled))
    text = lv_cat(DSI, password, padding, channel, session)
    return point_of(hashlib.sha512(text).digest()[:KEY_BYTES])


def session_key(
    secret: bytes, other_share: bytes, initiator: Message, responder: Message, session: bytes = b""
) -> bytes:
    """The key (64 bytes) that both sides get when they agree on the password and on both messages.

    Raises
    ------
    WeakShare
        The other's share is of low order.
    """
    shared = x25519(secret, other_share)
    if not any(shared):
        raise WeakShare("the share is of low order")
    return hashlib.sha512(lv_cat(DSI + b"_ISK", session, shared) + initiator.encoded() + responder.encoded()).digest()


def tag(key: bytes, sent: Message, session: bytes = b"") -> bytes:
    """Return the proof for the other side that the sender of a message has the key: HMAC-SHA-512 over the message."""
    mac_key = hashlib.sha512(b"CPaceMac" + session + key).digest()
    return hmac.new(mac_key, sent.encoded(), hashlib.sha512).digest()


def _leb128(number: int) -> bytes:
    out = bytearray()
    while number >= 1 << _LEB128_BITS:
        out.append(number & 0x7F | 0x80)
        number >>= _LEB128_BITS
    out.append(number)
    return bytes(out)

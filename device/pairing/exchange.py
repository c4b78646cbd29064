"""Pairing: both sides prove a one-time code to each other by CPace, and so authenticate each other's card.

Each side sends its share and its card, then its confirmation. Both cards are part of what the key is derived from.
"""

from __future__ import annotations

import hmac
import secrets
from typing import Annotated, Final, TypeVar

import msgspec

from device.bundles.record import BundleId, Record
from device.errors import RecordError
from device.pairing.cpace import Message, WeakShare, generator, session_key, tag
from device.pairing.x25519 import KEY_BYTES, x25519

CODE_DIGITS: Final = 8
PAIRING_PORT: Final = 8022
MAX_MESSAGE_BYTES: Final = 8192
CHANNEL: Final = b"retrograph pairing 2"

ShareHex = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{64}(?!\n)$")]
TagHex = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{128}(?!\n)$")]
SshPublicKey = Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9@.-]{4,60} [A-Za-z0-9+/]{32,1200}={0,2}(?!\n)$")]
"""Kind and key as OpenSSH writes them, no options and no comment."""


class HostCard(Record, frozen=True, tag_field="schema", tag="retrograph.pair-host/2"):
    """A workstation's card: its name and its public key."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9._-]{1,64}(?!\n)$")]
    public_key: SshPublicKey


class DeviceCard(Record, frozen=True, tag_field="schema", tag="retrograph.pair-device/2"):
    """A device's card: its id, user and port for its files, and its host key."""

    device_id: BundleId
    user: Annotated[str, msgspec.Meta(pattern=r"^[a-z_][a-z0-9_-]{0,31}(?!\n)$")]
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)]
    host_key: SshPublicKey


class Share(Record, frozen=True, tag_field="schema", tag="retrograph.pair-share/2"):
    """The first message of each side: its share, in hex, and its card."""

    share: ShareHex
    card: HostCard | DeviceCard


class Confirmation(Record, frozen=True, tag_field="schema", tag="retrograph.pair-confirmation/2"):
    """Proof that its sender has the key, so the code: first the workstation's, then the device's."""

    tag: TagHex


CardT = TypeVar("CardT", HostCard, DeviceCard)


def draw_code() -> str:
    """A new one-time code: digits that a person reads from a screen and types."""
    return f"{secrets.randbelow(10**CODE_DIGITS):0{CODE_DIGITS}d}"


class Exchange:
    """One side of one conversation: the workstation's, which begins, or the device's.

    Parameters
    ----------
    code : the one-time code; blanks are ignored
    card : this side's; its kind says which side this is
    """

    def __init__(self, code: str, card: HostCard | DeviceCard) -> None:
        self._secret = secrets.token_bytes(KEY_BYTES)
        share = x25519(self._secret, generator("".join(code.split()).encode(), CHANNEL))
        self._card = card
        self._own = Message(share, msgspec.json.encode(card))
        self._other = Message(b"", b"")
        self._key = b""

    @property
    def share(self) -> Share:
        """The first message to the other side."""
        return Share(share=self._own.share.hex(), card=self._card)

    def meet(self, other: Share, kind: type[CardT]) -> CardT:
        """Derive the shared key from the other side's share; returns its card, which is not confirmed yet.

        Raises
        ------
        RecordError
            No honest other side sends this share or this card.
        """
        if not isinstance(other.card, kind) or isinstance(self._card, kind):
            raise RecordError("pairing: the other side sent the wrong side's card: start again")
        self._other = Message(bytes.fromhex(other.share), msgspec.json.encode(other.card))
        begun = isinstance(self._card, HostCard)
        initiator, responder = (self._own, self._other) if begun else (self._other, self._own)
        try:
            self._key = session_key(self._secret, self._other.share, initiator, responder)
        except WeakShare as error:
            raise RecordError("pairing: the other side sent an invalid share: start again") from error
        return other.card

    @property
    def confirmation(self) -> Confirmation:
        """This side's proof that it knows the code."""
        return Confirmation(tag=tag(self._key, self._own).hex())

    def is_confirmed(self, theirs: Confirmation) -> bool:
        """Return whether the other side knows the code, and both have seen the same shares and cards."""
        return bool(self._key) and hmac.compare_digest(tag(self._key, self._other).hex(), theirs.tag)

"""Pairing: a password-authenticated key exchange (CPace's construction) from a one-time code.

Over the 2048-bit group of RFC 3526, both sides derive a generator from the code, exchange one element each, and get the
same key only if they have the same code. Each then authenticates its public key with that key. A listener learns
nothing about the code, and an impostor on either side has one guess per connection.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from typing import Annotated, Final, Literal

import msgspec

from device.bundles.record import BundleId, Record
from device.errors import RecordError

CODE_DIGITS: Final = 8
PAIRING_PORT: Final = 8022
MAX_MESSAGE_BYTES: Final = 8192
PRIME: Final = int(
    "FFFFFFFFFFFFFFFFC90FDAA22168C234C4C6628B80DC1CD129024E088A67CC74020BBEA63B139B22514A08798E3404DD"
    "EF9519B3CD3A431B302B0A6DF25F14374FE1356D6D51C245E485B576625E7EC6F44C42E9A637ED6B0BFF5CB6F406B7ED"
    "EE386BFB5A899FA5AE9F24117C4B1FE649286651ECE45B3DC2007CB8A163BF0598DA48361C55D39A69163FA8FD24CF5F"
    "83655D23DCA3AD961C62F356208552BB9ED529077096966D670C354E4ABC9804F1746C08CA18217C32905E462E36CE3B"
    "E39E772C180E86039B2783A2EC07A28FB5C55DF06F4C52C9DE2BCBF6955817183995497CEA956AE515D2261898FA0510"
    "15728E5A8AACAA68FFFFFFFFFFFFFFFF",
    16,
)
"""A safe prime: (PRIME - 1) / 2 is prime, too."""

_ELEMENT_BYTES: Final = 256
_EXPONENT_BITS: Final = 512

Role = Literal["host", "device"]
Hex = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{1,512}(?!\n)$")]
SshPublicKey = Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9@.-]{4,60} [A-Za-z0-9+/]{32,1200}={0,2}(?!\n)$")]
"""Kind and key as OpenSSH writes them, no options and no comment."""


class Element(Record, frozen=True, tag_field="schema", tag="retrograph.pair-element/1"):
    """One side's group element, in hex."""

    element: Hex


class HostCard(Record, frozen=True, tag_field="schema", tag="retrograph.pair-host/1"):
    """A workstation's card: its name, its public key and the proof that it knows the code."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9._-]{1,64}(?!\n)$")]
    public_key: SshPublicKey
    proof: Hex = "0"


class DeviceCard(Record, frozen=True, tag_field="schema", tag="retrograph.pair-device/1"):
    """A device's card: its id, user and port for its files, its host key and the same proof."""

    device_id: BundleId
    user: Annotated[str, msgspec.Meta(pattern=r"^[a-z_][a-z0-9_-]{0,31}(?!\n)$")]
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)]
    host_key: SshPublicKey
    proof: Hex = "0"


Card = HostCard | DeviceCard


def draw_code() -> str:
    """A new one-time code: digits that a person reads from a screen and types."""
    return f"{secrets.randbelow(10**CODE_DIGITS):0{CODE_DIGITS}d}"


class Exchange:
    """One side of one exchange; a wrong code is detected when the other's card is not proven.

    Parameters
    ----------
    code : the one-time code; blanks are ignored
    role : which side this is
    """

    def __init__(self, code: str, role: Role) -> None:
        self._role = role
        self._secret = secrets.randbits(_EXPONENT_BITS) | 1
        self._own = pow(_generator(code), self._secret, PRIME)
        self._key = b""

    @property
    def element(self) -> Element:
        """The first message to the other side."""
        return Element(element=f"{self._own:x}")

    def meet(self, other: Element) -> None:
        """Derive the shared key from the other side's element.

        Raises
        ------
        RecordError
            No honest side sends this element.
        """
        theirs = int(other.element, 16)
        if not 1 < theirs < PRIME - 1:
            raise RecordError("pairing: the other side sent an invalid group element: start again")
        shared = pow(theirs * theirs, self._secret, PRIME)
        pair = (self._own, theirs) if self._role == "host" else (theirs, self._own)
        transcript = b"".join(number.to_bytes(_ELEMENT_BYTES, "big") for number in (*pair, shared))
        self._key = hashlib.sha256(b"retrograph pairing 1" + transcript).digest()

    def proven(self, card: Card) -> Card:
        """The card with this side's proof."""
        return msgspec.structs.replace(card, proof=self._proof(card))

    def is_proven(self, card: Card) -> bool:
        """Whether the card's sender knows the code."""
        return hmac.compare_digest(self._proof(card), card.proof)

    def _proof(self, card: Card) -> str:
        plain = msgspec.json.encode(msgspec.structs.replace(card, proof="0"))
        return hmac.new(self._key, plain, hashlib.sha256).hexdigest()


def _generator(code: str) -> int:
    """A group element with unknown discrete logarithm, derived from the code."""
    seed = b"retrograph pairing 1 " + "".join(code.split()).encode()
    wide = b"".join(hashlib.sha512(bytes([i]) + seed).digest() for i in range(6))
    return pow(int.from_bytes(wide, "big"), 2, PRIME)

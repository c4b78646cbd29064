"""How a device and a workstation that share a one-time code come to know each other's keys, whoever listens.

A balanced password-authenticated key exchange (CPace's construction over the 2048-bit group of RFC 3526): both draw a
generator from the code, exchange one element each, and get the same key only if they have the same code. Each then
proves its public key with that key. An eavesdropper learns nothing about the code, and one who plays either side has
one guess a connection.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from typing import Annotated, Final, Literal

import msgspec

from device.errors import RecordError
from device.records import BundleId, Record

CODE_DIGITS: Final = 8
PAIRING_PORT: Final = 8022
MOST_MESSAGE_BYTES: Final = 8192
PRIME: Final = int(
    "FFFFFFFFFFFFFFFFC90FDAA22168C234C4C6628B80DC1CD129024E088A67CC74020BBEA63B139B22514A08798E3404DD"
    "EF9519B3CD3A431B302B0A6DF25F14374FE1356D6D51C245E485B576625E7EC6F44C42E9A637ED6B0BFF5CB6F406B7ED"
    "EE386BFB5A899FA5AE9F24117C4B1FE649286651ECE45B3DC2007CB8A163BF0598DA48361C55D39A69163FA8FD24CF5F"
    "83655D23DCA3AD961C62F356208552BB9ED529077096966D670C354E4ABC9804F1746C08CA18217C32905E462E36CE3B"
    "E39E772C180E86039B2783A2EC07A28FB5C55DF06F4C52C9DE2BCBF6955817183995497CEA956AE515D2261898FA0510"
    "15728E5A8AACAA68FFFFFFFFFFFFFFFF",
    16,
)
"""A safe prime: half of it, rounded down, is prime too."""

_ELEMENT_BYTES: Final = 256
_EXPONENT_BITS: Final = 512

Role = Literal["host", "device"]
Hex = Annotated[str, msgspec.Meta(pattern=r"^[0-9a-f]{1,512}(?!\n)$")]
SshPublicKey = Annotated[str, msgspec.Meta(pattern=r"^[a-z0-9@.-]{4,60} [A-Za-z0-9+/]{32,1200}={0,2}(?!\n)$")]
"""Kind and key as OpenSSH writes them, no options and no comment."""


class Element(Record, frozen=True, tag_field="schema", tag="retrograph.pair-element/1"):
    """One side's element of the group, in hex."""

    element: Hex


class HostCard(Record, frozen=True, tag_field="schema", tag="retrograph.pair-host/1"):
    """What a workstation shows: its name, its public key and the proof that it knows the code."""

    name: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9._-]{1,64}(?!\n)$")]
    public_key: SshPublicKey
    proof: Hex = "0"


class DeviceCard(Record, frozen=True, tag_field="schema", tag="retrograph.pair-device/1"):
    """What a device shows: who it is, how its files are reached, its host key and the same proof."""

    device_id: BundleId
    user: Annotated[str, msgspec.Meta(pattern=r"^[a-z_][a-z0-9_-]{0,31}(?!\n)$")]
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)]
    host_key: SshPublicKey
    proof: Hex = "0"


Card = HostCard | DeviceCard


def draw_code() -> str:
    """A fresh one-time code: digits, to be read from a screen and typed."""
    return f"{secrets.randbelow(10**CODE_DIGITS):0{CODE_DIGITS}d}"


class Exchange:
    """One side of one exchange; a wrong code shows when the other's proof does not fit.

    Parameters
    ----------
    code : as both people see it; blanks do not count
    role : which side this is
    """

    def __init__(self, code: str, role: Role) -> None:
        self._role = role
        self._secret = secrets.randbits(_EXPONENT_BITS) | 1
        self._own = pow(_generator(code), self._secret, PRIME)
        self._key = b""

    @property
    def element(self) -> Element:
        """What is sent to the other side first."""
        return Element(element=f"{self._own:x}")

    def meet(self, other: Element) -> None:
        """Take the other side's element.

        Raises
        ------
        RecordError
            It is none that an honest side sends.
        """
        theirs = int(other.element, 16)
        if not 1 < theirs < PRIME - 1:
            raise RecordError("pairing: the other side sent no element of the group: begin again")
        shared = pow(theirs * theirs, self._secret, PRIME)
        pair = (self._own, theirs) if self._role == "host" else (theirs, self._own)
        transcript = b"".join(number.to_bytes(_ELEMENT_BYTES, "big") for number in (*pair, shared))
        self._key = hashlib.sha256(b"retrograph pairing 1" + transcript).digest()

    def proven(self, card: Card) -> Card:
        """The same card with this side's proof."""
        return msgspec.structs.replace(card, proof=self._proof(card))

    def is_proven(self, card: Card) -> bool:
        """Whether the card comes from somebody who knows the code."""
        return hmac.compare_digest(self._proof(card), card.proof)

    def _proof(self, card: Card) -> str:
        plain = msgspec.json.encode(msgspec.structs.replace(card, proof="0"))
        return hmac.new(self._key, plain, hashlib.sha256).hexdigest()


def _generator(code: str) -> int:
    """An element whose logarithm nobody knows, drawn from the code."""
    seed = b"retrograph pairing 1 " + "".join(code.split()).encode()
    wide = b"".join(hashlib.sha512(bytes([i]) + seed).digest() for i in range(6))
    return pow(int.from_bytes(wide, "big"), 2, PRIME)

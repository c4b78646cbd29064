"""CPace against the published vectors of draft-irtf-cfrg-cpace (appendix B.1), X25519 against those of RFC 7748."""

from __future__ import annotations

import pytest
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey

from device.pairing.cpace import DSI, Message, WeakShare, generator, lv_cat, session_key
from device.pairing.x25519 import KEY_BYTES, x25519

PASSWORD, CHANNEL = b"Password", b"\x0bA_initiator\x0bB_responder"
SESSION = bytes.fromhex("7e4b4791d6a8ef019b936c79fb7f2c57")
G = bytes.fromhex("d04bf6d41f6a289632a2e929fa29bebd51092512a7829fdde7d314b62f05a73f")
Y_A = bytes.fromhex("21b4f4bd9e64ed355c3eb676a28ebedaf6d8f17bdc365995b319097153044080")
SHARE_A = bytes.fromhex("1d13c89278cdadd826f6d8d7f887701430f8380ddc17611cdd6dc989ce0c9f32")
Y_B = bytes.fromhex("848b0779ff415f0af4ea14df9dd1d3c29ac41d836c7808896c4eba19c51ac40a")
SHARE_B = bytes.fromhex("248cccf6d5cdc3646f0ad593f9e6cef4e69d4945f8372e623512ecea32185623")
K = bytes.fromhex("5b067effbdc0b2a0e1d907b21ebb25cfedb96a852179a847c37e43ee71322c6b")
ISK = bytes.fromhex(
    "6e19b875f7a561d6b3ca3dbb9ef42ac55de3e717881018204b8922b4d5e53bb2"
    "aa82c300bea7b65d2b671da71922ddf6472301b79bc270adfa8bf413285f2263"
)
LOW_ORDER_SCALAR = bytes.fromhex("af46e36bf0527c9d3b16154b82465edd62144c0ac1fc5a18506a2244ba449aff")
NEUTRAL = "0" * 64
LOW_ORDER = (
    "0000000000000000000000000000000000000000000000000000000000000000",
    "0100000000000000000000000000000000000000000000000000000000000000",
    "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "e0eb7a7c3b41b8ae1656e3faf19fc46ada098deb9c32b1fd866205165f49b800",
    "5f9c95bca3508c24b1d0b1559c83ef5b04445cc4581c8e86d8224eddd09f1157",
    "edffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "daffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
    "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "dbffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
    "d9ffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
    "cdeb7a7c3b41b8ae1656e3faf19fc46ada098deb9c32b1fd866205165f49b880",
    "4c9c95bca3508c24b1d0b1559c83ef5b04445cc4581c8e86d8224eddd09f11d7",
)
PRODUCTS = (
    NEUTRAL,
    NEUTRAL,
    NEUTRAL,
    NEUTRAL,
    NEUTRAL,
    NEUTRAL,
    "d8e2c776bbacd510d09fd9278b7edcd25fc5ae9adfba3b6e040e8d3b71b21806",
    NEUTRAL,
    "c85c655ebe8be44ba9c0ffde69f2fe10194458d137f09bbff725ce58803cdb38",
    "db64dafa9b8fdd136914e61461935fe92aa372cb056314e1231bc4ec12417456",
    "e062dcd5376d58297be2618c7498f55baa07d7e03184e8aada20bca28888bf7a",
    "993c6ad11c4c29da9a56f7691fd0ff8d732e49de6250b6c2e80003ff4629a175",
)


def test_lengths_are_encoded_as_published() -> None:
    assert lv_cat(b"1234", b"5", b"", b"678").hex() == "043132333401350003363738"
    assert lv_cat(bytes(range(127)))[:1].hex() == "7f"
    assert lv_cat(bytes(range(128)))[:2].hex() == "8001"


def test_the_generator_is_the_published_one() -> None:
    assert DSI == b"CPace255"
    assert generator(PASSWORD, CHANNEL, SESSION) == G


def test_shares_secret_point_and_key_are_the_published_ones() -> None:
    a, b = Message(x25519(Y_A, G), b"ADa"), Message(x25519(Y_B, G), b"ADb")
    assert (a.share, b.share) == (SHARE_A, SHARE_B)
    assert x25519(Y_A, SHARE_B) == x25519(Y_B, SHARE_A) == K
    assert session_key(Y_A, SHARE_B, a, b, SESSION) == session_key(Y_B, SHARE_A, a, b, SESSION) == ISK


@pytest.mark.parametrize(("encoded", "product"), list(zip(LOW_ORDER, PRODUCTS, strict=True)))
def test_points_of_low_order_give_what_was_published_and_no_key(encoded: str, product: str) -> None:
    point = bytes.fromhex(encoded)
    assert x25519(LOW_ORDER_SCALAR, point).hex() == product
    message = Message(point, b"")
    if product == NEUTRAL:
        with pytest.raises(WeakShare):
            session_key(LOW_ORDER_SCALAR, point, message, message)


def test_products_are_those_of_rfc_7748() -> None:
    scalar = bytes.fromhex("a546e36bf0527c9d3b16154b82465edd62144c0ac1fc5a18506a2244ba449ac4")
    point = bytes.fromhex("e6db6867583030db3594c1a424b15f7c726624ec26b3353b10a903a6d0ab1c4c")
    assert x25519(scalar, point).hex() == "c3da55379de9c6908e94ea4df28d084f32eccf03491c71f754b4075577a28552"
    k = u = (9).to_bytes(KEY_BYTES, "little")
    for _ in range(1000):
        k, u = x25519(k, u), k
    assert k.hex() == "684cf59ba83309552800ef566f2f4d3c1c3887c49360e3875f2eb94d99532c51"


def test_products_are_those_of_openssl() -> None:
    for seed in range(50):
        ours, theirs = ((seed * 7919 + which).to_bytes(4, "little") * 8 for which in (1, 2))
        public = X25519PrivateKey.from_private_bytes(theirs).public_key().public_bytes_raw()
        shared = X25519PrivateKey.from_private_bytes(ours).exchange(X25519PublicKey.from_public_bytes(public))
        assert x25519(ours, public) == shared


def test_every_code_gives_another_generator_and_lies_in_the_large_group() -> None:
    """A share tells nothing of its code only if each generator reaches the same points."""
    order = 2**252 + 27742317777372353535851937790883648493
    seen = set()
    for code in range(200):
        g = generator(f"{code:08d}".encode(), b"test")
        eightfold = _product(8, g)
        assert any(eightfold)
        assert not any(_product(order, eightfold))
        seen.add(g)
    assert len(seen) == 200


def _product(number: int, u: bytes) -> bytes:
    """The multiple of a point without clamping, zeros for the neutral element: the textbook's doubling and adding."""
    p, a = 2**255 - 19, 486662
    x = int.from_bytes(u, "little") % p
    low, high = (1, 0), (x, 1)  # n and n + 1 times the point
    for bit in bin(number)[2:]:
        (s, t), (v, w) = low, high
        total = (((s * v - t * w) ** 2) % p, x * (s * w - t * v) ** 2 % p)
        one = high if bit == "1" else low
        c, d = one
        double = ((c * c - d * d) ** 2 % p, 4 * c * d * (c * c + a * c * d + d * d) % p)
        low, high = (total, double) if bit == "1" else (double, total)
    return (low[0] * pow(low[1], p - 2, p) % p).to_bytes(32, "little")

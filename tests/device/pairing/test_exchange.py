"""Pairing's key exchange: the same code gives the same key, any other and any meddling does not."""

from __future__ import annotations

import msgspec
import pytest

from device.bundles.record import decode_record
from device.errors import RecordError
from device.pairing.exchange import PRIME, DeviceCard, Element, Exchange, HostCard, draw_code

KEY = "ssh-ed25519 " + "A" * 68
HOST = HostCard(name="bench", public_key=KEY)
DEVICE = DeviceCard(device_id="rg1", user="retrosync", port=22, host_key=KEY)


def met(code: str, other_code: str) -> tuple[Exchange, Exchange]:
    host, device = Exchange(code, "host"), Exchange(other_code, "device")
    host.meet(device.element)
    device.meet(host.element)
    return host, device


def test_the_group_is_what_it_is_said_to_be() -> None:
    assert PRIME.bit_length() == 2048
    assert pow(2, PRIME - 1, PRIME) == 1
    assert pow(3, (PRIME - 1) // 2 - 1, (PRIME - 1) // 2) == 1


def test_both_sides_prove_themselves_with_the_same_code_only() -> None:
    host, device = met("1234 5678", "12345678")
    assert device.is_proven(host.proven(HOST))
    assert host.is_proven(device.proven(DEVICE))
    host, device = met("12345678", "12345679")
    assert not device.is_proven(host.proven(HOST))
    assert not host.is_proven(device.proven(DEVICE))


def test_no_byte_of_a_card_can_be_changed_and_no_proof_reused() -> None:
    host, device = met("1", "1")
    card = host.proven(HOST)
    assert not device.is_proven(msgspec.structs.replace(card, public_key=KEY[:-1] + "B"))
    assert not device.is_proven(msgspec.structs.replace(card, name="other"))
    assert not met("1", "1")[1].is_proven(card)


@pytest.mark.parametrize("element", ["0", "1", f"{PRIME - 1:x}", f"{PRIME:x}"])
def test_elements_that_would_give_the_key_away_are_refused(element: str) -> None:
    with pytest.raises(RecordError, match="an invalid group element"):
        Exchange("1", "device").meet(Element(element=element))


def test_codes_are_digits_and_differ() -> None:
    codes = {draw_code() for _ in range(50)}
    assert len(codes) > 45
    assert all(len(code) == 8 and code.isdecimal() for code in codes)


@pytest.mark.parametrize("key", ['command="sh" ' + KEY, KEY + "\nssh-ed25519 evil", KEY + " comment", "ssh-ed25519"])
def test_a_key_is_a_key_and_nothing_more(key: str) -> None:
    data = msgspec.json.encode(msgspec.structs.replace(HOST, public_key=key))
    with pytest.raises(RecordError, match="public_key"):
        decode_record(data, HostCard, "pairing")

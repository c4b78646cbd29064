"""Pairing's exchange: both sides hash the same cards and numbers to one code, and any change gives another."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from device.bundles.record import decode_record
from device.errors import RecordError
from device.pairing import Call, DeviceCard, HostCard, Opening, code_of, commitment_to, draw_number, opens

KEY = "ssh-ed25519 " + "A" * 68
HOST = HostCard(name="bench", public_key=KEY)
DEVICE = DeviceCard(device_id="rg1", user="retrosync", port=22, host_key=KEY)
ONE, TWO = "1" * 64, "2" * 64


def test_the_code_is_made_from_every_part_of_both_cards_and_both_numbers() -> None:
    other_key = KEY[:-1] + "B"
    codes = {
        code_of(HOST, DEVICE, ONE, TWO),
        code_of(msgspec.structs.replace(HOST, public_key=other_key), DEVICE, ONE, TWO),
        code_of(msgspec.structs.replace(HOST, name="other"), DEVICE, ONE, TWO),
        code_of(HOST, msgspec.structs.replace(DEVICE, host_key=other_key), ONE, TWO),
        code_of(HOST, msgspec.structs.replace(DEVICE, device_id="rg2"), ONE, TWO),
        code_of(HOST, msgspec.structs.replace(DEVICE, user="other"), ONE, TWO),
        code_of(HOST, msgspec.structs.replace(DEVICE, port=2222), ONE, TWO),
        code_of(HOST, DEVICE, TWO, ONE),
        code_of(HOST, DEVICE, ONE, ONE),
    }
    assert len(codes) == 9
    assert code_of(HOST, DEVICE, ONE, TWO) in codes


def test_a_commitment_opens_to_its_own_card_and_number_only() -> None:
    call = Call(card=HOST, commitment=commitment_to(HOST, ONE))
    assert opens(call, Opening(number=ONE))
    assert not opens(call, Opening(number=TWO))
    for changed in ({"public_key": KEY[:-1] + "B"}, {"name": "other"}):
        assert not opens(Call(card=msgspec.structs.replace(HOST, **changed), commitment=call.commitment), Opening(ONE))


def test_codes_are_six_digits_in_two_halves_and_spread_evenly() -> None:
    codes = [code_of(HOST, DEVICE, draw_number(), draw_number()) for _ in range(2000)]
    assert all(len(code) == 7 and code[3] == " " and code.replace(" ", "").isdecimal() for code in codes)
    assert len(set(codes)) > 1980
    first = [sum(code[0] == digit for code in codes) for digit in "0123456789"]
    assert min(first) > 130
    assert max(first) < 270


@pytest.mark.parametrize("key", ['command="sh" ' + KEY, KEY + "\nssh-ed25519 evil", KEY + " comment", "ssh-ed25519"])
def test_a_key_is_a_key_and_nothing_more(key: str) -> None:
    data = msgspec.json.encode(msgspec.structs.replace(HOST, public_key=key))
    with pytest.raises(RecordError, match="public_key"):
        decode_record(data, HostCard, "pairing")


def test_no_code_of_the_product_computes_on_curves_or_primes() -> None:
    """SSH's libraries hold all the cryptography; here only hashes are compared."""
    for path in Path("device").rglob("*.py"):
        assert "2**255" not in path.read_text(encoding="utf-8"), path

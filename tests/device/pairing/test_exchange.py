"""Pairing's exchange: the same code confirms both sides, any other code and any meddling does not."""

from __future__ import annotations

import msgspec
import pytest

from device.bundles.record import decode_record
from device.errors import RecordError
from device.pairing.exchange import Confirmation, DeviceCard, Exchange, HostCard, Share, draw_code

KEY = "ssh-ed25519 " + "A" * 68
HOST = HostCard(name="bench", public_key=KEY)
DEVICE = DeviceCard(device_id="rg1", user="retrosync", port=22, host_key=KEY)


def met(code: str, other_code: str) -> tuple[Exchange, Exchange]:
    host, device = Exchange(code, HOST), Exchange(other_code, DEVICE)
    assert host.meet(device.share, DeviceCard) == DEVICE
    assert device.meet(host.share, HostCard) == HOST
    return host, device


def test_both_sides_confirm_each_other_with_the_same_code_only() -> None:
    host, device = met("1234 5678", "12345678")
    assert device.is_confirmed(host.confirmation)
    assert host.is_confirmed(device.confirmation)
    host, device = met("12345678", "12345679")
    assert not device.is_confirmed(host.confirmation)
    assert not host.is_confirmed(device.confirmation)


def test_no_part_of_a_message_can_be_changed() -> None:
    other = Exchange("1", HOST).share
    for changed in (
        {"card": msgspec.structs.replace(HOST, public_key=KEY[:-1] + "B")},
        {"card": msgspec.structs.replace(HOST, name="other")},
        {"share": other.share},
    ):
        host, device = Exchange("1", HOST), Exchange("1", DEVICE)
        device.meet(msgspec.structs.replace(host.share, **changed), HostCard)
        host.meet(device.share, DeviceCard)
        assert not device.is_confirmed(host.confirmation)
        assert not host.is_confirmed(device.confirmation)


def test_a_confirmation_serves_once_and_not_for_its_sender() -> None:
    host, device = met("1", "1")
    said = host.confirmation
    assert not host.is_confirmed(said)
    assert not met("1", "1")[1].is_confirmed(said)
    for bit in range(0, 512, 37):
        flipped = (int(said.tag, 16) ^ (1 << bit)).to_bytes(64, "big").hex()
        assert not device.is_confirmed(Confirmation(tag=flipped))


def test_before_the_other_has_spoken_nothing_is_confirmed() -> None:
    device = Exchange("1", DEVICE)
    assert not device.is_confirmed(Exchange("1", DEVICE).confirmation)


@pytest.mark.parametrize("share", ["00" * 32, "01" + "00" * 31, "ec" + "ff" * 30 + "7f", "ed" + "ff" * 30 + "7f"])
def test_shares_that_would_give_the_key_away_are_refused(share: str) -> None:
    with pytest.raises(RecordError, match="an invalid share"):
        Exchange("1", DEVICE).meet(Share(share=share, card=HOST), HostCard)


def test_a_side_does_not_meet_its_own_kind() -> None:
    device = Exchange("1", DEVICE)
    with pytest.raises(RecordError, match="wrong side's card"):
        device.meet(device.share, HostCard)
    with pytest.raises(RecordError, match="wrong side's card"):
        device.meet(Exchange("1", DEVICE).share, DeviceCard)


def test_codes_are_digits_and_differ() -> None:
    codes = {draw_code() for _ in range(50)}
    assert len(codes) > 45
    assert all(len(code) == 8 and code.isdecimal() for code in codes)


@pytest.mark.parametrize("key", ['command="sh" ' + KEY, KEY + "\nssh-ed25519 evil", KEY + " comment", "ssh-ed25519"])
def test_a_key_is_a_key_and_nothing_more(key: str) -> None:
    data = msgspec.json.encode(msgspec.structs.replace(HOST, public_key=key))
    with pytest.raises(RecordError, match="public_key"):
        decode_record(data, HostCard, "pairing")

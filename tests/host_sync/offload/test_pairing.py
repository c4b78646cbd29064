"""Device and workstation meet over loopback, or over a memory card; then, and only then, the door opens."""

from __future__ import annotations

import dataclasses
import io
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Event
from typing import Any

import asyncssh
import msgspec
import pytest

from device.errors import PairingRefused, RecordError
from device.pairing import (
    Accepted,
    Answer,
    Call,
    DeviceCard,
    Opening,
    PairingChannel,
    commitment_to,
    draw_number,
    fingerprint_of,
    leave_device_card,
    take_host_cards,
)
from device.pairing_service import (
    READING_S,
    PairingSetup,
    PairingWindow,
    authorize,
    how_to_call,
    open_pairing_window,
    read_host_key,
)
from device.store.store import BundleStore
from hal.clock import VirtualClock
from host_sync.cli.main import main
from host_sync.errors import HostError, NoSource, PairingError, SourceError
from host_sync.offload import paired_devices
from host_sync.offload.paired_devices import Announcement, PairedDevice, PairedDevices
from host_sync.offload.source import Address


@pytest.fixture
def devices(tmp_path: Path) -> PairedDevices:
    return PairedDevices(tmp_path / "config" / "retrograph")


@pytest.fixture
def device_card() -> DeviceCard:
    key = asyncssh.generate_private_key("ssh-ed25519").export_public_key().decode().split()
    return DeviceCard(device_id="rg00c0ffee", user="retrosync", port=22, host_key=" ".join(key[:2]))


@contextmanager
def window(card: DeviceCard, keys: Path, clock: VirtualClock | None = None) -> Iterator[tuple[int, PairingWindow]]:
    """A device's open window and its port."""
    listening = socket.create_server(("127.0.0.1", 0))
    with PairingWindow(listening, card, lambda host: authorize(keys, host), clock or VirtualClock()) as opened:
        yield listening.getsockname()[1], opened


def until(found: Callable[[], Any]) -> Any:
    """Return what another thread brings about; a minute is enough for it."""
    for _ in range(12_000):
        if what := found():
            return what
        Event().wait(0.005)
    pytest.fail("the window's thread did nothing")


def compare(opened: PairingWindow) -> Callable[[str], bool]:
    """A person who confirms the code on the device and on the workstation when both show the same."""

    def same_code(code: str) -> bool:
        until(lambda: opened.shown or opened.outcome)
        if opened.shown is None or opened.shown.code != code:
            return False
        opened._clock.sleep(READING_S)
        return opened.confirm(code)

    return same_code


def agree(_code: str) -> bool:
    return True


def test_the_code_opens_the_door_both_ways(devices: PairedDevices, device_card: DeviceCard, tmp_path: Path) -> None:
    keys = tmp_path / "pairing" / "authorized_keys"
    own = paired_devices.own_card(devices, "my bench!")
    with window(device_card, keys) as (port, opened):
        assert (opened.outcome, opened.seconds_left) == (None, 120.0)
        device = paired_devices.pair_over_network("127.0.0.1", port, own, compare(opened))
        paired_devices.keep(devices, device, replace=False)
        assert opened.wait().public_key == own.public_key
    assert opened.outcome is not None
    assert (opened.outcome.sentence, opened.seconds_left) == ("paired with my-bench-", 0.0)
    assert keys.read_text() == f"restrict {own.public_key} my-bench-\n"
    assert devices.all() == [device]
    assert (device.device_id, device.host_key, device.host) == (
        device_card.device_id,
        device_card.host_key,
        "127.0.0.1",
    )
    with pytest.raises(SourceError, match="no device waits there"):
        paired_devices.pair_over_network("127.0.0.1", port, own, agree)


def opened_code(opened: PairingWindow) -> str:
    return until(lambda: opened.shown).code


def test_after_pairing_and_not_before_scans_can_be_fetched(
    server: Any, store: BundleStore, publish_scan: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    publish_scan(store)
    library = ["--library", str(tmp_path / "library")]
    keys = server.folder / "authorized_keys"
    keys.unlink()
    card = DeviceCard(device_id=store.device_id, user=server.device().user, port=server.port, host_key=server.host_key)
    assert main(["pull", store.device_id, *library]) == 2
    with window(card, keys) as (port, opened):
        monkeypatch.setattr("builtins.input", lambda _: "yes" if compare(opened)(opened_code(opened)) else "no")
        assert main(["pair", "127.0.0.1", "--port", str(port)]) == 0
    assert main(["pull", store.device_id, *library]) == 0
    keys.unlink()
    assert main(["pull", store.device_id, *library]) == 3


def test_pair_looks_for_the_device_before_it_asks(
    device_card: DeviceCard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))

    def asked(_: str) -> str:
        raise AssertionError("there is nothing to compare yet")

    monkeypatch.setattr("builtins.input", asked)
    announced: list[Announcement] = []
    monkeypatch.setattr(paired_devices, "discover", lambda _: announced)
    assert main(["pair"]) == 3
    assert "no device announces itself" in capsys.readouterr().err
    assert main(["pair", "127.0.0.1", "--port", "1"]) == 3
    assert "127.0.0.1:1: no device waits there for pairing" in capsys.readouterr().err
    announced += [Announcement(name, host, (), 22) for name, host in (("one", "127.0.0.1"), ("two", "two.local"))]
    assert main(["pair"]) == 2
    assert "name one of 127.0.0.1, two.local" in capsys.readouterr().err
    del announced[1:]
    with window(device_card, tmp_path / "keys") as (port, opened):
        monkeypatch.setattr("builtins.input", lambda _: "yes" if compare(opened)(opened_code(opened)) else "no")
        assert main(["pair", "--port", str(port)]) == 0
    assert "Found one at 127.0.0.1." in capsys.readouterr().out


def test_three_codes_that_nobody_confirms_close_the_window(
    devices: PairedDevices, device_card: DeviceCard, tmp_path: Path
) -> None:
    keys = tmp_path / "authorized_keys"
    own = paired_devices.own_card(devices, "bench")
    with window(device_card, keys) as (port, opened):
        with socket.create_connection(("127.0.0.1", port)) as nonsense:
            nonsense.sendall(b"GET / HTTP/1.1\r\n\r\n")
        for number in range(3):

            def differs(_code: str) -> bool:
                shown = opened_code(opened)
                wrong = "".join(str(9 - int(digit)) if digit.isdecimal() else digit for digit in shown)
                opened._clock.sleep(READING_S)
                assert not opened.confirm(wrong)
                return False

            with pytest.raises(PairingError, match="if the codes differ, something else answers"):
                paired_devices.pair_over_network("127.0.0.1", port, own, differs)
            until(lambda: opened.shown is None)
            assert (opened.outcome is None) == (number < 2)
        with pytest.raises(PairingRefused, match="3 codes were shown and not confirmed"):
            opened.wait()
    assert not keys.exists()
    assert devices.all() == []


def test_a_push_that_came_before_the_code_could_be_read_confirms_nothing(
    devices: PairedDevices, device_card: DeviceCard, tmp_path: Path
) -> None:
    own, confirmed = paired_devices.own_card(devices, "bench"), []
    with window(device_card, tmp_path / "keys") as (port, opened):

        def hasty(code: str) -> bool:
            opened_code(opened)
            confirmed.append(opened.confirm(code))
            opened._clock.sleep(READING_S)
            confirmed.append(opened.confirm(code))
            return True

        paired_devices.pair_over_network("127.0.0.1", port, own, hasty)
    assert confirmed == [False, True]


def test_what_is_confirmed_here_alone_is_paired_nowhere(
    devices: PairedDevices, device_card: DeviceCard, tmp_path: Path
) -> None:
    own = paired_devices.own_card(devices, "bench")
    with window(device_card, tmp_path / "keys") as (port, opened):

        def closes(_code: str) -> bool:
            opened.close()
            return True

        with pytest.raises(PairingError, match="was not confirmed on the device"):
            paired_devices.pair_over_network("127.0.0.1", port, own, closes)
    assert not (tmp_path / "keys").exists()


def test_callers_who_say_nothing_keep_nobody_out(
    devices: PairedDevices, device_card: DeviceCard, tmp_path: Path
) -> None:
    with window(device_card, tmp_path / "keys") as (port, opened), ExitStack() as stack:
        for _ in range(50):
            stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        device = paired_devices.pair_over_network(
            "127.0.0.1", port, paired_devices.own_card(devices, "bench"), compare(opened)
        )
    assert device.device_id == device_card.device_id


def test_one_code_is_shown_at_a_time(devices: PairedDevices, device_card: DeviceCard, tmp_path: Path) -> None:
    """All conversations reach the last step before the first is confirmed; the others are turned away."""
    own = paired_devices.own_card(devices, "bench")
    with window(device_card, tmp_path / "keys") as (port, opened), ExitStack() as stack:
        talks = []
        for _ in range(3):
            call = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
            channel, number = PairingChannel(call, 10.0), draw_number()
            channel.send(Call(card=own, commitment=commitment_to(own, number)))
            channel.receive(Answer)
            talks.append((channel, number))
        talks[0][0].send(Opening(number=talks[0][1]))
        code = opened_code(opened)
        for channel, number in talks[1:]:
            channel.send(Opening(number=number))
            with pytest.raises(RecordError):
                channel.receive(Accepted)
        assert opened_code(opened) == code
        opened._clock.sleep(READING_S)
        assert opened.confirm(code)
        talks[0][0].receive(Accepted)
        assert opened.wait() == own


def test_nobody_coming_closes_the_window(devices: PairedDevices, device_card: DeviceCard, tmp_path: Path) -> None:
    clock = VirtualClock()
    with window(device_card, tmp_path / "keys", clock) as (port, opened):
        clock.sleep(119.0)
        assert (opened.seconds_left, opened.outcome) == (1.0, None)
        clock.sleep(1.0)
        assert opened.outcome is not None
        assert (opened.seconds_left, opened.outcome.host) == (0.0, None)
        with pytest.raises(PairingRefused, match="no workstation came"):
            opened.wait()
        with pytest.raises(SourceError, match="no device waits there"):
            paired_devices.pair_over_network("127.0.0.1", port, paired_devices.own_card(devices, "bench"), agree)
    assert not (tmp_path / "keys").exists()


def test_a_window_that_is_closed_lets_nobody_in(
    devices: PairedDevices, device_card: DeviceCard, tmp_path: Path
) -> None:
    own = paired_devices.own_card(devices, "bench")
    with (
        window(device_card, tmp_path / "keys") as (port, opened),
        socket.create_connection(("127.0.0.1", port)) as call,
    ):
        channel, number = PairingChannel(call, 10.0), draw_number()
        channel.send(Call(card=own, commitment=commitment_to(own, number)))
        channel.receive(Answer)
        channel.send(Opening(number=number))
        code = opened_code(opened)
        opened.close()
        assert not opened.confirm(code)
        assert opened.outcome.sentence == "the window was closed: open it again"
    assert not (tmp_path / "keys").exists()


def test_a_key_that_cannot_be_stored_is_reported_on_the_screen(
    devices: PairedDevices, device_card: DeviceCard, tmp_path: Path
) -> None:
    (tmp_path / "keys").mkdir()
    with window(device_card, tmp_path / "keys") as (port, opened):
        with pytest.raises(PairingError):
            paired_devices.pair_over_network(
                "127.0.0.1", port, paired_devices.own_card(devices, "bench"), compare(opened)
            )
        with pytest.raises(PairingRefused, match="key cannot be stored"):
            opened.wait()


def test_a_device_opens_its_window_by_one_call(store: BundleStore, devices: PairedDevices, tmp_path: Path) -> None:
    own = paired_devices.own_card(devices, "bench")
    (tmp_path / "host.pub").write_text(f"{own.public_key} root@device\n")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        setup = PairingSetup(taken.getsockname()[1], 2222, host_key=tmp_path / "host.pub", keys=tmp_path / "keys")
        with pytest.raises(PairingRefused, match="is not free"):
            open_pairing_window(store, VirtualClock(), setup)
    with open_pairing_window(store, VirtualClock(), setup) as opened:
        told = how_to_call(opened, setup, store)
        assert f"--port {setup.port}" in told
        assert f"{store.device_id}, key {fingerprint_of(own.public_key)}" in told
        device = paired_devices.pair_over_network("127.0.0.1", setup.port, own, compare(opened))
    assert (device.device_id, device.user, device.port) == (store.device_id, "retrosync", 2222)
    assert own.public_key in (tmp_path / "keys" / "authorized_keys").read_text()
    for wrong in ({"ssh_port": 0}, {"user": "no user"}):
        with pytest.raises(RecordError, match="name another"):
            dataclasses.replace(setup, **wrong).card(store)  # type: ignore[arg-type]


def test_a_memory_card_pairs_a_device_without_a_screen(
    devices: PairedDevices, device_card: DeviceCard, tmp_path: Path
) -> None:
    card = tmp_path / "card"
    own = paired_devices.own_card(devices, "bench")
    with pytest.raises(PairingError, match="is no folder"):
        paired_devices.pair_by_card(card, own, None)
    card.mkdir()
    assert paired_devices.pair_by_card(card, own, None) is None
    assert take_host_cards(card) == [own]
    leave_device_card(card, device_card)
    device = paired_devices.pair_by_card(card, own, None)
    assert device is not None
    assert (device.host, device.host_key) == ("rg00c0ffee.local", device_card.host_key)
    (card / "retrograph-pair" / "device.json").write_text("{}")
    with pytest.raises(PairingError, match=r"device\.json"):
        paired_devices.pair_by_card(card, own, None)


def test_a_changed_key_is_kept_only_when_asked(devices: PairedDevices, device_card: DeviceCard, tmp_path: Path) -> None:
    (tmp_path / "card").mkdir()
    own = paired_devices.own_card(devices, "bench")
    leave_device_card(tmp_path / "card", device_card)
    device = paired_devices.pair_by_card(tmp_path / "card", own, "here")
    assert device is not None
    paired_devices.keep(devices, device, replace=False)
    anew = msgspec.structs.replace(device, host_key=own.public_key)
    with pytest.raises(PairingError, match="another host key than when it was paired"):
        paired_devices.keep(devices, anew, replace=False)
    assert devices.all() == [device]
    paired_devices.keep(devices, anew, replace=True)
    assert devices.find("c0ffee") == anew
    with pytest.raises(NoSource, match="of the paired devices: rg00c0ffee"):
        devices.find("other")


def test_a_device_set_up_anew_takes_the_place_of_what_it_was_only_when_asked(
    devices: PairedDevices, device_card: DeviceCard, tmp_path: Path
) -> None:
    own = paired_devices.own_card(devices, "bench")
    before = PairedDevice(device_id="rg1", host="bench.local", port=22, user="retrosync", host_key=own.public_key)
    paired_devices.keep(devices, before, replace=False)
    anew = msgspec.structs.replace(before, device_id="rg2", host_key=device_card.host_key)
    with pytest.raises(PairingError, match=r"bench\.local: is rg2 and was rg1: if you set it up again.*--replace"):
        paired_devices.keep(devices, anew, replace=False)
    assert devices.find("bench.local") == before
    paired_devices.keep(devices, anew, replace=True)
    assert devices.all() == [anew]
    assert devices.find("bench.local") == anew


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("bench", "bench", None),
        ("bench:22", "bench", 22),
        ("[fe80::1%eth0]:22", "fe80::1%eth0", 22),
        ("::1", "::1", None),
    ],
)
def test_addresses(text: str, host: str, port: int | None) -> None:
    assert Address.parse(text) == Address(host, port)


@pytest.mark.parametrize("text", ["", ":22", "bench:", "bench:x", "bench:0", "bench:65536", "[::1", "[]:22"])
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(HostError, match="is no address"):
        Address.parse(text)


def test_codes_that_nobody_compares_and_a_port_that_is_none_are_explained(
    devices: PairedDevices,
    device_card: DeviceCard,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    with window(device_card, tmp_path / "keys") as (port, _):
        assert main(["pair", "127.0.0.1", "--port", str(port)]) == 2
    assert main(["pair", "localhost", "--port", "99999"]) == 2
    assert main(["pull", "a" * 5000, "--library", str(tmp_path / "library")]) == 2
    said = capsys.readouterr().err
    assert "nobody compared the codes" in said
    assert "99999: is no port" in said
    assert "matches none of the paired devices" in said


def test_secrets_are_for_their_owner_alone(devices: PairedDevices, device_card: DeviceCard, tmp_path: Path) -> None:
    own = paired_devices.own_card(devices, "bench")
    assert paired_devices.own_card(devices, "bench") == own
    (tmp_path / "card").mkdir()
    leave_device_card(tmp_path / "card", device_card)
    device = paired_devices.pair_by_card(tmp_path / "card", own, None)
    assert device is not None
    devices.save(device)
    files = [path for path in devices.folder.rglob("*") if path.is_file()]
    assert len(files) == 2
    assert {path.stat().st_mode & 0o777 for path in files} == {0o600}
    (devices.folder / "id_ed25519").chmod(0o644)
    with pytest.raises(HostError, match="chmod 600"):
        paired_devices.own_card(devices, "bench")


def test_the_key_of_sshd_is_read_without_its_comment(tmp_path: Path) -> None:
    path = tmp_path / "key.pub"
    path.write_text("ssh-ed25519 AAAA root@device\n")
    assert read_host_key(path) == "ssh-ed25519 AAAA"
    with pytest.raises(RecordError, match="install openssh-server"):
        read_host_key(tmp_path / "none.pub")

"""Whoever sits between device and workstation, or has recorded them, gets neither's trust: trials on the whole path."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import asyncssh
import msgspec
import numpy as np
import pytest

from device.errors import RecordError
from device.pairing.channel import PairingChannel
from device.pairing.exchange import Confirmation, DeviceCard, Exchange, HostCard, Share
from device.pairing_service.authorized_keys import authorize
from device.pairing_service.window import PairingWindow
from hal.clock import VirtualClock
from host_sync.errors import HostError
from host_sync.offload import pairing
from host_sync.offload.paired_devices import PairedDevice

Change = Callable[[bytes, "Middle"], bytes | None]
CODE = "20261122"


def new_key() -> str:
    return " ".join(asyncssh.generate_private_key("ssh-ed25519").export_public_key().decode().split()[:2])


@dataclass
class Middle:
    """Passes lines on, both ways; `changes` alters a line by its direction and number, None hangs up."""

    to: tuple[str, int]
    changes: dict[tuple[str, int], Change] = field(default_factory=dict)
    record: dict[tuple[str, int], bytes] = field(default_factory=dict)

    def serve(self, listening: socket.socket) -> None:
        with suppress(OSError), closing(listening):
            caller, _ = listening.accept()
            with caller, socket.create_connection(self.to, timeout=10.0) as called:
                back = threading.Thread(target=self._pass, args=("device", called, caller))
                back.start()
                self._pass("host", caller, called)
                back.join()

    def _pass(self, side: str, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            for number, line in enumerate(source.makefile("rb")):
                self.record[side, number] = line
                change = self.changes.get((side, number))
                said = change(line, self) if change else line
                if said is None:
                    break
                target.sendall(said)
        for one in (source, target):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)


@dataclass
class Scene:
    """A device's window, a workstation, and who is allowed in afterwards."""

    keys: Path
    host: HostCard
    device: DeviceCard

    @contextmanager
    def window(self) -> Iterator[tuple[tuple[str, int], PairingWindow]]:
        listening = socket.create_server(("127.0.0.1", 0))
        with PairingWindow(listening, self.device, lambda one: authorize(self.keys, one), VirtualClock()) as opened:
            opened.code = CODE
            yield ("127.0.0.1", listening.getsockname()[1]), opened

    def call(self, serve: Callable[[socket.socket], None], code: str = CODE) -> PairedDevice | None:
        """Pair with whatever `serve` answers; None when the workstation refuses."""
        listening = socket.create_server(("127.0.0.1", 0))
        port = listening.getsockname()[1]
        thread = threading.Thread(target=serve, args=(listening,))
        thread.start()
        try:
            return pairing.pair_over_network("127.0.0.1", port, code, self.host)
        except HostError as error:
            assert "\n" not in str(error)  # noqa: PT017
            return None
        finally:
            thread.join()

    def allowed(self) -> list[str]:
        return self.keys.read_text().splitlines() if self.keys.exists() else []

    def check(self, paired: PairedDevice | None) -> None:
        """Nobody but the two trusts anybody but the two."""
        assert self.allowed() in ([], [f"restrict {self.host.public_key} {self.host.name}"])
        assert paired is None or (paired.host_key, paired.device_id) == (self.device.host_key, self.device.device_id)


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    device = DeviceCard(device_id="rg00c0ffee", user="retrosync", port=22, host_key=new_key())
    return Scene(tmp_path / "authorized_keys", HostCard(name="bench", public_key=new_key()), device)


def with_card(**changes: object) -> Change:
    def change(line: bytes, _: Middle) -> bytes:
        share = msgspec.json.decode(line, type=Share)
        card = msgspec.structs.replace(share.card, **changes)
        return msgspec.json.encode(msgspec.structs.replace(share, card=card)) + b"\n"

    return change


def with_share(of: HostCard | DeviceCard | None = None, share: str | None = None) -> Change:
    """Another share beside the honest card: of an exchange with the right code even, or a given one."""

    def change(line: bytes, _: Middle) -> bytes:
        said = msgspec.json.decode(line, type=Share)
        other = share or Exchange("0", of or said.card).share.share
        return msgspec.json.encode(msgspec.structs.replace(said, share=other)) + b"\n"

    return change


def instead(side: str, number: int) -> Change:
    return lambda _, middle: middle.record[side, number]


def repeated(line: bytes, _: Middle) -> bytes:
    return line + line


def hang_up(_: bytes, __: Middle) -> None:
    return None


EVIL = new_key()
MEDDLING: dict[str, dict[tuple[str, int], Change]] = {
    "the workstation's key is the attacker's": {("host", 0): with_card(public_key=EVIL)},
    "the device's key is the attacker's": {("device", 0): with_card(host_key=EVIL)},
    "both keys are": {("host", 0): with_card(public_key=EVIL), ("device", 0): with_card(host_key=EVIL)},
    "the device's port is another": {("device", 0): with_card(port=2222)},
    "the device's id is another": {("device", 0): with_card(device_id="rg1")},
    "the workstation's name is another": {("host", 0): with_card(name="other")},
    "the workstation's share is another": {("host", 0): with_share()},
    "the device's share is another": {("device", 0): with_share()},
    "both shares are of low order": {
        ("host", 0): with_share(share="01" + "00" * 31),
        ("device", 0): with_share(share="00" * 32),
    },
    "the workstation gets its own share": {("device", 0): instead("host", 0)},
    "the workstation gets its own confirmation": {("device", 1): instead("host", 1)},
    "the workstation's share comes twice": {("host", 0): repeated},
    "the device's share comes twice": {("device", 0): repeated},
    "the workstation's confirmation does not come": {("host", 1): hang_up},
    "the device's confirmation does not come": {("device", 1): hang_up},
}
TOO_LATE = {
    "the workstation gets its own confirmation",
    "the device's share comes twice",
    "the device's confirmation does not come",
}
"""The device has heard the honest workstation out, and lets it in; the workstation pins nothing and pairs again."""


def test_who_only_listens_changes_nothing(scene: Scene) -> None:
    with scene.window() as (address, opened):
        paired = scene.call(Middle(address).serve)
        assert opened.wait() == scene.host
    assert paired is not None
    assert scene.allowed() == [f"restrict {scene.host.public_key} bench"]
    scene.check(paired)


@pytest.mark.parametrize("what", MEDDLING)
def test_who_meddles_gets_nobodys_trust(scene: Scene, what: str) -> None:
    with scene.window() as (address, opened):
        paired = scene.call(Middle(address, MEDDLING[what]).serve)
        if what in TOO_LATE:  # the device may hear the last line after the workstation has hung up
            opened._thread.join(timeout=10.0)
    scene.check(paired)
    assert paired is None
    assert bool(scene.allowed()) == (what in TOO_LATE)


def test_no_changed_byte_earns_trust(scene: Scene) -> None:
    rng = np.random.default_rng(7)

    def flip(line: bytes, _: Middle) -> bytes:
        at = int(rng.integers(len(line) - 1))
        return line[:at] + bytes([line[at] ^ (1 << int(rng.integers(7)))]) + line[at + 1 :]

    for trial in range(60):
        where = (("host", "device")[trial % 2], trial // 2 % 2)
        with scene.window() as (address, _):
            scene.check(scene.call(Middle(address, {where: flip}).serve))
        scene.keys.unlink(missing_ok=True)


def test_two_conversations_with_guessed_codes_are_refused_by_both(scene: Scene) -> None:
    """The attacker speaks with each side in turn as the other, as one must who does not know the code."""
    rng = np.random.default_rng(8)
    evil_host, evil_device = (
        HostCard(name="bench", public_key=EVIL),
        msgspec.structs.replace(scene.device, host_key=EVIL),
    )
    for _ in range(10):
        guess = f"{rng.integers(10**8):08d}"

        def pose(listening: socket.socket, guess: str = guess) -> None:
            with closing(listening), closing(listening.accept()[0]) as caller, suppress(RecordError):
                channel, exchange = PairingChannel(caller, 10.0), Exchange(guess, evil_device)
                exchange.meet(channel.receive(Share), HostCard)
                channel.send(exchange.share)
                assert not exchange.is_confirmed(channel.receive(Confirmation))
                channel.send(exchange.confirmation)

        assert scene.call(pose) is None
        with scene.window() as (address, _), closing(socket.create_connection(address)) as call:
            channel, exchange = PairingChannel(call, 10.0), Exchange(guess, evil_host)
            channel.send(exchange.share)
            exchange.meet(channel.receive(Share), DeviceCard)
            channel.send(exchange.confirmation)
            with pytest.raises(RecordError):
                channel.receive(Confirmation)
        assert scene.allowed() == []


def test_a_recorded_pairing_opens_no_later_window_even_with_the_same_code(scene: Scene) -> None:
    with scene.window() as (address, _):
        tape = Middle(address)
        assert scene.call(tape.serve) is not None
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(address)
    scene.keys.unlink()

    with scene.window() as (address, opened), closing(socket.create_connection(address)) as call:
        call.sendall(tape.record["host", 0] + tape.record["host", 1])
        with suppress(ConnectionError):
            assert len(call.makefile("rb").readlines()) == 1
        assert opened.outcome is None
    assert scene.allowed() == []

    def replay(listening: socket.socket) -> None:
        with closing(listening), closing(listening.accept()[0]) as caller:
            caller.sendall(tape.record["device", 0] + tape.record["device", 1])
            caller.makefile("rb").readlines()

    assert scene.call(replay) is None


def test_confirmations_of_another_conversation_in_the_same_window_do_not_fit(scene: Scene) -> None:
    """The workstation's own confirmation, moved to a conversation that the attacker began with the stolen share."""
    with scene.window() as (address, opened), closing(socket.create_connection(address)) as second:
        stolen: dict[str, bytes] = {}

        def divert(line: bytes, middle: Middle) -> None:
            channel = PairingChannel(second, 10.0)
            second.sendall(middle.record["host", 0])
            stolen["share"] = msgspec.json.encode(channel.receive(Share))
            second.sendall(line)
            with pytest.raises(RecordError):
                channel.receive(Confirmation)

        assert scene.call(Middle(address, {("host", 1): divert}).serve) is None
        assert stolen
        assert opened.outcome is None
    assert scene.allowed() == []


def test_a_mirror_is_no_device(scene: Scene) -> None:
    def echo(listening: socket.socket) -> None:
        with closing(listening), closing(listening.accept()[0]) as caller, suppress(OSError):
            for line in caller.makefile("rb"):
                caller.sendall(line)

    assert scene.call(echo) is None

"""Between device and workstation, or after them: nobody is trusted whose code a person did not see on both screens."""

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
from limits import join

from device.errors import RecordError
from device.pairing import (
    Accepted,
    Answer,
    Call,
    DeviceCard,
    HostCard,
    Opening,
    PairingChannel,
    code_of,
    commitment_to,
    draw_number,
)
from device.pairing_service import READING_S, PairingWindow, authorize
from hal.clock import VirtualClock
from host_sync.errors import HostError
from host_sync.offload import paired_devices
from host_sync.offload.paired_devices import PairedDevice

Change = Callable[[bytes, "Middle"], bytes | None]


def new_key() -> str:
    return " ".join(asyncssh.generate_private_key("ssh-ed25519").export_public_key().decode().split()[:2])


EVIL = new_key()


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
                join(back)

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
    """A device's window, a workstation, and one careful person who compares both screens."""

    keys: Path
    host: HostCard
    device: DeviceCard
    compared: list[tuple[str, str]] = field(default_factory=list)
    """What the workstation and the device showed at each comparison."""

    @contextmanager
    def window(self) -> Iterator[tuple[tuple[str, int], PairingWindow]]:
        listening = socket.create_server(("127.0.0.1", 0))
        with PairingWindow(listening, self.device, lambda one: authorize(self.keys, one), VirtualClock()) as opened:
            yield ("127.0.0.1", listening.getsockname()[1]), opened

    def call(self, serve: Callable[[socket.socket], None], opened: PairingWindow | None = None) -> PairedDevice | None:
        """Pair with the answering party; None when the workstation refuses.

        The person confirms on the device, and then here, when both screens show the same code.
        """

        def same_code(code: str) -> bool:
            shown = wait_for_code(opened) if opened else None
            self.compared.append((code, shown or ""))
            if opened is None or shown != code:
                return False
            opened._clock.sleep(READING_S)
            return opened.confirm(code)

        listening = socket.create_server(("127.0.0.1", 0))
        port = listening.getsockname()[1]
        thread = threading.Thread(target=serve, args=(listening,))
        thread.start()
        try:
            return paired_devices.pair_over_network("127.0.0.1", port, self.host, same_code)
        except HostError as error:
            assert "\n" not in str(error)  # noqa: PT017
            return None
        finally:
            join(thread)

    def allowed(self) -> list[str]:
        return self.keys.read_text().splitlines() if self.keys.exists() else []

    def check(self, paired: PairedDevice | None) -> None:
        """Nobody but the two trusts anybody but the two."""
        assert self.allowed() in ([], [f"restrict {self.host.public_key} {self.host.name}"])
        assert paired is None or (paired.host_key, paired.device_id) == (self.device.host_key, self.device.device_id)


def wait_for_code(opened: PairingWindow) -> str | None:
    """Return the code that the device shows; None when its caller was turned away."""
    called = False
    for _ in range(400):
        if shown := opened.shown:
            return shown.code
        if opened.outcome or (called and not opened._calls):
            return None
        called = called or bool(opened._calls)
        threading.Event().wait(0.005)
    return None


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    device = DeviceCard(device_id="rg00c0ffee", user="retrosync", port=22, host_key=new_key())
    return Scene(tmp_path / "authorized_keys", HostCard(name="bench", public_key=new_key()), device)


def with_card(kind: type[Call] | type[Answer], **changes: object) -> Change:
    """Another card; a commitment to it is one that the attacker can open."""

    def change(line: bytes, _: Middle) -> bytes:
        said = msgspec.json.decode(line, type=kind)
        card = msgspec.structs.replace(said.card, **changes)
        said = msgspec.structs.replace(said, card=card)
        if isinstance(card, HostCard):
            said = msgspec.structs.replace(said, commitment=commitment_to(card, "ab" * 32))
        return msgspec.json.encode(said) + b"\n"

    return change


def other_number(line: bytes, _: Middle) -> bytes:
    kind = Answer if b"pair-answer" in line else Opening
    return msgspec.json.encode(msgspec.structs.replace(msgspec.json.decode(line, type=kind), number="ab" * 32)) + b"\n"


def instead(side: str, number: int) -> Change:
    return lambda _, middle: middle.record[side, number]


def repeated(line: bytes, _: Middle) -> bytes:
    return line + line


def hang_up(_: bytes, __: Middle) -> None:
    return None


MEDDLING: dict[str, dict[tuple[str, int], Change]] = {
    "the workstation's key is the attacker's": {
        ("host", 0): with_card(Call, public_key=EVIL),
        ("host", 1): other_number,
    },
    "the device's key is the attacker's": {("device", 0): with_card(Answer, host_key=EVIL)},
    "both keys are": {
        ("host", 0): with_card(Call, public_key=EVIL),
        ("host", 1): other_number,
        ("device", 0): with_card(Answer, host_key=EVIL),
    },
    "the device's port is another": {("device", 0): with_card(Answer, port=2222)},
    "the device's id is another": {("device", 0): with_card(Answer, device_id="rg1")},
    "the workstation's name is another": {("host", 0): with_card(Call, name="other"), ("host", 1): other_number},
    "the card changes under an honest commitment": {
        ("host", 0): lambda line, _: line.replace(b'"bench"', b'"bunch"'),
    },
    "the workstation's number is another": {("host", 1): other_number},
    "the device's number is another": {("device", 0): other_number},
    "the workstation gets its own call": {("device", 0): instead("host", 0)},
    "the workstation's call comes twice": {("host", 0): repeated},
    "the device's answer comes twice": {("device", 0): repeated},
    "the workstation's number does not come": {("host", 1): hang_up},
    "the device's acceptance does not come": {("device", 1): hang_up},
}
TOO_LATE = {"the device's answer comes twice", "the device's acceptance does not come"}
"""The person saw the same code twice and let the honest workstation in; it pins nothing and pairs again."""


def test_who_only_listens_changes_nothing(scene: Scene) -> None:
    with scene.window() as (address, opened):
        paired = scene.call(Middle(address).serve, opened)
        assert opened.wait() == scene.host
    assert paired is not None
    assert scene.allowed() == [f"restrict {scene.host.public_key} bench"]
    scene.check(paired)


@pytest.mark.parametrize("what", MEDDLING)
def test_who_meddles_gets_nobodys_trust(scene: Scene, what: str) -> None:
    with scene.window() as (address, opened):
        paired = scene.call(Middle(address, MEDDLING[what]).serve, opened)
        if what in TOO_LATE:  # the device may be done only after the workstation has hung up
            opened._thread.join(timeout=10.0)
    scene.check(paired)
    assert paired is None
    assert bool(scene.allowed()) == (what in TOO_LATE)


@pytest.mark.parametrize("trials", [20, pytest.param(200, marks=pytest.mark.slow)])
def test_no_changed_byte_earns_trust(scene: Scene, trials: int) -> None:
    rng = np.random.default_rng(7)

    def flip(line: bytes, _: Middle) -> bytes:
        at = int(rng.integers(len(line) - 1))
        return line[:at] + bytes([line[at] ^ (1 << int(rng.integers(7)))]) + line[at + 1 :]

    for trial in range(trials):
        where = (("host", "device")[trial % 2], trial // 2 % 2)
        with scene.window() as (address, opened):
            scene.check(scene.call(Middle(address, {where: flip}).serve, opened))
        scene.keys.unlink(missing_ok=True)


def test_two_conversations_show_two_codes(scene: Scene) -> None:
    """The attacker speaks with each side as the other, and opens its own commitments: the codes differ."""
    evil_host = HostCard(name="bench", public_key=EVIL)
    evil_device = msgspec.structs.replace(scene.device, host_key=EVIL)
    for _ in range(10):
        with scene.window() as (address, opened):

            def pose(listening: socket.socket, address: tuple[str, int] = address) -> None:
                with (
                    closing(listening),
                    closing(listening.accept()[0]) as caller,
                    closing(socket.create_connection(address)) as called,
                    suppress(RecordError),
                ):
                    host, device = PairingChannel(caller, 10.0), PairingChannel(called, 10.0)
                    number = draw_number()
                    host.receive(Call)
                    device.send(Call(card=evil_host, commitment=commitment_to(evil_host, number)))
                    theirs = device.receive(Answer)
                    host.send(Answer(card=evil_device, number=theirs.number))
                    host.receive(Opening)
                    device.send(Opening(number=number))
                    host.send(Accepted())
                    host.receive(Accepted)  # until the workstation hangs up

            assert scene.call(pose, opened) is None
        assert scene.allowed() == []
    assert all(here != there and len(there) == 7 for here, there in scene.compared)


def test_a_number_that_was_not_committed_to_is_shown_to_nobody(scene: Scene) -> None:
    """Otherwise a caller could choose, after the device's number, the one of a million that makes a code it wants."""
    card = HostCard(name="bench", public_key=EVIL)
    with scene.window() as (address, opened), closing(socket.create_connection(address)) as call:
        channel, mine = PairingChannel(call, 10.0), draw_number()
        channel.send(Call(card=card, commitment=commitment_to(card, mine)))
        answer = channel.receive(Answer)
        wanted = next(
            number
            for number in (draw_number() for _ in range(10**6))
            if code_of(card, scene.device, number, answer.number).startswith("12")
        )
        channel.send(Opening(number=wanted))
        with pytest.raises(RecordError):
            channel.receive(Accepted)
        assert opened.shown is None
    assert scene.allowed() == []


def test_a_recorded_pairing_shows_another_code_in_a_later_window(scene: Scene) -> None:
    with scene.window() as (address, opened):
        tape = Middle(address)
        assert scene.call(tape.serve, opened) is not None
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(address)
    scene.keys.unlink()

    with scene.window() as (address, opened), closing(socket.create_connection(address)) as call:
        call.sendall(tape.record["host", 0] + tape.record["host", 1])
        assert wait_for_code(opened) not in (None, scene.compared[0][1])
        assert not opened.confirm(scene.compared[0][1])
    assert scene.allowed() == []

    def replay(listening: socket.socket) -> None:
        with closing(listening), closing(listening.accept()[0]) as caller:
            caller.sendall(tape.record["device", 0] + tape.record["device", 1])
            caller.makefile("rb").readlines()

    assert scene.call(replay) is None
    assert scene.compared[-1][0] != scene.compared[0][0]


def test_a_mirror_is_no_device(scene: Scene) -> None:
    def echo(listening: socket.socket) -> None:
        with closing(listening), closing(listening.accept()[0]) as caller, suppress(OSError):
            for line in caller.makefile("rb"):
                caller.sendall(line)

    assert scene.call(echo) is None
    assert scene.compared == []

"""A device's SFTP server for real: OpenSSH's sshd on loopback, as the current user, and a proxy in front that harms."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal

import asyncssh
import msgspec
import pytest
from limits import join
from sshd import SSHD, WITHOUT_SSHD, prepare_sshd

from device.store.store import BundleStore
from host_sync.offload.paired_devices import PairedDevice
from host_sync.offload.sftp_link import ReconnectingSftp, Timeouts

BRISK = Timeouts(keepalive_s=0.5, unanswered=2, give_up_s=5.0, retry_s=0.01)


@dataclass
class Server:
    """A running sshd that serves one folder over SFTP, and what a client needs to know of it."""

    folder: Path
    root: Path
    port: int
    host_key: str
    private_key: Path
    process: subprocess.Popen[bytes] | None = None
    listener: threading.Thread | None = None

    def start(self) -> None:
        self.process = subprocess.Popen([SSHD, "-D", "-e", "-f", self.folder / "sshd_config"], stderr=subprocess.PIPE)
        assert self.process.stderr is not None
        said = b""
        while b"Server listening" not in said:
            line = self.process.stderr.readline()
            assert line, said.decode()
            said += line
        self.listener = threading.Thread(target=drain, args=(self.process.stderr,))
        self.listener.start()

    def kill(self) -> None:
        """End it without a warning, its sessions too."""
        if self.process is not None:
            subprocess.run(["pkill", "-KILL", "-P", str(self.process.pid)], check=False)
            self.process.kill()
            self.process.wait(60.0)
        if self.listener is not None:
            join(self.listener)

    def device(self, port: int | None = None, host_key: str | None = None) -> PairedDevice:
        return PairedDevice(
            device_id="rg00c0ffee",
            host="127.0.0.1",
            port=port or self.port,
            user=getpass.getuser(),
            host_key=host_key or self.host_key,
        )

    def link(
        self, port: int | None = None, timeouts: Timeouts = BRISK, host_key: str | None = None
    ) -> ReconnectingSftp:
        return ReconnectingSftp(self.device(port, host_key), self.private_key, timeouts)


def drain(stream: IO[bytes]) -> None:
    with stream:
        while stream.read(4096):
            pass


def public_line(key: asyncssh.SSHKey) -> str:
    return " ".join(key.export_public_key().decode().split()[:2])


@pytest.fixture
def confinement() -> Callable[[Path], str]:
    """What keeps sessions to SFTP, for the root of a store."""
    return lambda root: f"ForceCommand internal-sftp -d {root}\n"


@pytest.fixture
def server(tmp_path: Path, store: BundleStore, confinement: Callable[[Path], str]) -> Iterator[Server]:
    """The store of the fixture `store`, served; nothing but SFTP, nobody but one key."""
    if shutil.which(SSHD) is None:
        pytest.skip(WITHOUT_SSHD)
    prepare_sshd()
    folder = tmp_path / "sshd"
    folder.mkdir()
    host_key, own_key = (asyncssh.generate_private_key("ssh-ed25519") for _ in range(2))
    for name, key in (("host_key", host_key), ("id_ed25519", own_key)):
        key.write_private_key(folder / name)
        (folder / name).chmod(0o600)
    (folder / "authorized_keys").write_bytes(own_key.export_public_key())
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    (folder / "sshd_config").write_text(
        f"ListenAddress 127.0.0.1:{port}\nHostKey {folder}/host_key\nAuthorizedKeysFile {folder}/authorized_keys\n"
        "PidFile none\nStrictModes no\nUsePAM no\nPasswordAuthentication no\nPermitRootLogin prohibit-password\n"
        "MaxStartups 100\nSubsystem sftp internal-sftp\n"
        f"DisableForwarding yes\nPermitTTY no\n{confinement(store.root)}"
    )
    serving = Server(folder, store.root, port, public_line(host_key), folder / "id_ed25519")
    serving.start()
    yield serving
    serving.kill()


Harm = Literal["cut", "flip", "silence"]


class Proxy:
    """Harms one connection after the other as `harms` says: what, after how many bytes from the server."""

    def __init__(self, server_port: int) -> None:
        self.harms: deque[tuple[Harm, int]] = deque()
        self.bytes_per_s: float | None = None
        self.upward_bytes_per_s: float | None = None
        self.served_bytes = 0
        self.connections = 0
        self.milestone_bytes = 0
        self.passed_milestone = threading.Event()
        self._server_port = server_port
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._sockets: list[socket.socket] = []
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def end(self) -> None:
        self._ended.set()
        self._listening.shutdown(socket.SHUT_RDWR)
        self._hang_up(*self._sockets)
        for thread in self._threads:
            join(thread)
        for each in (self._listening, *self._sockets):
            each.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            self.connections += 1
            self._sockets.append(client)
            try:
                server = socket.create_connection(("127.0.0.1", self._server_port))
            except OSError:
                self._hang_up(client)
                continue
            self._sockets.append(server)
            harm = self.harms.popleft() if self.harms else None
            pumps = [
                threading.Thread(target=self._upwards, args=(client, server)),
                threading.Thread(target=self._downwards, args=(server, client, harm)),
            ]
            self._threads += pumps
            for pump in pumps:
                pump.start()

    def _upwards(self, client: socket.socket, server: socket.socket) -> None:
        with suppress(OSError):
            while block := client.recv(16384):
                server.sendall(block)
                if self.upward_bytes_per_s:
                    self._ended.wait(len(block) / self.upward_bytes_per_s)
        self._hang_up(client, server)

    def _downwards(self, server: socket.socket, client: socket.socket, harm: tuple[Harm, int] | None) -> None:
        passed = 0
        with suppress(OSError):
            while block := server.recv(16384):
                if harm and passed + len(block) > harm[1]:
                    at = harm[1] - passed
                    if harm[0] == "silence":
                        self._ended.wait()
                        break
                    block = block[:at] + (bytes([block[at] ^ 0x10]) + block[at + 1 :] if harm[0] == "flip" else b"")
                client.sendall(block)
                passed += len(block)
                self.served_bytes += len(block)
                if self.served_bytes > self.milestone_bytes:
                    self.passed_milestone.set()
                if harm and passed >= harm[1]:
                    if harm[0] == "cut":
                        break
                    harm = None
                if self.bytes_per_s:
                    self._ended.wait(len(block) / self.bytes_per_s)
        self._hang_up(client, server)

    @staticmethod
    def _hang_up(*sockets: socket.socket) -> None:
        for each in sockets:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)


@pytest.fixture
def proxy(server: Server) -> Iterator[Proxy]:
    proxying = Proxy(server.port)
    yield proxying
    proxying.end()


@pytest.fixture
def publish_large(store: BundleStore, scan_record: Callable[..., object]) -> Callable[[int], object]:
    """Publishes a scan with that many random bytes."""

    def publish(size_bytes: int) -> object:
        def write(directory: Path) -> None:
            (directory / "raw.tif").write_bytes(os.urandom(size_bytes))

        record = msgspec.structs.replace(scan_record(store), shape=(3000, 4000))  # type: ignore[type-var]
        return store.publish_scan(record, write)

    return publish

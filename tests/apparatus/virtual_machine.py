"""The virtual board: Debian in QEMU without KVM, obeying scripts over a serial port of its own.

Its disk is a copy-on-write layer over the cached root, so that what a test installs is gone afterwards; its data disk
records every write. Everything in it is emulated: times say how long the tests take, nothing about a board.
"""

from __future__ import annotations

import base64
import os
import shutil
import socket
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

QEMU = "qemu-system-x86_64"
MEMORY_MIB = 1536
SSH, PAIRING = 22, 8022
LONG_S = 900.0
"""Nothing takes so long, however loaded the machine is: who waits this long waits for something that hangs."""


class GuestError(RuntimeError):
    """A script failed in the guest, or the guest fell silent."""


@dataclass(frozen=True)
class Answer:
    """What a script in the guest ended with, and what it said."""

    code: int
    text: str


def free_port() -> int:
    """A port of the loopback interface that nobody listens on now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class VirtualMachine:
    """One machine; entering it switches it on, leaving it pulls the plug.

    cache : what tests/system/build made
    folder : its own files: overlay, console, log of its data disk's writes
    shares : folders that the guest mounts by 9p, by tag
    init : the guest's first process
    data : a disk image whose writes are recorded in `log`, as blklogwrites does
    number : what the firmware numbers this board with (a UUID)
    """

    cache: Path
    folder: Path
    shares: dict[str, Path]
    init: str = "/sbin/init"
    data: Path | None = None
    number: str = "00000000-0000-4000-8000-00000000000a"
    ports: dict[int, int] = field(default_factory=dict)

    @property
    def console(self) -> Path:
        """What kernel and systemd wrote to the serial console."""
        return self.folder / "console.log"

    @property
    def log(self) -> Path:
        """The log of the data disk's writes."""
        return self.folder / "data.log"

    @property
    def disk(self) -> Path:
        """What its root file system became, over the cached one."""
        return self.folder / "root.qcow2"

    def __enter__(self) -> Self:
        root = (self.cache / "root.ext4").resolve()
        subprocess.run(["qemu-img", "create", "-q", "-f", "qcow2", "-b", root, "-F", "raw", self.disk], check=True)
        self.ports = {port: free_port() for port in (SSH, PAIRING)}
        self.switch_on()
        return self

    def switch_on(self, command_line: str | None = None) -> float:
        """Starts it, for the first time or after `power_off`; returns after how many seconds it obeys.

        command_line : what a board's firmware reads in cmdline.txt: as there, the initramfs mounts the root
        """
        if command_line is None:
            boot = ["-append", f"root=/dev/vda rw console=ttyS0 quiet init={self.init} systemd.show_status=yes"]
        else:
            boot = ["-append", command_line, "-initrd", str(self.cache / "initrd.img")]
        with (self.folder / "qemu.log").open("wb") as said:
            self._qemu = subprocess.Popen([*self._command(), *boot], stdout=said, stderr=subprocess.STDOUT)
        self._agent = self._connected()
        return self.wait_until_up()

    @property
    def is_on(self) -> bool:
        """Whether it runs."""
        return self._qemu.poll() is None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._agent.close()
        self._qemu.kill()
        self._qemu.wait()

    def wait_until_up(self, timeout_s: float = LONG_S) -> float:
        """Waits until the guest obeys; returns after how many seconds."""
        began = time.monotonic()
        if (line := self._line(timeout_s)) != b"ready\n":
            raise GuestError(f"the guest says {line!r} in the place of 'ready'; see {self.console}")
        return time.monotonic() - began

    def ask(self, script: str, timeout_s: float = LONG_S) -> Answer:
        """What a script (bash -euo pipefail, as root) ends with and says."""
        self._agent.sendall(base64.b64encode(script.encode()) + b"\n")
        answer = self._line(timeout_s)
        if answer == b"ready\n":
            raise GuestError(f"the guest was started anew by itself; see {self.console}")
        code, _, said = answer.partition(b" ")
        return Answer(int(code), base64.b64decode(said).decode(errors="replace"))

    def run(self, script: str, timeout_s: float = LONG_S) -> str:
        """What a script says.

        Raises
        ------
        GuestError
            It fails, or takes longer than `timeout_s`.
        """
        answer = self.ask(script, timeout_s)
        if answer.code:
            raise GuestError(f"exit code {answer.code} of\n{script}\n{answer.text}")
        return answer.text

    def wait_for(self, script: str, timeout_s: float = LONG_S) -> str:
        """Asks every second until the script succeeds; what it says then."""
        end = time.monotonic() + timeout_s
        while (answer := self.ask(script)).code:
            if time.monotonic() > end:
                raise GuestError(f"not within {timeout_s:g} s:\n{script}\n{answer.text}")
            time.sleep(1.0)
        return answer.text

    def reboot(self, timeout_s: float = LONG_S) -> float:
        """In order, not by the plug; returns after how many seconds the guest obeys again."""
        self.run("systemctl reboot --no-block")
        return self.wait_until_up(timeout_s)

    def power_off(self, script: str = "systemctl poweroff --no-block", timeout_s: float = LONG_S) -> float:
        """In order, by whatever asks for it; returns after how many seconds the machine was off."""
        began = time.monotonic()
        self.run(script)
        self._qemu.wait(timeout_s)
        self._agent.close()
        return time.monotonic() - began

    def _command(self) -> list[str]:
        nice = ["nice", "-n", "5"] if shutil.which("nice") else []
        forwards = ",".join(f"hostfwd=tcp:127.0.0.1:{here}-:{there}" for there, here in self.ports.items())
        command = [
            *nice, QEMU, "-M", "q35", "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2", "-m", str(MEMORY_MIB),
            "-display", "none", "-monitor", "none", "-serial", f"file:{self.console}", "-uuid", self.number,
            "-kernel", str(self.cache / "bzImage"),
            "-drive", f"file={self.disk},if=none,id=root,cache=unsafe", "-device", "virtio-blk-pci,drive=root",
            "-netdev", f"user,id=net,restrict=on,{forwards}", "-device", "virtio-net-pci,netdev=net,romfile=",
            "-device", "virtio-rng-pci", "-device", "virtio-serial-pci",
            "-chardev", f"socket,id=agent,path={self.folder / 'agent'},server=on,wait=off",
            "-device", "virtserialport,chardev=agent,name=agent",
        ]  # fmt: skip
        for tag, folder in self.shares.items():
            command += ["-virtfs", f"local,path={folder},mount_tag={tag},security_model=none,multidevs=remap"]
        return command + (self._recorded_disk() if self.data else [])

    def _recorded_disk(self) -> list[str]:
        self.log.touch()
        return [
            "-blockdev", f"driver=file,node-name=disk,filename={self.data}",
            "-blockdev", f"driver=file,node-name=log,filename={self.log}",
            "-blockdev", "driver=blklogwrites,node-name=recorded,file=disk,log=log,"
            "log-sector-size=512,log-super-update-interval=1",
            "-device", "virtio-blk-pci,drive=recorded,serial=data",
        ]  # fmt: skip

    def _connected(self) -> socket.socket:
        end = time.monotonic() + 10.0
        while time.monotonic() < end and self._qemu.poll() is None:
            agent = socket.socket(socket.AF_UNIX)
            try:
                agent.connect(os.fspath(self.folder / "agent"))
            except OSError:
                agent.close()
                time.sleep(0.05)
            else:
                self._said = bytearray()
                return agent
        self._qemu.kill()
        raise GuestError(f"QEMU does not start: {(self.folder / 'qemu.log').read_text()}")

    def _line(self, timeout_s: float) -> bytes:
        end = time.monotonic() + timeout_s
        while b"\n" not in self._said:
            self._agent.settimeout(max(end - time.monotonic(), 0.01))
            try:
                more = self._agent.recv(1 << 16)
            except TimeoutError:
                raise GuestError(f"the guest says nothing for {timeout_s:g} s; see {self.console}") from None
            if not more:
                raise GuestError(f"the guest has gone; see {self.console}")
            self._said += more
        line, _, rest = bytes(self._said).partition(b"\n")
        self._said = bytearray(rest)
        return line + b"\n"

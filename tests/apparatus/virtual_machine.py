"""The virtual board: Debian in QEMU without KVM, controlled by scripts over its own serial port.

Its disk is a copy-on-write layer over the cached root, so that what a test installs is gone afterwards; its data disk
records every write. Everything in it is emulated: times show how long the tests take, nothing about a board.
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
"""Longer than anything takes on a loaded machine; after this long something hangs."""


class GuestError(RuntimeError):
    """A script failed in the guest, or the guest stopped responding."""


@dataclass(frozen=True)
class Answer:
    """Exit code and output of a script in the guest."""

    code: int
    text: str


def free_port() -> int:
    """A port of the loopback interface that is not in use."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class VirtualMachine:
    """One machine; entering switches it on, leaving cuts the power.

    cache : output of tests/system/build
    folder : its own files: overlay, console, log of the writes to its data disk
    shares : folders that the guest mounts by 9p, by tag
    init : first process of the guest
    data : a disk image whose writes are recorded in `log` by blklogwrites
    number : serial number of this board in the firmware (a UUID)
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
        """Output of kernel and systemd on the serial console."""
        return self.folder / "console.log"

    @property
    def log(self) -> Path:
        """Log of the writes to the data disk."""
        return self.folder / "data.log"

    @property
    def disk(self) -> Path:
        """Its root file system, over the cached one."""
        return self.folder / "root.qcow2"

    def __enter__(self) -> Self:
        root = (self.cache / "root.ext4").resolve()
        subprocess.run(["qemu-img", "create", "-q", "-f", "qcow2", "-b", root, "-F", "raw", self.disk], check=True)
        self.ports = {port: free_port() for port in (SSH, PAIRING)}
        self.switch_on()
        return self

    def switch_on(self, command_line: str | None = None) -> float:
        """Start it, for the first time or after `power_off`; returns the seconds until it responds.

        command_line : contents of cmdline.txt for a board's firmware; as there, the initramfs mounts the root
        """
        own = f"root=/dev/vda rw console=ttyS0 quiet init={self.init} systemd.show_status=yes"
        initrd = ["-initrd", str(self.cache / "initrd.img")] if command_line else []
        # An emulated timer is late on a loaded machine, and the kernel would take it for broken.
        boot = ["-append", f"{command_line or own} no_timer_check", *initrd]
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
        """Wait until the guest responds; returns the seconds."""
        began = time.monotonic()
        if (line := self._line(timeout_s)) != b"ready\n":
            raise GuestError(f"the guest sent {line!r} instead of 'ready'; see {self.console}")
        return time.monotonic() - began

    def ask(self, script: str, timeout_s: float = LONG_S) -> Answer:
        """Exit code and output of a script (bash -euo pipefail, as root)."""
        self._agent.sendall(base64.b64encode(script.encode()) + b"\n")
        answer = self._line(timeout_s)
        if answer == b"ready\n":
            raise GuestError(f"the guest restarted by itself; see {self.console}")
        code, _, said = answer.partition(b" ")
        return Answer(int(code), base64.b64decode(said).decode(errors="replace"))

    def run(self, script: str, timeout_s: float = LONG_S) -> str:
        """Output of a script.

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
        """Run the script every second until it succeeds; returns its output."""
        end = time.monotonic() + timeout_s
        while (answer := self.ask(script)).code:
            if time.monotonic() > end:
                raise GuestError(f"not within {timeout_s:g} s:\n{script}\n{answer.text}")
            time.sleep(1.0)
        return answer.text

    def reboot(self, timeout_s: float = LONG_S) -> float:
        """Reboot in order; returns the seconds until the guest responds again."""
        self.run("systemctl reboot --no-block")
        return self.wait_until_up(timeout_s)

    def power_off(self, script: str = "systemctl poweroff --no-block", timeout_s: float = LONG_S) -> float:
        """Shut down in order; returns the seconds until the machine is off."""
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
                raise GuestError(f"no output from the guest for {timeout_s:g} s; see {self.console}") from None
            if not more:
                raise GuestError(f"the guest disappeared; see {self.console}")
            self._said += more
        line, _, rest = bytes(self._said).partition(b"\n")
        self._said = bytearray(rest)
        return line + b"\n"

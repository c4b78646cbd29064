"""A card of `make image` in QEMU's arm64 board, with the Pi's firmware played from outside.

The firmware reads autoboot.txt and then kernel, initramfs and command line from the boot partition that it names; so
does `VirtualCard.switch_on`, from the card itself. What else the firmware does (trees, overlays, tryboot) is not here.
Everything is emulated: times say nothing about a board.
"""

from __future__ import annotations

import base64
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

from image_layout import BOOT_NUMBERS, SELECT_NUMBER, Sizes, partitions
from virtual_machine import LONG_S, PAIRING, SSH, Answer, GuestError, free_port

QEMU = "qemu-system-aarch64"
MEMORY_MIB = 1536
UNITS = ("retroscan", "retrograph-first-boot", "retrograph-root")
PATIENCE = "[Service]\nTimeoutStartSec=900\nTimeoutStopSec=300\nWatchdogSec=0\n"
"""For units that allow a board's processor a minute; given by the command line, so that the card is as it was built."""
DEVICES_S = 900
"""Until a disk has to be there: emulated, it took longer than the 45 s that a board's units allow."""


def patient(command_line: str) -> str:
    """A slot's cmdline.txt for the emulated board: its console, and more time than a board's processor needs."""
    dropin = base64.b64encode(PATIENCE.encode()).decode()
    told = [f"systemd.set_credential_binary=systemd.unit-dropin.{unit}.service:{dropin}" for unit in UNITS]
    line = command_line.strip().replace("console=serial0,115200 ", "")
    patience = f"systemd.default_device_timeout_sec={DEVICES_S}"
    return " ".join([line, "console=ttyAMA0", "systemd.show_status=yes", patience, *told])


@dataclass
class VirtualCard:
    """One machine with a copy of an image as its card; entering switches it on, leaving cuts the power.

    folder : its own files: card, console
    key : private half of the image's SSH key
    share : a folder that the guest can mount (9p, tag "share"), or None
    """

    image: Path
    key: Path
    sizes: Sizes
    folder: Path
    card_mib: int
    share: Path | None = None
    ports: dict[int, int] = field(default_factory=dict)

    @property
    def card(self) -> Path:
        """Image of its card."""
        return self.folder / "card.img"

    @property
    def console(self) -> Path:
        """Output of kernel and systemd."""
        return self.folder / "console.log"

    def __enter__(self) -> Self:
        subprocess.run(["cp", "--sparse=always", self.image, self.card], check=True)
        with self.card.open("r+b") as stream:
            stream.truncate(self.card_mib << 20)
        self.ports = {port: free_port() for port in (SSH, PAIRING)}
        self.switch_on()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._qemu.kill()
        self._qemu.wait()

    def read(self, number: int, path: str) -> bytes:
        """Contents of a file on one of its FAT partitions."""
        (part,) = (part for part in partitions(self.sizes) if part.number == number)
        return subprocess.run(
            ["mtype", "-i", f"{self.card}@@{part.offset}", f"::{path}"], capture_output=True, check=True
        ).stdout

    def default_slot(self) -> str:
        """Slot that autoboot.txt names."""
        default = self.read(SELECT_NUMBER, "autoboot.txt").decode().partition("[tryboot]")[0]
        (slot,) = (slot for slot, number in BOOT_NUMBERS.items() if f"boot_partition={number}\n" in default)
        return slot

    def switch_on(self, overlay: str | None = None) -> None:
        """Start it as the firmware would, from the slot that autoboot.txt names.

        overlay : words in place of those that ask for the overlay
        """
        boot = BOOT_NUMBERS[self.default_slot()]
        config = dict(
            line.replace("initramfs ", "initramfs=", 1).split("=", 1)
            for line in self.read(boot, "config.txt").decode().splitlines()
            if line.startswith(("kernel=", "initramfs "))
        )
        for name in ("kernel", "initramfs"):
            (self.folder / name).write_bytes(self.read(boot, config[name]))
        command_line = patient(self.read(boot, "cmdline.txt").decode())
        if overlay:
            command_line = command_line.replace("overlayroot=tmpfs:recurse=0", overlay)
        forwards = ",".join(f"hostfwd=tcp:127.0.0.1:{here}-:{there}" for there, here in self.ports.items())
        command = [
            "nice", "-n", "5", QEMU, "-M", "virt", "-cpu", "max,pauth-impdef=on", "-accel", "tcg,thread=multi",
            "-smp", "2", "-m", str(MEMORY_MIB), "-display", "none", "-monitor", "none", "-no-reboot",
            "-serial", f"file:{self.console}", "-kernel", str(self.folder / "kernel"),
            "-initrd", str(self.folder / "initramfs"),
            "-append", command_line,
            "-drive", f"file={self.card},format=raw,if=virtio,cache=unsafe",
            "-netdev", f"user,id=net,restrict=on,{forwards}", "-device", "virtio-net-pci,netdev=net,romfile=",
            "-device", "virtio-rng-pci",
        ]  # fmt: skip
        if self.share:
            command += ["-virtfs", f"local,path={self.share},mount_tag=share,security_model=none,readonly=on"]
        with (self.folder / "qemu.log").open("wb") as said:
            self._qemu = subprocess.Popen(command, stdout=said, stderr=subprocess.STDOUT)

    def ask(self, script: str, timeout_s: float = LONG_S) -> Answer:
        """Exit code and output of a script, run as root over SSH; code 255 where SSH does not answer."""
        ran = subprocess.run(
            [*self._ssh(), "bash -euo pipefail"],
            input=script, capture_output=True, text=True, timeout=timeout_s, check=False,
        )  # fmt: skip
        return Answer(ran.returncode, ran.stdout + ran.stderr)

    def _ssh(self) -> list[str | Path]:
        options = ("StrictHostKeyChecking=no", "UserKnownHostsFile=/dev/null", "BatchMode=yes", "LogLevel=ERROR")
        return [
            "ssh", "-i", self.key, "-p", str(self.ports[SSH]), *(part for one in options for part in ("-o", one)),
            "-o", "ConnectTimeout=60", "root@127.0.0.1",
        ]  # fmt: skip

    def put(self, folder: Path, into: str) -> None:
        """Copy a folder into a new one of the guest."""
        packed = subprocess.run(["tar", "-C", folder.parent, "-c", folder.name], stdout=subprocess.PIPE, check=True)
        subprocess.run([*self._ssh(), f"mkdir {into} && tar -C {into} -x"], input=packed.stdout, check=True)

    def run(self, script: str, timeout_s: float = LONG_S) -> str:
        """Output of a script.

        Raises
        ------
        GuestError
            It fails.
        """
        answer = self.ask(script, timeout_s)
        if answer.code:
            raise GuestError(f"exit code {answer.code} of\n{script}\n{answer.text}")
        return answer.text

    def wait_for(self, script: str, timeout_s: float = LONG_S) -> str:
        """Run the script every few seconds until it succeeds; returns its output."""
        end = time.monotonic() + timeout_s
        while (answer := self.ask(script)).code:
            if self._qemu.poll() is not None:
                raise GuestError(f"QEMU ended: {(self.folder / 'qemu.log').read_text()}; see {self.console}")
            if time.monotonic() > end:
                raise GuestError(f"not within {timeout_s:g} s:\n{script}\n{answer.text}; see {self.console}")
            time.sleep(5.0)
        return answer.text

    def wait_until_off(self, timeout_s: float = LONG_S) -> None:
        """Wait until the guest has shut down, for a reboot too."""
        self._qemu.wait(timeout_s)

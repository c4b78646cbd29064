"""Layout of the card: its partitions, and the texts by which the firmware, the kernel and systemd find them.

The firmware reads autoboot.txt on the first partition, which names the partition of the slot that is booted, and under
[tryboot] the one that is booted once when a reboot asks for it. Each slot is a boot partition (kernel, initramfs,
firmware) and a root; both slots share the data partition. A slot's boot partition knows its root, so a root is the same
in either slot.

A DOS table, as the boot ROM of a Zero 2 W reads no other: three FAT partitions, then an extended one with ext4.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass

SECTOR = 512
MIB = 1 << 20
SLOTS = ("a", "b")
BOOT_NUMBERS = {"a": 2, "b": 3}
ROOT_NUMBERS = {"a": 5, "b": 6}
SELECT_NUMBER, EXTENDED_NUMBER, DATA_NUMBER = 1, 4, 7
ALIGNMENT_MIB = 4

FAT16, FAT32, EXTENDED, LINUX = "e", "c", "f", "83"


@dataclass(frozen=True)
class Sizes:
    """Sizes in MiB, a boot partition and a root once for each slot; the data partition grows at the first boot."""

    select_mib: int
    boot_mib: int
    root_mib: int
    data_mib: int


@dataclass(frozen=True)
class Partition:
    """One partition: number in the table, DOS type, place in MiB, label of its file system."""

    number: int
    kind: str
    start_mib: int
    size_mib: int
    label: str

    @property
    def offset(self) -> int:
        """Bytes before it."""
        return self.start_mib * MIB


def disk_id(name: str) -> int:
    """Identifier of the disk, 32 bits, from the name of the image: partitions are named by it (PARTUUID)."""
    return int(struct.unpack(">I", hashlib.sha256(name.encode()).digest()[:4])[0]) or 1


def partitions(sizes: Sizes) -> tuple[Partition, ...]:
    """Every partition by its place; one inside the extended partition has its own table before it."""
    at = ALIGNMENT_MIB
    found = []
    for number, kind, size, label in (
        (SELECT_NUMBER, FAT16, sizes.select_mib, "SELECT"),
        (BOOT_NUMBERS["a"], FAT32, sizes.boot_mib, "BOOT-A"),
        (BOOT_NUMBERS["b"], FAT32, sizes.boot_mib, "BOOT-B"),
    ):
        found.append(Partition(number, kind, at, size, label))
        at += size
    logical = []
    extended_at = at
    for number, size, label in (
        (ROOT_NUMBERS["a"], sizes.root_mib, "root-a"),
        (ROOT_NUMBERS["b"], sizes.root_mib, "root-b"),
        (DATA_NUMBER, sizes.data_mib, "retrograph-data"),
    ):
        at += ALIGNMENT_MIB
        logical.append(Partition(number, LINUX, at, size, label))
        at += size
    extended = Partition(EXTENDED_NUMBER, EXTENDED, extended_at, at - extended_at, "")
    return (*found, extended, *logical)


def card_mib(sizes: Sizes) -> int:
    """Size of the image."""
    last = partitions(sizes)[-1]
    return last.start_mib + last.size_mib


def sfdisk_script(sizes: Sizes, name: str) -> str:
    """Partition table as sfdisk takes it."""
    lines = ["label: dos", f"label-id: {disk_id(name):#010x}", "unit: sectors", ""]
    per_mib = MIB // SECTOR
    lines += [
        f"{part.number} : start={part.start_mib * per_mib}, size={part.size_mib * per_mib}, type={part.kind}"
        for part in partitions(sizes)
    ]
    return "\n".join(lines) + "\n"


def partuuid(name: str, number: int) -> str:
    """Name of a partition for kernel and udev."""
    return f"{disk_id(name):08x}-{number:02x}"


def other(slot: str) -> str:
    """Slot beside this one."""
    return SLOTS[1 - SLOTS.index(slot)]


def autoboot(slot: str) -> str:
    """autoboot.txt that boots this slot, and tries the other one when a reboot asks for it."""
    return (
        "[all]\ntryboot_a_b=1\n"
        f"boot_partition={BOOT_NUMBERS[slot]}\n"
        f"[tryboot]\nboot_partition={BOOT_NUMBERS[other(slot)]}\n"
    )


def command_line(name: str, slot: str) -> str:
    """cmdline.txt of a slot: its root, read only under an overlay in memory, and its own boot partition beside it."""
    boot = partuuid(name, BOOT_NUMBERS[slot])
    return (
        f"console=serial0,115200 console=tty1 root=PARTUUID={partuuid(name, ROOT_NUMBERS[slot])} rootfstype=ext4 "
        f"fsck.repair=yes rootwait quiet systemd.mount-extra=PARTUUID={boot}:/boot/firmware:vfat:ro,nofail "
        f"retrograph.slot={slot} overlayroot=tmpfs:recurse=0\n"
    )


FSTAB = "# Root: the kernel's command line. Boot partition: systemd.mount-extra there. Data: data.mount.\n"

"""Build a card's image for a handheld: Debian arm64, everything installed, a read-only root in two slots.

usage: make image BOARD=pi4-imx477-binned        (root, on Debian; `bash .ci/test-deps image` installs the tools)

No loop device and no mounted image: file systems are filled from folders. Mounts are private to one command, so an
interruption leaves none behind. arm64 programs of the packages run under qemu-user, which binfmt_misc must know.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tomllib
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from image_layout import (
    BOOT_NUMBERS,
    DATA_NUMBER,
    FAT16,
    FSTAB,
    MIB,
    ROOT_NUMBERS,
    SELECT_NUMBER,
    Partition,
    Sizes,
    autoboot,
    card_mib,
    command_line,
    partitions,
    sfdisk_script,
)

TREE = Path(__file__).parents[2]
PARTS = TREE / "board" / "image"
TOOLS = (
    "mmdebstrap", "arch-test", "qemu-aarch64-static", "sfdisk", "mkfs.ext4", "mkfs.vfat", "mcopy", "unshare", "dtc",
    "zstd",
)  # fmt: skip
WHEELS = ("manylinux_2_17_aarch64", "manylinux2014_aarch64", "manylinux_2_27_aarch64", "manylinux_2_28_aarch64")
PYTHON_OF = {"bookworm": "3.11", "trixie": "3.13"}
NOT_KEPT = ("/usr/share/man/*", "/usr/share/locale/*", "/usr/share/doc/*")
COPYRIGHT = "/usr/share/doc/*/copyright"
ON_THE_CARD = {
    "retrograph-root": ("usr/local/sbin/retrograph-root", 0o755),
    "grow-data": ("usr/local/lib/retrograph/grow-data", 0o755),
    "retrograph-grow.service": ("etc/systemd/system/retrograph-grow.service", 0o644),
    "retrograph-root.service": ("etc/systemd/system/retrograph-root.service", 0o644),
}
BEFORE_THE_INITRAMFS = {
    PARTS / "machine-id": "etc/initramfs-tools/scripts/init-bottom/retrograph-machine-id",
    PARTS.parent / "initramfs" / "modules": "usr/share/initramfs-tools/modules.d/retrograph",
}
CONFIG_OF_RASPBERRY_PI = "arm_64bit=1\nauto_initramfs=1\ndtoverlay=vc4-kms-v3d\n"
"""Where the packages write no config.txt, as those of Raspberry Pi OS do not."""


class BuildError(RuntimeError):
    """The image cannot be built, with the reason."""


def call(*command: str | Path, text: str | None = None, **environment: str) -> None:
    """Run a command; what it prints is shown.

    Raises
    ------
    BuildError
        It fails.
    """
    ran = subprocess.run(command, input=text, text=True, env={**os.environ, **environment}, check=False)
    if ran.returncode:
        raise BuildError(f"{' '.join(map(str, command[:3]))} ... ended with {ran.returncode}")


def facts() -> dict[str, Any]:
    """board/image/image.toml."""
    return tomllib.loads((PARTS / "image.toml").read_text(encoding="utf-8"))


def packages(known: dict[str, Any], sources: Path | None) -> list[str]:
    """Debian packages of an image, sorted; with `sources`, those that Debian does not have too."""
    wanted = set(known["debian"]["packages"])
    if sources:
        wanted -= set(known["raspberry_pi"]["instead_of"])
        wanted |= set(known["raspberry_pi"]["packages"])
    return sorted(wanted)


def mirrors(snapshot: str, release: str, components: Sequence[str]) -> list[str]:
    """Sources of apt: of a day in the past where `snapshot` (20251115T000000Z) names one."""
    if not snapshot:
        return []
    place = f"[check-valid-until=no] http://snapshot.debian.org/archive/debian/{snapshot}/"
    return [f"deb {place} {release} {' '.join(components)}"]


def bootstrap_command(target: Path, sources: Path | None, snapshot: str) -> list[str]:
    """mmdebstrap's command for the root of an image, before anything of this project is in it."""
    known = facts()
    release, components = known["debian"]["release"], known["debian"]["components"]
    command = ["mmdebstrap", "--mode=root", "--architectures=arm64", "--variant=minbase"]
    command += [f"--components={','.join(components)}", '--aptopt=APT::Install-Recommends "false"']
    command += [f"--dpkgopt=path-exclude={path}" for path in NOT_KEPT] + [f"--dpkgopt=path-include={COPYRIGHT}"]
    for source, place in BEFORE_THE_INITRAMFS.items():
        mode = "755" if os.access(source, os.X_OK) else "644"
        command.append(f'--essential-hook=install -D -m {mode} "{source}" "$1/{place}"')
    if sources:
        command.append(f'--setup-hook=install -m 644 "{sources}" "$1/etc/apt/sources.list.d/more.sources"')
    command += [f"--include={','.join(packages(known, sources))}", release, str(target)]
    return command + mirrors(snapshot, release, components)


def debian(cache: Path, sources: Path | None, snapshot: str) -> Path:
    """Archive of the bootstrapped root, kept under a name made of what it depends on."""
    target, new = cache / "debian.tar.zst", cache / "new.tar.zst"
    command = bootstrap_command(new, sources, snapshot)
    hooks = "".join(source.read_text(encoding="utf-8") for source in BEFORE_THE_INITRAMFS)
    more = sources.read_text(encoding="utf-8") if sources else ""
    made_of = hashlib.sha256("\0".join([*command, hooks, more]).replace(str(TREE), "").encode()).hexdigest()
    named = cache / "debian.made-of"
    if target.exists() and named.exists() and named.read_text(encoding="utf-8") == made_of:
        print("image: Debian kept", flush=True)
        return target
    call(*command)
    named.unlink(missing_ok=True)
    new.replace(target)
    named.write_text(made_of, encoding="utf-8")
    return target


def download_wheels(folder: Path, release: str) -> None:
    """The locked packages for aarch64, by hash, into a folder that is filled once for a lock."""
    lock = TREE / "requirements-device.lock"
    mark = folder / "of"
    made_of = hashlib.sha256(lock.read_bytes()).hexdigest() + f" {PYTHON_OF[release]}"
    if mark.exists() and mark.read_text(encoding="utf-8") == made_of:
        return
    shutil.rmtree(folder, ignore_errors=True)
    call(
        sys.executable, "-m", "pip", "download", "--quiet", "--require-hashes", "--no-deps", "--only-binary", ":all:",
        "--python-version", PYTHON_OF[release], *(part for name in WHEELS for part in ("--platform", name)),
        "-r", lock, "-d", folder / "wheels",
    )  # fmt: skip
    mark.write_text(made_of, encoding="utf-8")


IN_ROOT = r"""
set -euo pipefail
root=$1 release=$2 wheels=$3
mount --bind /proc "$root/proc"
mount --bind /dev "$root/dev"
mount -t tmpfs tmpfs "$root/run"
mount -t tmpfs tmpfs "$root/mnt"
mkdir "$root/mnt/release"
cp -rP "$release/." "$root/mnt/release/"
mkdir -p "$root/mnt/wheels"
mount --bind "$wheels" "$root/mnt/wheels"
chroot "$root" env PIP_NO_INDEX=1 PIP_FIND_LINKS=/mnt/wheels SOURCE_DATE_EPOCH="$SOURCE_DATE_EPOCH" \
    bash /mnt/release/board/retrograph-slot install /mnt/release --skip-selftest
chroot "$root" chown -R retroscan:retroscan /data/store /data/pairing
chroot "$root" usermod -p '*' retrosync
chroot "$root" bash -c 'bash /mnt/release/board/initramfs/check - /boot/initrd.img-* /boot/firmware/init*'
chroot "$root" dpkg-query -W -f '${Package} ${Version}\n' >"$4"
"""
"""Within private mounts: program into its slot, owners, overlay in every initramfs, list of packages."""


def lacking(root: Path, profile: dict[str, Any]) -> list[str]:
    """Files that a real board's profile needs and this root lacks: firmware's tool, camera's IPA module and tuning."""
    if profile["driver"] != "picamera2":
        return []
    pipeline = "pisp" if profile["button"]["chip_label"] == "pinctrl-rp1" else "vc4"
    wanted = [
        f"usr/lib/*/libcamera/**/ipa_rpi_{pipeline}.so",
        f"usr/share/libcamera/ipa/rpi/{pipeline}/{profile['sensor']['model'].lower()}.json",
        f"boot/firmware/kernel{(kernel := '_2712' if pipeline == 'pisp' else '8')}.img",
        f"boot/firmware/initramfs{kernel}",
    ]
    if profile["power"]["throttled"] == "vcgencmd":
        wanted.append("usr/bin/vcgencmd")
    return [name for name in wanted if not any(root.glob(name))]


def furnish(root: Path, options: argparse.Namespace, release: Path, wheels: Path) -> None:
    """Everything of this project into the root, by install.sh and by what belongs to an image alone."""
    boot = root / "boot" / "firmware"
    (boot / "overlays").mkdir(parents=True, exist_ok=True)
    if not (boot / "config.txt").exists():
        (boot / "config.txt").write_text(CONFIG_OF_RASPBERRY_PI, encoding="utf-8")
    (boot / "cmdline.txt").write_text(command_line(options.name, "a"), encoding="utf-8")
    (root / "etc" / "fstab").write_text(FSTAB, encoding="utf-8")
    # A name that install.sh takes for none: each device makes one of its own at its first boot.
    (root / "etc" / "hostname").write_text("localhost\n", encoding="utf-8")
    (root / "etc" / "machine-id").write_text("", encoding="utf-8")
    for folder in ("etc", "var"):
        (root / folder / ".updated").touch()  # else each boot of a read-only root rebuilds what packages have built
    for key in (root / "etc" / "ssh").glob("ssh_host_*"):
        key.unlink()
    installer = release / "board" / "install.sh"
    wishes = ("--no-app", "--read-only", *options.install.split())
    call("bash", installer, "--root", root, "--board", options.board, *wishes)
    for name, (place, mode) in ON_THE_CARD.items():
        target = root / place
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(PARTS / name, target)
        target.chmod(mode)
    call("systemctl", f"--root={root}", "--quiet", "enable", "retrograph-grow.service", "retrograph-root.service")
    if options.network:
        target = root / "data" / "network" / options.network.name
        shutil.copyfile(options.network, target)
        target.chmod(0o600)
    if options.ssh_key:
        let_in(root, options.ssh_key)
    listed = options.output.with_suffix(".packages")
    call("unshare", "--mount", "bash", "-c", IN_ROOT, "in-root", root, release, wheels / "wheels", listed)


def let_in(root: Path, key: Path) -> None:
    """Root may come in over SSH with this key, and nobody by a password; without it only files can be fetched."""
    place = root / "root" / ".ssh"
    place.mkdir(mode=0o700, exist_ok=True)
    shutil.copyfile(key, place / "authorized_keys")
    (place / "authorized_keys").chmod(0o600)


def place(image: Path, part: Partition, filled: Path) -> None:
    """Copy a file system to its place; what is zero stays a hole."""
    call(
        "dd", f"if={filled}", f"of={image}", f"bs={MIB}", f"seek={part.start_mib}", "conv=notrunc,sparse", "status=none"
    )
    filled.unlink()


def make_fat(target: Path, part: Partition, folder: Path, epoch: int) -> None:
    """FAT file system with the contents of a folder; its serial number and times come from `epoch`."""
    with target.open("wb") as stream:
        stream.truncate(part.size_mib * MIB)
    bits = "16" if part.kind == FAT16 else "32"
    serial = f"{(epoch + part.number) & 0xFFFFFFFF:08x}"
    call("mkfs.vfat", "--invariant", "-F", bits, "-n", part.label, "-i", serial, target)
    for path in sorted(folder.iterdir()):
        call("mcopy", "-s", "-m", "-i", target, path, "::", MTOOLS_SKIP_CHECK="1", SOURCE_DATE_EPOCH=str(epoch))


def make_ext4(target: Path, part: Partition, folder: Path, epoch: int) -> None:
    """ext4 file system with the contents of a folder, owners and modes as they are there.

    The inodes' change times are those of the folder's files, unless e2fsprogs takes SOURCE_DATE_EPOCH (from 1.47.1 on).
    """
    with target.open("wb") as stream:
        stream.truncate(part.size_mib * MIB)
    identifier = str(uuid.uuid5(uuid.NAMESPACE_URL, f"{part.label} {epoch}"))
    call(
        "mkfs.ext4", "-q", "-F", "-m", "1", "-L", part.label, "-U", identifier,
        "-E", f"hash_seed={identifier},lazy_itable_init=0,lazy_journal_init=0", "-d", folder, target,
        E2FSPROGS_FAKE_TIME=str(epoch),
    )  # fmt: skip


def select_folder(scratch: Path, boot: Path) -> Path:
    """First partition: which slot is booted. Boards before the Pi 4 read bootcode.bin here, and only here."""
    folder = scratch / "select"
    folder.mkdir()
    (folder / "autoboot.txt").write_text(autoboot("a"), encoding="ascii")
    # Firmware takes a FAT partition without it for no bootable one.
    (folder / "config.txt").write_text("# Empty: autoboot.txt names the partition that is booted.\n", encoding="ascii")
    if (boot / "bootcode.bin").exists():
        shutil.copyfile(boot / "bootcode.bin", folder / "bootcode.bin")
    return folder


def assemble(
    root: Path, image: Path, sizes: Sizes, name: str, epoch: int, scratch: Path, update: Path | None = None
) -> None:
    """Image of a card from a furnished root; slot b is left without file systems, for the first update fills it.

    update : folder for the two file systems of a slot, compressed, as retrograph-root installs them on another card
    """
    by_number = {part.number: part for part in partitions(sizes)}
    with image.open("wb") as stream:
        stream.truncate(card_mib(sizes) * MIB)
    call("sfdisk", "--quiet", image, text=sfdisk_script(sizes, name))
    boot, data, filled = root / "boot" / "firmware", root / "data", scratch / "filled"
    for number, folder, make in (
        (SELECT_NUMBER, select_folder(scratch, boot), make_fat),
        (BOOT_NUMBERS["a"], boot, make_fat),
        (DATA_NUMBER, data, make_ext4),
    ):
        make(filled, by_number[number], folder, epoch)
        if update and number in BOOT_NUMBERS.values():
            call("zstd", "-q", "-f", "-T0", filled, "-o", update / "boot.img.zst")
        place(image, by_number[number], filled)
    for folder in (boot, data):
        shutil.rmtree(folder)
        folder.mkdir(mode=0o755)
    make_ext4(filled, by_number[ROOT_NUMBERS["a"]], root, epoch)
    if update:
        call("zstd", "-q", "-f", "-T0", filled, "-o", update / "root.img.zst")
    place(image, by_number[ROOT_NUMBERS["a"]], filled)


def check(options: argparse.Namespace) -> None:
    """Refuse before anything is made.

    Raises
    ------
    BuildError
        A tool, a file or root's rights are missing.
    """
    path = f"{os.environ['PATH']}:/usr/sbin:/sbin"
    if missing := [tool for tool in TOOLS if shutil.which(tool, path=path) is None]:
        raise BuildError(f"not installed: {', '.join(missing)} (bash .ci/test-deps image)")
    if os.geteuid() != 0:
        raise BuildError("this needs root, as files on the card have owners")
    if not (TREE / "board" / f"{options.board}.toml").exists():
        names = " ".join(sorted(profile.stem for profile in (TREE / "board").glob("*.toml")))
        raise BuildError(f"there is no board profile {options.board!r}: {names}")
    if not Path("/proc/sys/fs/binfmt_misc/qemu-aarch64").exists():
        raise BuildError(
            "the kernel does not run arm64 programs: mount binfmt_misc, then update-binfmts --enable qemu-aarch64"
        )
    for file in (options.ssh_key, options.network, options.sources):
        if file and not file.is_file():
            raise BuildError(f"{file}: is no file")


def build(options: argparse.Namespace) -> None:
    """Make the image that the options describe."""
    check(options)
    known = facts()
    profile = tomllib.loads((TREE / "board" / f"{options.board}.toml").read_text(encoding="utf-8"))
    options.cache.mkdir(parents=True, exist_ok=True)
    release, root, scratch = TREE / "dist" / "release", options.cache / "root", options.cache / "scratch"
    archive = debian(options.cache, options.sources, options.snapshot)
    download_wheels(options.cache / "wheels", known["debian"]["release"])
    for folder in (root, scratch):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
    options.output.parent.mkdir(parents=True, exist_ok=True)
    try:
        call("tar", "--extract", "--file", archive, "--directory", root, "--numeric-owner", "--xattrs", "--zstd")
        if options.sources and (missing := lacking(root, profile)):
            raise BuildError(f"{options.sources}: what it lists lacks {', '.join(missing)}")
        furnish(root, options, release, options.cache / "wheels")
        if options.update:
            options.update.mkdir(parents=True, exist_ok=True)
        assemble(root, options.output, Sizes(**known["sizes"]), options.name, options.epoch, scratch, options.update)
    finally:
        for folder in (root, scratch):
            shutil.rmtree(folder, ignore_errors=True)
    size = options.output.stat()
    print(f"{options.output}: {size.st_size >> 20} MiB, {size.st_blocks * 512 >> 20} of them written", flush=True)
    if profile["driver"] == "picamera2" and not options.sources:
        print("no SOURCES=FILE: Debian has neither picamera2 nor every sensor's driver: the camera is out of order")


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Options of the command line; the time is SOURCE_DATE_EPOCH's."""
    parser = argparse.ArgumentParser(description="Build the image of a handheld's card.")
    parser.add_argument("--board", required=True, help="board profile")
    parser.add_argument("--cache", type=Path, required=True, help="folder for what is kept between builds")
    parser.add_argument("--output", type=Path, required=True, help="the image")
    parser.add_argument("--install", default="", help="more wishes for install.sh, such as '--usb --screen panel'")
    parser.add_argument("--sources", type=Path, help="an apt source that has what Debian has not (deb822)")
    parser.add_argument("--snapshot", default="", help="day of the Debian archive, such as 20251115T000000Z")
    parser.add_argument("--ssh-key", type=Path, help="public key with which root may come in")
    parser.add_argument("--network", type=Path, help="a network's .nmconnection file")
    parser.add_argument("--update", type=Path, help="folder for the two file systems that retrograph-root installs")
    options = parser.parse_args(arguments)
    options.name = f"retrograph-{options.board}"
    options.epoch = int(os.environ["SOURCE_DATE_EPOCH"])
    return options


if __name__ == "__main__":
    try:
        build(parse(sys.argv[1:]))
    except BuildError as error:
        sys.exit(f"image: {error}")

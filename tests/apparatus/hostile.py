"""What a hostile or broken card can hold, one harm at a time: each is done to a store with three scans.

`HARMS` maps a name to a function that gets the victim: the scan to spoil, and a folder outside that nobody may touch.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import tifffile

from device.bundles.record import checksum_name, describe_file, manifest_checksum

MANIFEST = "scan.json"
NAMES = ("raw.tif", "preview.png", MANIFEST, checksum_name(MANIFEST))


@dataclass(frozen=True)
class Victim:
    """A store, one scan of it, and a folder outside that holds a file of the user."""

    store: Path
    scan: Path
    outside: Path

    @property
    def secret(self) -> Path:
        return self.outside / "authorized_keys"


Harm = Callable[[Victim], None]


def remove(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink(missing_ok=True)


def reseal(scan: Path, data: bytes) -> None:
    """Write a manifest with the checksum that fits it."""
    for name, content in ((MANIFEST, data), (checksum_name(MANIFEST), manifest_checksum(MANIFEST, data))):
        remove(scan / name)
        (scan / name).write_bytes(content)


def edited(change: Callable[[dict[str, Any]], object]) -> Harm:
    """The manifest with a change, sealed as if it were honest."""

    def harm(victim: Victim) -> None:
        record = json.loads((victim.scan / MANIFEST).read_bytes())
        change(record)
        reseal(victim.scan, json.dumps(record).encode("utf-8", "surrogatepass"))

    return harm


def listed(victim: Victim, name: str, data: bytes) -> None:
    """A file of the scan with other content that the manifest lists: the transfer has nothing to complain of."""
    remove(victim.scan / name)
    (victim.scan / name).write_bytes(data)
    entry = describe_file(victim.scan / name)
    edited(lambda r: r["files"].update({name: {"sha256": entry.sha256, "size": entry.size}}))(victim)


def spoilers(name: str) -> dict[str, Harm]:
    """Everything that can stand in the place of a file."""

    def place(make: Callable[[Path, Victim], object]) -> Harm:
        def harm(victim: Victim) -> None:
            remove(victim.scan / name)
            make(victim.scan / name, victim)

        return harm

    def full_folder(path: Path, _: Victim) -> None:
        path.mkdir()
        (path / "more").write_bytes(b"x")

    def listening(path: Path, _: Victim) -> None:
        with socket.socket(socket.AF_UNIX) as one:
            here = os.open(path.parent, os.O_RDONLY)
            try:  # the name of a socket may have no more than some hundred characters
                one.bind(f"/proc/self/fd/{here}/{path.name}")
            finally:
                os.close(here)

    def sparse(path: Path, _: Victim) -> None:
        with path.open("wb") as stream:
            stream.truncate(1 << 34)

    def link_in_bundle(path: Path, victim: Victim) -> None:
        path.symlink_to("preview.png" if name == "raw.tif" else "raw.tif")

    kinds: dict[str, Callable[[Path, Victim], object]] = {
        "a link to a file of the user": lambda path, victim: path.symlink_to(victim.secret),
        "a link into the bundle": link_in_bundle,
        "a dangling link": lambda path, victim: path.symlink_to(victim.outside / "not-there"),
        "a link to itself": lambda path, _: path.symlink_to(path.name),
        "a link to an endless file": lambda path, _: path.symlink_to("/dev/zero"),
        "an empty folder": lambda path, _: path.mkdir(),
        "a full folder": full_folder,
        "a pipe": lambda path, _: os.mkfifo(path),
        "a socket": listening,
        "absent": lambda *_: None,
        "empty": lambda path, _: path.touch(),
        "a sparse file of 16 GB": sparse,
    }
    if os.geteuid() == 0:
        kinds["an endless device"] = lambda path, _: os.mknod(path, 0o644 | 0o020000, os.makedev(1, 5))
    return {f"{name} is {what}": place(make) for what, make in kinds.items()}


def numbers() -> dict[str, Harm]:
    """Values out of every range, sealed as if they were honest."""
    huge = (1 << 53, 1 << 63, 1 << 64, 10**400, -1, -(1 << 63), 1.5, "7", None, [], {}, True)
    found = {f"counter {str(value)[:24]}": edited(lambda r, v=value: r["identity"].update(counter=v)) for value in huge}
    for value in (1 << 63, -(1 << 63) - 1, 1e30, "0"):
        found[f"monotonic_ns {value}"] = edited(lambda r, v=value: r["identity"].update(monotonic_ns=v))
    for value in (0, -1, 1e300, float("inf"), float("nan"), "2 ms", None, 10**400):
        name = str(value)[:24]
        found[f"exposure {name}"] = edited(lambda r, v=value: r["granted"].update(exposure_us=v))
        found[f"pitch {name}"] = edited(lambda r, v=value: r.update(pixel_pitch_um=v))
    for shape in (
        [0, 0],
        [-1, 2],
        [65536, 65536],
        [1 << 31, 1 << 31],
        [16384, 16384],
        [32],
        [32, 48, 3],
        "32x48",
        None,
    ):
        found[f"shape {shape}"] = edited(lambda r, v=shape: r.update(shape=v))
    times = (
        "0001-01-01T00:00:00+23:59",
        "0001-01-01T00:00:00Z",
        "9999-12-31T23:59:59-23:59",
        "9999-12-31T23:59:59Z",
        "1899-12-31T23:59:59Z",
        "3000-01-01T00:00:00Z",
        "2026-11-22T10:00:00",
        "2026-13-45T99:99:99Z",
        "",
        "9" * 10_000,
        0,
        None,
    )
    for time in times:
        found[f"wall time {str(time)[:30]!r}"] = edited(lambda r, v=time: r.update(wall_time=v))
    for size in (-1, (1 << 40) + 1, 1 << 63, 1 << 40, 10**400, "5", None):
        found[f"file of {str(size)[:24]} bytes"] = edited(lambda r, v=size: r["files"]["preview.png"].update(size=v))
        found[f"frame of {str(size)[:24]} bytes"] = edited(lambda r, v=size: r["files"]["raw.tif"].update(size=v))
    return found


def names() -> dict[str, Harm]:
    """Names that lead elsewhere, move a terminal or exhaust memory."""
    bad = (
        "../../../outside/authorized_keys", "/etc/passwd", ".", "..", "a/b", "a\0b", "raw.tif\n", "raw.tif ", "é",
        "RAW.TIF", "x" * 101, "", "-", "\x1b[2J", "\ud800", "results", "scan.json", "..%2fx",
    )  # fmt: skip
    found = {
        f"lists {name[:30]!r}": edited(lambda r, n=name: r["files"].update({n: r["files"]["preview.png"]}))
        for name in bad
        if name not in ("results", "scan.json")
    }
    for name in bad:
        found[f"raw file {name[:30]!r}"] = edited(lambda r, n=name: r.update(raw_file=n))
        found[f"id {name[:30]!r}"] = edited(lambda r, n=name: r["identity"].update(id=n))
    for name in ("../up", "A", "x" * 101, "\n", "", 7, "\ud800"):
        found[f"calibration {name!r:.30}"] = edited(lambda r, n=name: r.update(calibration_id=n))
    found["lists 2000 files"] = edited(
        lambda r: r["files"].update({f"f{i}": r["files"]["preview.png"] for i in range(2000)})
    )
    found["1001 currents"] = edited(lambda r: r["currents_ma"].update({f"l{i}": 1.0 for i in range(1001)}))
    found["a note of a megabyte"] = edited(lambda r: r["annotations"].update(note="x" * 1_000_000))
    found["a job with a lone surrogate"] = edited(lambda r: r["annotations"].update(job="\ud800"))
    found["figures of 1e308"] = edited(lambda r: r["verdict"].update(figures={"a": 1e308}))
    found["a bitmap for a verdict"] = edited(lambda r: r.update(verdict=[0] * 1000))
    found["an unknown key"] = edited(lambda r: r.update(colour="red"))
    found["another schema"] = edited(lambda r: r.update(schema="retrograph.scan/99"))
    found["a schema that moves the terminal"] = edited(lambda r: r.update(schema="\x1b]0;owned\x07" * 1000))
    found["a calibration's schema"] = edited(lambda r: r.update(schema="retrograph.calibration/1"))
    found["no lights"] = edited(lambda r: r["fingerprint"].update(lights=[]))
    found["a light beyond the moon"] = edited(lambda r: r["fingerprint"]["lights"][0].update(position_mm=[1e300, 0, 0]))
    return found


def manifests() -> dict[str, Harm]:
    """Bytes that are no manifest, and checksum files that are none."""

    def sealed(data: Callable[[bytes], bytes]) -> Harm:
        return lambda victim: reseal(victim.scan, data((victim.scan / MANIFEST).read_bytes()))

    def checksum(data: Callable[[bytes], bytes]) -> Harm:
        def harm(victim: Victim) -> None:
            path = victim.scan / checksum_name(MANIFEST)
            path.write_bytes(data(path.read_bytes()))

        return harm

    found = {f"manifest cut at {part}/12": sealed(lambda d, p=part: d[: len(d) * p // 12]) for part in range(12)}
    found |= {
        "manifest of 100,000 brackets": sealed(lambda _: b"[" * 100_000),
        "manifest nested in itself": sealed(lambda d: b'{"a":' * 50_000 + d),
        "manifest with a byte order mark": sealed(lambda d: b"\xef\xbb\xbf" + d),
        "manifest in UTF-16": sealed(lambda d: d.decode().encode("utf-16")),
        "manifest of zeros": sealed(lambda d: b"\0" * len(d)),
        "manifest of 5 MB": sealed(lambda d: d + b" " * (5 << 20)),
        "manifest null": sealed(lambda _: b"null"),
        "manifest twice": sealed(lambda d: d + d),
        "manifest with a broken text": sealed(lambda d: d.replace(b"J-7", b"\xff\xfe")),
        "checksum of 5 MB": checksum(lambda d: d + b" " * (5 << 20)),
        "checksum twice": checksum(lambda d: d + d),
        "checksum in capitals": checksum(bytes.upper),
        "checksum of another file": checksum(lambda d: d.replace(b"scan.json", b"raw.tif")),
        "checksum of nothing": checksum(lambda _: b""),
    }
    return found


def entries() -> dict[str, Harm]:
    """What lies beside the bundles, and in the place of the card's folders."""

    def beside(name: bytes, make: Callable[[Path, Victim], object]) -> Harm:
        return lambda victim: make(victim.scan.parent / os.fsdecode(name), victim)

    def instead(make: Callable[[Path, Victim], object]) -> Harm:
        def harm(victim: Victim) -> None:
            remove(victim.scan)
            make(victim.scan, victim)

        return harm

    def folder(name: str, make: Callable[[Path, Victim], object]) -> Harm:
        def harm(victim: Victim) -> None:
            remove(victim.store / name)
            make(victim.store / name, victim)

        return harm

    def receipt(name: str, make: Callable[[Path, Victim], object]) -> Harm:
        return lambda victim: make(victim.store / "receipts" / name.replace("ID", victim.scan.name), victim)

    def to_secret(path: Path, victim: Victim) -> None:
        path.symlink_to(victim.secret)

    def to_outside(path: Path, victim: Victim) -> None:
        path.symlink_to(victim.outside)

    def renamed(victim: Victim) -> None:
        victim.scan.rename(victim.scan.with_name("another-name"))

    found = {
        "a name that is not UTF-8": beside(b"caf\xe9", lambda path, _: path.mkdir()),
        "a file whose name is not UTF-8": beside(b"caf\xe9", lambda path, _: os.mkfifo(path)),
        "a name that moves the terminal": beside(b"\x1b[2J", lambda path, _: path.mkdir()),
        "a folder in capitals": beside(b"BACKUP", lambda path, _: path.mkdir()),
        "a name of 250 letters": beside(b"x" * 250, lambda path, _: path.mkdir()),
        "a linked bundle": beside(b"linked-1", lambda path, victim: path.symlink_to(victim.scan)),
        "a link to the user's folder": beside(b"linked-2", lambda path, victim: path.symlink_to(victim.outside)),
        "a link to itself": beside(b"loop-1", lambda path, _: path.symlink_to("loop-1")),
        "a pipe named like a bundle": beside(b"pipe-1", lambda path, _: os.mkfifo(path)),
        "an empty bundle": beside(b"empty-1", lambda path, _: path.mkdir()),
        "a bundle that is a file": instead(lambda path, _: path.touch()),
        "a bundle that is a pipe": instead(lambda path, _: os.mkfifo(path)),
        "a bundle that is a link": instead(to_outside),
        "a bundle that is a link to itself": instead(lambda path, _: path.symlink_to(path.name)),
        "a bundle under another name": renamed,
        "calibrations is a file": folder("calibrations", lambda path, _: path.touch()),
        "calibrations is a pipe": folder("calibrations", lambda path, _: os.mkfifo(path)),
        "calibrations is a link": folder("calibrations", to_outside),
        "calibrations is a link to itself": folder("calibrations", lambda path, _: path.symlink_to(path.name)),
        "receipts is a file": folder("receipts", lambda path, _: path.touch()),
        "receipts is a pipe": folder("receipts", lambda path, _: os.mkfifo(path)),
        "receipts is a link": folder("receipts", to_outside),
        "receipts is a link to itself": folder("receipts", lambda path, _: path.symlink_to(path.name)),
        "a receipt that is a folder": receipt("ID.json", lambda path, _: path.mkdir()),
    }
    quiet = {
        "a partial receipt that is a link": receipt(".ID.json.part", to_secret),
        "a partial receipt that is a pipe": receipt(".ID.json.part", lambda path, _: os.mkfifo(path)),
        "a receipt that is a link": receipt("ID.json", to_secret),
        "a receipt that is a pipe": receipt("ID.json", lambda path, _: os.mkfifo(path)),
        "a receipt of zeros": receipt("ID.json", lambda path, _: path.write_bytes(bytes(100))),
        "a file manager's file": lambda victim: (victim.scan.parent / "Thumbs.db").touch(),
        "a hidden folder": lambda victim: (victim.scan.parent / ".Trashes").mkdir(),
    }
    QUIET.update(quiet)
    return found | quiet


QUIET: set[str] = set()
"""Harms that concern nobody: everything is pulled, exit code 0."""


class Tiff:
    """A raw frame's file and its spoiled kin: the bundle is in order, its frame is not."""

    def __init__(self, honest: bytes) -> None:
        self.honest = honest
        with tifffile.TiffFile(BytesIO(honest)) as tiff:
            self.header = json.loads(tiff.pages.first.description)
            self.planes = tiff.asarray()

    def written(self, planes: np.ndarray, header: dict[str, Any] | str | None = None, **options: Any) -> bytes:
        stream = BytesIO()
        header = self.header if header is None else header
        options = {"compression": "zstd", "photometric": "minisblack", "metadata": None, "maxworkers": 1} | options
        text = header if isinstance(header, str) else json.dumps(header)
        tifffile.imwrite(stream, planes, description=text, byteorder="<", **options)
        return stream.getvalue()

    def all(self) -> dict[str, bytes]:
        header, planes, honest = self.header, self.planes, self.honest
        dark = np.zeros((4, 8192, 8192), np.uint16)
        found = {
            "16384² that is all zero": self.written(dark, header | {"rows": 16384, "columns": 16384}),
            "8192² pages under a small header": self.written(dark),
            "a small page under a header of 16384²": self.written(planes, header | {"rows": 16384, "columns": 16384}),
            "strips that unpack to a gigabyte": zstd_bomb(honest),
            "float planes": self.written(planes.astype(np.float32)),
            "8-bit planes": self.written(planes.astype(np.uint8)),
            "RGB": self.written(np.moveaxis(planes[:3], 0, -1).copy(), photometric="rgb"),
            "LZW": self.written(planes, compression="lzw"),
            "not compressed": self.written(planes, compression=None),
            "BigTIFF cut short": self.written(planes, bigtiff=True)[:200],
            "three pages": self.written(planes[:3]),
            "a thousand pages": self.written(np.repeat(planes[:1], 1000, axis=0)),
            "no description": self.written(planes, ""),
            "a description that is no JSON": self.written(planes, "x" * 100),
            "a description of a megabyte": self.written(planes, "[" * 1_000_000),
            "another CRC": self.written(planes, header | {"crc32": 1}),
            "an odd size": self.written(planes, header | {"rows": 33}),
            "a size below zero": self.written(planes, header | {"rows": -32}),
            "a time stamp of 2^64": self.written(planes, header | {"sensor_timestamp_ns": 1 << 64}),
            "a level of 1e308": self.written(planes, header | {"white_level_dn": 1e308}),
            "a page that names itself as the next": looped(honest),
            "nothing": b"",
            "text": b"II*\0" + b"hello" * 50,
            "offsets beyond the end": honest[:4] + struct.pack("<I", 0xFFFFFFF0) + honest[8:],
        }
        found |= {f"cut at {part}/8": honest[: len(honest) * part // 8] for part in range(1, 8)}
        return found


def looped(tiff: bytes) -> bytes:
    """Its first directory is also the next one."""
    first = struct.unpack("<I", tiff[4:8])[0]
    at = first + 2 + 12 * struct.unpack("<H", tiff[first : first + 2])[0]
    return tiff[:at] + struct.pack("<I", first) + tiff[at + 4 :]


def zstd_bomb(tiff: bytes) -> bytes:
    """Its first strip is replaced by zstd's form of a gigabyte of zeros, at the file's end."""
    bomb = imagecodecs.zstd_encode(bytes(1 << 24), 1) * 64
    with tifffile.TiffFile(BytesIO(tiff)) as opened:
        page = opened.pages.first
        places = {name: page.tags[name].valueoffset for name in ("StripOffsets", "StripByteCounts")}
        types = {name: page.tags[name].dtype for name in places}
    changed = bytearray(tiff + bomb)
    for name, value in (("StripOffsets", len(tiff)), ("StripByteCounts", len(bomb))):
        form = {3: "<H", 4: "<I", 16: "<Q"}[int(types[name])]
        if form == "<H":
            value = min(value, 0xFFFF)
        struct.pack_into(form, changed, places[name], value)
    return bytes(changed)


SPOILED_BUNDLES: dict[str, Harm] = {
    **{what: harm for name in NAMES for what, harm in spoilers(name).items()},
    **numbers(),
    **names(),
    **manifests(),
}
"""Harms to the scan itself."""

HARMS: dict[str, Harm] = {**SPOILED_BUNDLES, **entries()}

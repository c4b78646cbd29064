from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from device.bundles.calibration import CalibrationBundle, read_calibration
from device.bundles.record import encode_record, manifest_checksum
from device.bundles.scan import ScanBundle, decode_scan, read_scan
from device.errors import DeviceError, RecordError
from device.store.store import BundleStore
from hal.frame import RawFrame
from tests.apparatus.schemas import schema_bytes, schemas

PublishScan = Callable[..., ScanBundle]
PublishCalibration = Callable[[BundleStore], CalibrationBundle]
SCHEMAS = Path(__file__).parents[3] / "docs" / "schemas"


def rewrite(bundle: ScanBundle, change: Callable[[dict], None]) -> Path:
    """Change a manifest and seal it again, as a newer or foreign program might have written it."""
    path = bundle.directory / "scan.json"
    content = json.loads(path.read_bytes())
    change(content)
    data = json.dumps(content).encode()
    path.write_bytes(data)
    (bundle.directory / "scan.json.sha256").write_bytes(manifest_checksum("scan.json", data))
    return bundle.directory


def test_a_scan_comes_back_as_it_was(
    store: BundleStore, publish_scan: PublishScan, raw_frame: Callable[..., RawFrame]
) -> None:
    published = publish_scan(store)
    back = read_scan(published.directory)
    assert back == published
    assert back.record.annotations.job == "J-7"
    assert back.record.verdict.figures == {"contact_share": 0.4}
    assert set(back.record.files) == {"raw.tif", "preview.png"}
    assert np.array_equal(back.raw_frame().mosaic, raw_frame(back.record.identity.counter).mosaic)
    back.verify()


def test_the_manifest_begins_with_its_version_and_its_seal_suits_sha256sum(
    store: BundleStore, publish_scan: PublishScan
) -> None:
    directory = publish_scan(store).directory
    assert next(iter(json.loads((directory / "scan.json").read_bytes()))) == "schema"
    if shutil.which("sha256sum"):
        subprocess.run(["sha256sum", "-c", "scan.json.sha256"], cwd=directory, check=True, capture_output=True)


def test_a_calibration_comes_back_as_it_was(
    store: BundleStore, publish_calibration: PublishCalibration, raw_frame: Callable[..., RawFrame]
) -> None:
    back = read_calibration(publish_calibration(store).directory)
    assert back.record.presses[0].balls[0].ball.contact_radius_px == 6.0
    assert back.record.figures == {"held_out_deg": 0.9, "spread_deg": None}
    assert np.array_equal(back.reference().mosaic, raw_frame(100).mosaic)
    assert np.array_equal(back.press_frame(back.record.presses[0]).mosaic, raw_frame(101).mosaic)
    with np.load(back.path("model.npz")) as model:
        assert model["coefficients"].shape == (3,)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda r: r.update(schema="retrograph.scan/9"), "'retrograph.scan/9', this program reads 'retrograph.scan/1'"),
        (lambda r: r.update(schema="retrograph.calibration/1"), "'retrograph.calibration/1', this program reads"),
        (lambda r: r.pop("schema"), "schema is missing"),
        (lambda r: r.update(colour="red"), "colour is not a key"),
        (lambda r: r.update(pixel_pitch_um=-1), "pixel_pitch_um: "),
        (lambda r: r["verdict"].update(level="perfect"), "verdict.level: "),
        (lambda r: r["granted"].update(exposure_us="2 ms"), "granted.exposure_us: "),
        (lambda r: r["files"].update({"../evil": r["files"]["raw.tif"]}), "files"),
        (lambda r: r["files"].update({"raw.tif\n": r["files"]["raw.tif"]}), "files"),
        (lambda r: r["files"].pop("raw.tif"), "files: raw.tif is not listed there"),
        (lambda r: r["identity"].update(id="../up"), "identity.id: "),
    ],
)
def test_a_wrong_manifest_is_refused_by_key(
    store: BundleStore, publish_scan: PublishScan, change: Callable[[dict], None], sentence: str
) -> None:
    directory = rewrite(publish_scan(store), change)
    with pytest.raises(RecordError, match=re.escape(sentence)) as caught:
        read_scan(directory)
    assert str(directory / "scan.json") in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["raw.tif", "preview.png", "scan.json", "scan.json.sha256"])
def test_damage_to_any_file_is_named(store: BundleStore, publish_scan: PublishScan, name: str) -> None:
    bundle = publish_scan(store)
    path = bundle.directory / name
    data = path.read_bytes()
    offsets = [int(at) for at in np.linspace(0, len(data) - 1, 23)]
    flipped = [data[:at] + bytes([data[at] ^ (1 << (at % 8))]) + data[at + 1 :] for at in offsets]
    for harmed in (data[: len(data) // 2], data[:-1], b"", data + b"\n", *flipped):
        path.write_bytes(harmed)
        with pytest.raises(RecordError, match=re.escape(name)):
            read_scan(bundle.directory).verify()
    path.unlink()
    with pytest.raises(RecordError, match=re.escape(name)):
        read_scan(bundle.directory).verify()


def test_every_wrong_file_is_named_at_once(store: BundleStore, publish_scan: PublishScan, tmp_path: Path) -> None:
    bundle = publish_scan(store)
    bundle.path("raw.tif").write_bytes(b"short")
    secret = tmp_path / "secret"
    secret.write_bytes(bundle.path("preview.png").read_bytes())
    bundle.path("preview.png").unlink()
    bundle.path("preview.png").symlink_to(secret)
    with pytest.raises(RecordError, match=r"preview\.png is no regular file, raw\.tif has 5 bytes instead of \d+"):
        bundle.verify()


def test_a_frame_of_another_size_than_recorded_is_refused(store: BundleStore, publish_scan: PublishScan) -> None:
    bundle = read_scan(rewrite(publish_scan(store), lambda r: r.update(shape=[16, 16])))
    with pytest.raises(RecordError, match=r"raw\.tif: is \(32, 48\)"):
        bundle.raw_frame()
    with pytest.raises(RecordError, match=r"holds no file 'relief\.png'"):
        bundle.path("relief.png")


def test_hostile_json_ends_in_a_record_error() -> None:
    for data in (b"", b"[" * 100_000, b'{"schema": 7}', b"\xff\xfe", b'{"schema": "retrograph.scan/1"}', b"null"):
        with pytest.raises(DeviceError, match=r"scan\.json"):
            decode_scan(data, "scan.json")


def test_the_published_schemas_are_those_of_the_records(store: BundleStore, publish_scan: PublishScan) -> None:
    committed = {path.name: path.read_bytes() for path in SCHEMAS.glob("*.json")}
    assert committed == {name: schema_bytes(schema) for name, schema in schemas().items()}
    scan = schemas()["scan-1.json"]["$defs"]["ScanRecord"]
    assert set(scan["properties"]) == set(msgspec.json.decode(encode_record(publish_scan(store).record)))

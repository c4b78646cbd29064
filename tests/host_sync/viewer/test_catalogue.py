import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from device.bundles.scan import ScanBundle
from host_sync.errors import UnreadableResult, ViewError
from host_sync.viewer.cache import Cache
from host_sync.viewer.catalogue import Catalogue, ListFilter
from host_sync.viewer.entry import KEPT, Heights, result_entry


def test_a_library_shows_results_and_else_quick_looks(library: tuple[Path, list[ScanBundle]]) -> None:
    root, scans = library
    entries = Catalogue(root).list(ListFilter()).entries
    assert [entry.kind for entry in entries] == ["quick look", "result", "result"]
    assert {entry.hit.scan_id for entry in entries if entry.hit} == {scan.scan_id for scan in scans}
    assert entries[0].pitch_um == pytest.approx(12.0 * 48 / entries[0].shape[1])


@pytest.mark.parametrize(
    ("query", "parts"),
    [
        ("", ["plate", "seal [3]", "valve"]),
        ("verdict=doubtful", ["seal [3]"]),
        ("part=VALV", ["valve"]),
        ("part=%5B3%5D", ["seal [3]"]),
        ("job=J-*", ["plate", "valve"]),
        ("q=ada+j-8", ["plate"]),
        ("q=nothing", []),
        ("gel=twin&operator=ada", ["plate", "seal [3]", "valve"]),
        ("until=1969-01-01", []),
    ],
)
def test_filters_find_what_they_say(
    library: tuple[Path, list[ScanBundle]], serve: Callable[[Path], Any], query: str, parts: list[str]
) -> None:
    listed = serve(library[0]).json(f"/api/list?{query}")["entries"]
    assert sorted(entry["part"] for entry in listed) == parts


def test_a_day_that_is_none_is_refused(library: tuple[Path, list[ScanBundle]], serve: Callable[[Path], Any]) -> None:
    assert serve(library[0]).get("/api/list?since=yesterday")[0] == 404


def test_what_cannot_be_shown_is_named_and_hides_nothing(world: Any, results: Path, tmp_path: Path) -> None:
    root = tmp_path / "copy"
    shutil.copytree(results, root)
    (root / "hill" / "result.json").write_text("{")
    (root / "moved" / "height_um.tif").unlink()
    listing = Catalogue(root).list(ListFilter())
    assert {entry.title for entry in listing.entries} == {world.HOSTILE, "a film"}
    assert len(listing.complaints) == 2


@pytest.mark.parametrize("content", ["[]", "{}", '{"schema": "retrograph.result/1"}', '{"schema": "else"}', "\udcff"])
def test_a_damaged_record_is_one_sentence(tmp_path: Path, content: str) -> None:
    (tmp_path / "result.json").write_bytes(content.encode(errors="surrogateescape"))
    with pytest.raises(UnreadableResult, match="reconstruct the scan again"):
        result_entry(tmp_path)


def test_a_folder_with_nothing_to_show_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ViewError, match="neither scans nor results"):
        Catalogue(tmp_path)
    with pytest.raises(ViewError, match="no such folder"):
        Catalogue(tmp_path / "nowhere")


@pytest.mark.parametrize("damage", ["truncated", "other size", "not a file of heights"])
def test_damaged_heights_are_refused(world: Any, tmp_path: Path, damage: str) -> None:
    folder = world.write_result(tmp_path / "one", world.surface(), "one")
    path = folder / "height_um.tif"
    if damage == "truncated":
        path.write_bytes(path.read_bytes()[:5000])
    elif damage == "other size":
        shutil.copy(world.write_result(tmp_path / "two", world.surface()[:50], "two") / "height_um.tif", path)
    else:
        path.write_bytes(b"nonsense")
    with pytest.raises(UnreadableResult, match="reconstruct the scan again"):
        Heights().read(result_entry(folder))


def test_only_a_few_height_maps_are_held(world: Any, tmp_path: Path) -> None:
    heights = Heights()
    for number in range(5):
        heights.read(result_entry(world.write_result(tmp_path / str(number), world.surface(), str(number))))
    assert len(heights._held) == KEPT


def test_the_cache_may_vanish_at_any_time_and_forgets_the_oldest(world: Any, tmp_path: Path) -> None:
    entries = [result_entry(world.write_result(tmp_path / str(n), world.surface(), str(n))) for n in range(3)]
    theirs = tmp_path / "cache" / "photographs"
    theirs.mkdir(parents=True)
    (theirs / "one.jpg").write_bytes(bytes(400_000))
    os.utime(theirs, (0, 0))
    cache = Cache(tmp_path / "cache", Heights(), max_bytes=300_000)
    levels = [cache.level(entry, 0, 1, 0, 20) for entry in entries]
    kept = [entry for entry in entries if cache.folder(entry.stamp()).is_dir()]
    assert entries[-1] in kept
    assert len(kept) < 3
    assert (theirs / "one.jpg").is_file()
    shutil.rmtree(tmp_path / "cache")
    again = cache.level(entries[0], 0, 1, 0, 20)
    np.testing.assert_array_equal(again.surface, levels[0].surface)


def test_a_cache_that_cannot_be_written_costs_time_only(world: Any, tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("in the way")
    cache = Cache(tmp_path / "cache", Heights())
    entry = result_entry(world.write_result(tmp_path / "one", world.surface(), "one"))
    assert cache.level(entry, 0, 1, 0, 20).valid.shape[0] == 20
    assert cache.file(entry, "thumbnail.webp", lambda: b"made") == b"made"


def test_nothing_is_written_beside_the_results(results: Path, served: Any) -> None:
    def listed() -> dict[Path, Any]:
        return {path: path.stat().st_mtime_ns for path in results.rglob("*")}

    before = listed()
    for key in served.keys().values():
        served.json(f"/api/scan/{key}")
        served.get(f"/api/scan/{key}/thumbnail")
        served.get(f"/api/scan/{key}/level/1?first=0&last=4")
    assert listed() == before


def test_a_record_of_the_wrong_kinds_is_shown_without_them(
    world: Any, tmp_path: Path, serve: Callable[[Path], Any]
) -> None:
    folder = world.write_result(tmp_path / "r", world.surface(), "r")
    record = json.loads((folder / "result.json").read_text())
    odd = {"warnings": "none", "masked_share": "all", "height_min_um": [1], "method": {"a": 1}, "tilt": [{}]}
    (folder / "result.json").write_text(json.dumps(record | odd))
    (entry,) = serve(folder).json("/api/list")["entries"]
    assert not odd.keys() & entry["record"].keys()


def test_a_name_that_is_no_text_is_shown_as_far_as_it_goes(
    world: Any, tmp_path: Path, serve: Callable[[Path], Any]
) -> None:
    root = tmp_path / os.fsdecode(b"r\xffesults")
    world.write_result(root / os.fsdecode(b"\xfe"), world.surface(), "r")
    (root / os.fsdecode(b"\xfd")).mkdir()
    (root / os.fsdecode(b"\xfd") / "result.json").write_text("{")
    told = serve(root).json("/api/list")
    assert len(told["entries"]) == len(told["complaints"]) == 1
    assert "r?esults" in told["root"]


@pytest.mark.parametrize(("name", "value"), [("rows", 10**7), ("columns", -4), ("pixel_pitch_um", 0), ("rows", "x")])
def test_sizes_that_cannot_be_are_refused_before_anything_is_read(
    world: Any, tmp_path: Path, name: str, value: Any
) -> None:
    folder = world.write_result(tmp_path / "r", world.surface(), "r")
    record = json.loads((folder / "result.json").read_text())
    (folder / "result.json").write_text(json.dumps(record | {name: value}))
    with pytest.raises(UnreadableResult):
        result_entry(folder)

"""Every doubt of a result reaches every output that shows a number, a profile or a map of it."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, get_args

import gwyfile
import msgspec
import numpy as np
import pytest
import tifffile
from PIL import Image

from device.calibration.acceptance import SECTORS
from host_sync import api
from host_sync.cli.export import ExportFormat
from host_sync.cli.main import main
from host_sync.export.surface_export import FORMATS
from host_sync.results.doubts import doubts_at, record_doubts
from host_sync.results.field_file import write_field, write_mask
from host_sync.results.record import DoubtKind, ResultRecord
from host_sync.viewer.catalogue import Catalogue, ListFilter
from host_sync.viewer.responses import entry_info, profile_csv, profile_info
from host_sync.viewer.service import NearPose, ViewerService

SHAPE = (90, 120)
PITCH_UM = 10.0
CALIBRATION = "cal-1"

DRIFTED = {"name": "light levels", "outcome": "refused", "words": "its red light is 12 % darker"}
MOVED = {"name": "pattern position", "outcome": "refused", "words": "its skin lies 9 px further down"}
FACTS: dict[str, dict[str, Any]] = {
    "failed calibration": {
        "calibration_passed": False,
        "calibration_failed_checks": ["steepest slope covered, degrees 21 (at least 35)"],
    },
    "failed check standard": {},
    "uncovered sector": {"uncovered_sectors": ["upper left corner", "middle of the frame"]},
    "extrapolated slopes": {"extrapolated_share": 1.0},
    "drifted light": {"warnings": [DRIFTED["words"]], "frame_checks": [DRIFTED]},
    "frame unlike calibration": {"warnings": [MOVED["words"]], "frame_checks": [MOVED]},
    "no zero": {"warnings": ["no zero: heights are relative, because no skin is untouched"]},
    "not converged": {"integration": {"converged": False}},
    "reconstruction": {"warnings": ["something else speaks against it"]},
    "foreign file": {"method": "foreign file", "warnings": ["its pixels were interpolated to squares"]},
}
REASONS = {
    "failed calibration": "steepest slope covered, degrees 21",
    "failed check standard": "does not agree with step 100",
    "uncovered sector": "balls of the calibration do not cover upper left corner, middle of the frame",
    "extrapolated slopes": "slopes beyond those of the calibration balls",
    "drifted light": DRIFTED["words"],
    "frame unlike calibration": MOVED["words"],
    "no zero": "heights are relative",
    "not converged": "did not reach its limit",
    "reconstruction": "something else speaks against it",
    "foreign file": "its pixels were interpolated to squares",
    "replaced scan": "it was taken again as newer-",
}
CERTIFICATE = {
    "calibration_id": CALIBRATION,
    "verdict": "does not agree",
    "specimens": [{"name": "step 100", "agrees": False}, {"name": "ball", "agrees": True}],
}
RECIPE = """
region_um = [100, 100, 1000, 800]
keep_extrapolated = true
[[profile]]
name = "across"
from_um = [50, 450]
to_um = [1100, 450]
[[step]]
name = "edge"
from_um = [50, 450]
to_um = [1100, 450]
[[distance]]
name = "span"
from_um = [300, 300]
to_um = [700, 450]
[[angle]]
name = "faces"
first_um = [50, 300, 500, 600]
second_um = [600, 300, 1000, 600]
[[volume]]
name = "pit"
region_um = [100, 100, 1000, 800]
border_um = 30
"""

Doubtful = tuple[str, Path]


@pytest.fixture(params=get_args(DoubtKind))
def doubtful(request: pytest.FixtureRequest, tmp_path: Path) -> Doubtful:
    """A kind of doubt, and a result that has it and no other."""
    return request.param, write(tmp_path / "results" / "part", request.param)


OTHER = "reconstruction"
"""The kind of warnings that are of no other kind: beside a foreign file's there are none."""


@pytest.fixture(params=[[kind for kind in get_args(DoubtKind) if kind != OTHER], [OTHER]], ids=["every", "other"])
def doubted(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[list[str], Path]:
    """Kinds of doubt, and a result that has all of them."""
    return request.param, write(tmp_path / "results" / "part", *request.param)


def write(folder: Path, *kinds: str, seed: int = 0) -> Path:
    folder.mkdir(parents=True)
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    z_um = 0.02 * row + np.where(column > 60, np.float32(50.0), np.float32(0.0)) + np.sin(column)
    z_um += 0.1 * np.random.default_rng(seed).standard_normal(SHAPE)
    write_field(folder / "height_um.tif", z_um.astype(np.float32), PITCH_UM, "height")
    write_field(folder / "height_sigma_um.tif", np.full_like(row, 0.5), PITCH_UM, "sigma")
    errors = np.random.default_rng(1).standard_normal((8, 45, 60)).astype(np.float32)
    tifffile.imwrite(folder / "height_draws_um.tif", errors, photometric="minisblack", metadata=None)
    if "extrapolated slopes" in kinds:
        write_mask(folder / "extrapolated.png", np.ones(SHAPE, np.bool_))
    if "failed check standard" in kinds:
        (folder.parent / "calibration").mkdir()
        (folder.parent / "calibration" / "certificate.json").write_text(json.dumps(CERTIFICATE))
    scan, facts = folder.parent.parent, stated_facts(kinds)
    if "replaced scan" in kinds:
        (newer := scan.with_name(f"newer-{scan.name}")).mkdir(exist_ok=True)
        (newer / "scan.json").write_text(json.dumps({"replaces": scan.name}))
        facts |= {"scan_id": scan.name}
    record = {
        "schema": "retrograph.result/1",
        "name": "part",
        "rows": SHAPE[0],
        "columns": SHAPE[1],
        "pixel_pitch_um": PITCH_UM,
        "calibration_id": CALIBRATION,
        "calibration_passed": True,
        "height_scale": {"pixel_pitch_share": 0.001, "ball_radius_share": 0.001},
    }
    (folder / "result.json").write_text(json.dumps(record | facts))
    return folder


def stated_facts(kinds: Iterable[str]) -> dict[str, Any]:
    """Return what a record states of these kinds; lists of several are joined."""
    facts: dict[str, Any] = {}
    for kind in kinds:
        for name, value in FACTS.get(kind, {}).items():
            facts[name] = [*facts.get(name, []), *value] if isinstance(value, list) else value
    return facts


def recipe(tmp_path: Path) -> str:
    path = tmp_path / "recipe.toml"
    path.write_text(RECIPE)
    return str(path)


def test_a_result_without_doubts_has_none(tmp_path: Path) -> None:
    assert api.load_result(write(tmp_path / "part")).warnings == ()


def test_the_record_states_each_kind_alone(doubtful: Doubtful) -> None:
    kind, folder = doubtful
    (words,) = api.load_result(folder).warnings
    assert words.startswith(f"{kind}: ")
    assert REASONS[kind] in words


def test_every_number_and_profile_carries_it(
    doubtful: Doubtful, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kind, folder = doubtful
    named = [str(folder), "--recipe", recipe(tmp_path)]
    assert main(["measure", *named]) == 0
    text = capsys.readouterr().out
    assert f"doubt: {kind}: " in text
    assert main(["measure", *named, "--json", "--csv", str(tmp_path / "numbers.csv")]) == 0
    (record,) = json.loads(capsys.readouterr().out)
    assert [doubt["kind"] for doubt in record["doubts"]] == [kind]
    without = [
        (one["subject"], one["name"])
        for one in record["quantities"]
        if not any(words.startswith(f"{kind}: ") for words in one["doubts"])
    ]
    assert without == []
    assert len({one["subject"] for one in record["quantities"]}) == 6
    for shown in (*record["profiles"], *record["steps"]):
        assert any(words.startswith(f"{kind}: ") for words in shown["doubts"])
    rows = (tmp_path / "numbers.csv").read_text().splitlines()[1:]
    assert [row for row in rows if f"{kind}: " not in row] == []


def test_the_report_shows_every_kind(
    doubted: tuple[list[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds, folder = doubted
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(folder), "--recipe", recipe(tmp_path), "--out", str(tmp_path / "out")]) == 0
    page = next((tmp_path / "out").glob("*.html")).read_text()
    captions = [part.partition("<")[0] for part in page.split("<figcaption>")[1:]]
    for kind in kinds:
        assert f'<p class="warning">Warning: {kind}: ' in page
        for begins in ("Height map", "Profile across", "edge: edges at"):
            (caption,) = [one for one in captions if one.startswith(begins)]
            assert f"{kind}: " in caption
    assert next((tmp_path / "out").glob("*.pdf")).stat().st_size > 10_000


def test_the_viewer_shows_it(doubtful: Doubtful, tmp_path: Path) -> None:
    kind, folder = doubtful
    write(folder.parent / "other", *(() if kind == "failed check standard" else (kind,)), seed=1)
    service = ViewerService(Catalogue(folder.parent), tmp_path / "cache")
    entries = service.catalogue.list(ListFilter()).entries
    assert len(entries) == 2
    for entry in entries:
        doubts = entry_info(entry)["doubts"]
        assert [words.partition(":")[0] for words in doubts] == [kind]
        line = service.profile(entry.key, 0, (45.0, 5.0, 45.0, 110.0))
        assert profile_info(line, entry)["doubts"] == doubts
        rows = bytes(profile_csv(line, entry).body).decode().splitlines()[1:]
        assert [row for row in rows if f"{kind}: " not in row] == []
    difference = service.compare(entries[0].key, entries[1].key, NearPose(0.0, 0.0, 0.0, pinned=True))
    assert sum(f": {kind}: " in words for words in entry_info(difference)["doubts"]) == 2


FULL_TEXT: dict[str, Callable[[Path], str]] = {
    "gwy": lambda path: str(gwyfile.load(str(path))["/0/meta"]["Doubts"]),
    "npz": lambda path: " ".join(np.load(path)["doubts"]),
    "png": lambda path: Image.open(path).text["Doubts"] + path.with_suffix(".png.json").read_text(),
    "x3p": lambda path: zipfile.ZipFile(path).read("main.xml").decode(),
}


@pytest.mark.parametrize("form", [form for form in get_args(ExportFormat) if form != "dng"])
def test_every_export_carries_every_kind(doubted: tuple[list[str], Path], form: str, tmp_path: Path) -> None:
    kinds, folder = doubted
    out = tmp_path / "out"
    assert main(["export", str(folder), "--to", form, "--out", str(out)]) == 0
    path = out / f"part.{'tif' if form == 'tiff' else form}"
    text = FULL_TEXT[form](path) if form in FULL_TEXT else path.read_bytes().decode("latin-1")
    if FORMATS[form].little_room:
        assert "DOUBTFUL" in text
        text = path.with_name(f"{path.name}.doubts.txt").read_text()
    missing = [kind for kind in kinds if f"{kind}: " not in text or REASONS[kind] not in text]
    assert missing == []


def test_pictures_and_studies_state_it(doubtful: Doubtful, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kind, folder = doubtful
    assert main(["render", str(folder), "--out", str(tmp_path / "a.png"), "--width", "200"]) == 0
    assert f"doubt: part: {kind}: " in capsys.readouterr().out
    plan = tmp_path / "plan.csv"
    rows = [
        f"{part},{who},{write(tmp_path / f'{part}{who}{again}' / 'part', kind, seed=1 + again + 2 * index)}"
        for index, (part, who) in enumerate(("ac", "ad", "bc", "bd"))
        for again in range(2)
    ]
    plan.write_text("\n".join(["part,operator,result", *rows]))
    assert main(["gage-rr", "--plan", str(plan), "--recipe", recipe(tmp_path)]) == 0
    assert f"{kind}: " in capsys.readouterr().out


def test_a_sector_concerns_what_lies_in_it() -> None:
    record = ResultRecord(name="a", rows=90, columns=90, pixel_pitch_um=1.0, uncovered_sectors=(SECTORS[0], SECTORS[4]))
    doubts = record_doubts(record)
    beside = doubts_at(doubts, np.array([[80.0, 80.0]]), (90, 90), None)
    assert beside == ()
    (inside,) = doubts_at(doubts, np.array([[45.0, 45.0], [80.0, 80.0]]), (90, 90), None)
    assert inside.sectors == ("middle of the frame",)
    assert "upper left" not in inside.sentence


def test_a_certificate_of_another_calibration_says_nothing(tmp_path: Path) -> None:
    folder = write(tmp_path / "part", "failed check standard")
    other = msgspec.json.encode(CERTIFICATE | {"calibration_id": "another"})
    (folder.parent / "calibration" / "certificate.json").write_bytes(other)
    assert api.load_result(folder).warnings == ()

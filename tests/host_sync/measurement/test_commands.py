"""`retrosync measure`, `gage` and `report` as a user meets them: good input, bad input, hostile names."""

from __future__ import annotations

import csv
import io
import json
import shutil
import subprocess
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest

from device.bundles.scan import Annotations, ScanBundle
from device.store.store import BundleStore
from host_sync.cli.main import main
from host_sync.report import composing, writing
from tests.apparatus.printing import needs_browser

Write = Callable[..., Path]

HOSTILE = "<script>alert('ö')</script> & \"quoted\" ../../etc $x$ =1+1"


def recipe(tmp_path: Path, text: str = "l_filter_um = 300\n") -> Path:
    path = tmp_path / "recipe.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_numbers_are_printed_with_unit_uncertainty_and_what_was_done(
    write_result: Write, wave: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_result(wave)
    assert main(["measure", str(folder), "--l-filter-um", "300", "--parameters", "Sa", "hybrid", "-k", "2"]) == 0
    out = capsys.readouterr().out
    assert "form removed: plane (least squares); S-filter: none; L-filter: nesting index 300 µm" in out
    assert "surface  (k = 2, 0 % masked)" in out
    for name in ("Sa", "Sdq", "Sdr"):
        assert any(line.split()[:1] == [name] and "±" in line for line in out.splitlines())
    assert "Ssk" not in out


def test_a_name_moves_no_cursor_and_starts_no_formula(
    write_result: Write, wave: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_result(wave, "bell", scan_id="=cmd()", warnings=["\x1b[2J\x07"])
    table = tmp_path / "numbers.csv"
    assert main(["measure", str(folder), "--parameters", "Ssk", "--csv", str(table)]) == 0
    assert "\x1b" not in capsys.readouterr().out
    row = next(csv.DictReader(io.StringIO(table.read_text(encoding="utf-8"))))
    assert row["scan_id"] == "'=cmd()"
    assert np.isfinite(float(row["value"]))


def test_json_and_csv_hold_every_number(
    write_result: Write, wave: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [str(write_result(wave, name)) for name in ("one", "=two")]
    table = tmp_path / "numbers.csv"
    assert main(["measure", *folders, "--json", "--csv", str(table), "--spectrum"]) == 0
    records = json.loads(capsys.readouterr().out)
    assert [record["name"] for record in records] == ["one", "=two"]
    assert records[0]["spectrum"]["density_um3"]
    rows = list(csv.DictReader(io.StringIO(table.read_text(encoding="utf-8"))))
    assert len(rows) == sum(len(record["quantities"]) for record in records)
    assert float(rows[0]["value"]) == records[0]["quantities"][0]["value"]
    assert {row["unit"] for row in rows if row["name"] == "Sdq"} == {"µm/µm"}


def test_what_cannot_be_measured_is_named_and_the_rest_is_done(
    write_result: Write, wave: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, cut = write_result(wave), write_result(wave, "cut")
    data = (cut / "height_um.tif").read_bytes()
    (cut / "height_um.tif").write_bytes(data[: len(data) // 3])
    assert main(["measure", str(good), str(cut), str(tmp_path / "none"), "--parameters", "Sa"]) == 1
    said = capsys.readouterr()
    assert "height_um.tif: is truncated or damaged" in said.err
    assert "holds no result.json" in said.err
    assert "Traceback" not in said.err
    assert said.out.count("Sa ") == 1
    assert main(["measure", str(cut)]) == 2


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        ({"schema": "retrograph.result/9"}, "retrograph.result/9"),
        ({"rows": 7}, "expected 240 x 7"),
        ({"pixel_pitch_um": 0.0}, "pixel_pitch_um: is out of range; accepted is a number at least 0.001"),
        ({"rows": "many"}, "rows: is a text; accepted is a whole number"),
    ],
)
def test_a_record_that_does_not_fit_is_refused(
    write_result: Write, wave: np.ndarray, capsys: pytest.CaptureFixture[str], facts: dict[str, object], words: str
) -> None:
    assert main(["measure", str(write_result(wave, **facts))]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--form", "cone"], "accepted are none, mean, plane"),
        (["--region-um", "0", "0", "2", "2"], "fewer than two pixels"),
        (["--s-filter-um", "50", "--l-filter-um", "40"], "s_filter_um"),
        (["--recipe", "nowhere.toml"], "nowhere.toml: cannot be read"),
    ],
)
def test_options_that_make_no_sense_are_refused_by_name(
    write_result: Write, wave: np.ndarray, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert main(["measure", str(write_result(wave)), *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_gage_study_from_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    random = np.random.default_rng(0)
    rows = ["part,operator,value"]
    rows += [f"p{p},{o},{p + 0.01 * random.standard_normal()}" for p in range(5) for o in "ab" for _ in range(3)]
    table = tmp_path / "study.csv"
    table.write_text("\n".join(rows), encoding="utf-8")
    assert (
        main(["gage-rr", "--table", str(table), "--tolerance", "0.5", "--json-file", str(tmp_path / "gage.json")]) == 0
    )
    out = capsys.readouterr().out
    assert "5 parts, 2 operators, 3 repeats" in out
    assert "good (up to 10 % good" in out
    record = json.loads((tmp_path / "gage.json").read_text(encoding="utf-8"))
    assert record["repeatability"]["low"] < 0.01 < record["repeatability"]["high"]
    table.write_text("\n".join(rows[:-1]), encoding="utf-8")
    assert main(["gage-rr", "--table", str(table)]) == 2
    assert "part p4 was measured 2 times by operator b" in capsys.readouterr().err
    table.write_text("part,value\n1,2", encoding="utf-8")
    assert main(["gage-rr", "--table", str(table)]) == 2
    assert "has no column operator" in capsys.readouterr().err


def annotated(store: BundleStore, scan: ScanBundle, notes: Annotations, result: Path) -> None:
    """Publish the same scan once more with notes, and lay a result beside it."""
    record = msgspec.structs.replace(scan.record, identity=store.next_identity("scans"), annotations=notes, files={})

    def copy(directory: Path) -> None:
        for name in scan.record.files:
            shutil.copy(scan.path(name), directory / name)

    bundle = store.publish_scan(record, copy)
    shutil.copytree(result, bundle.directory / "results" / "0.1.0-abc")


def test_a_library_is_measured_gaged_and_reported_by_one_recipe(
    write_result: Write,
    wave: np.ndarray,
    tmp_path: Path,
    store: BundleStore,
    publish_scan: Callable[..., ScanBundle],
    capsys: pytest.CaptureFixture[str],
) -> None:
    first = publish_scan(store)
    for part in range(2):
        for operator in ("ada", "<b>bob</b>"):
            for repeat in range(2):
                result = write_result((1.0 + part) * wave + 0.01 * repeat, f"r{part}{operator[0]}{repeat}", samples=2)
                notes = Annotations(part=f"part {part}", operator=operator, note=HOSTILE)
                annotated(store, first, notes, result)
    chosen = recipe(tmp_path, 'parameters = ["Sa"]\n')
    library = ["--library", str(store.root), "--recipe", str(chosen)]
    assert main(["measure", *library]) == 1
    said = capsys.readouterr()
    assert said.out.count("Sa ") == 8
    assert f"{first.scan_id}: has no results" in said.err
    shutil.rmtree(first.directory)
    assert main(["gage-rr", *library]) == 2
    assert "is a copy of" in capsys.readouterr().err
    assert main(["gage-rr", *library, "--number", "surface/Sx"]) == 2
    assert "accepted are surface/Sa" in capsys.readouterr().err
    out = tmp_path / "reports"
    scans = [path.name for path in sorted((store.root / "scans").iterdir())][-2:]
    assert main(["report", *scans, *library, "--out", str(out)]) == 0
    stems = [{path.stem for path in out.glob(f"*{ending}")} for ending in (".html", ".pdf")]
    assert stems[0] == stems[1]
    assert len(stems[0]) == 2
    page = next(iter(out.glob("*.html"))).read_text(encoding="utf-8")
    assert "<b>bob" not in page
    assert "Frame: one exposure" in page
    assert "scan/scan.json" in page


def test_a_result_that_is_named_twice_is_no_copy_of_itself(
    write_result: Write, wave: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [write_result((1.0 + 0.1 * number) * wave, f"r{number}") for number in range(4)]
    folders[2] = folders[0].parent / "r3" / ".." / "r0"
    plan = tmp_path / "plan.csv"
    rows = [f"part {number // 2},ada,{folder}" for number, folder in enumerate(folders)]
    plan.write_text("\n".join(["part,operator,result", *rows]), encoding="utf-8")
    assert main(["gage-rr", "--plan", str(plan)]) == 2
    assert f"{folders[2]}: is named twice" in capsys.readouterr().err
    assert main(["mosaic", str(folders[0]), str(folders[2]), "--out", str(tmp_path / "mosaic")]) == 2
    assert f"{folders[2]}: is named twice" in capsys.readouterr().err


def test_a_copy_takes_no_part_in_a_trend(
    write_result: Write, wave: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gains = {"one": 1.0, "two": 1.1, "copy": 1.0, "three": 1.2}
    folders = [str(write_result(gain * wave, name)) for name, gain in gains.items()]
    assert main(["measure", *folders, "--parameters", "Sa", "--trend", str(tmp_path / "trend.png"), "--json"]) == 1
    said = capsys.readouterr()
    assert said.err == f"retrosync: {folders[2]}: is a copy of {folders[0]}, not another press: no trend has it\n"
    *records, trend = json.loads(said.out)
    assert len(records) == 4
    (sa,) = trend["trends"]
    assert (sa["count"], sa["copies"], sa["replaced"]) == (3, 1, 0)
    assert sa["mean"] == pytest.approx(np.mean([sa["values"][at] for at in (0, 1, 3)]))
    assert main(["measure", *folders[:2], "--parameters", "Sa", "--trend", str(tmp_path / "trend.png")]) == 0


class Tags(HTMLParser):
    """Collects what a browser would act on."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: list[tuple[str, str | None]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes += attrs


@needs_browser
def test_a_report_stands_alone_and_hostile_names_do_nothing(
    write_result: Write, wave: np.ndarray, tmp_path: Path
) -> None:
    wave[20:40, 50:90] = np.nan
    facts = {"warnings": [HOSTILE], "gel_id": HOSTILE, "scan_id": HOSTILE, "frame_set": "x\x00\x1b[31m"}
    folder = write_result(wave, HOSTILE, **facts)
    lines = 'name = "<img src=x> $\\\\frac$"\nfrom_um = [10, 400]\nto_um = [1100, 400]\nl_filter_um = 200\n'
    chosen = recipe(tmp_path, f"spectrum = true\n[[profile]]\n{lines}")
    out = tmp_path / "out"
    arguments = ["report", str(folder), "--out", str(out), "--recipe", str(chosen)]
    assert main(arguments) == 0
    page, sheet = next(out.glob("*.html")), next(out.glob("*.pdf"))
    assert page.parent == out
    assert page.name.startswith("script_alert")
    text = page.read_text(encoding="utf-8")
    found = Tags()
    found.feed(text)
    assert found.tags.isdisjoint({"script", "iframe", "object", "link", "form", "a", "b"})
    known = {"src", "width", "height", "alt", "class", "scope", "lang", "charset", "content", "name", "http-equiv"}
    assert {name for name, _ in found.attributes} <= known
    pictures = [value or "" for name, value in found.attributes if name == "src"]
    assert all(value.startswith("data:image/png;base64,") for value in pictures)
    assert len(pictures) >= 4
    assert "default-src 'none'" in next(value for name, value in found.attributes if name == "content" and value)
    for wanted in ("result/result.json", "calibration", "± 0", "masked", "k = 1"):
        assert wanted in text
    before = sheet.read_bytes()
    assert before.startswith(b"%PDF")
    numbers = (out / "numbers.csv").read_bytes()
    assert main(["report", str(write_result(wave, "another")), "--out", str(out)]) == 2
    assert (out / "numbers.csv").read_bytes() == numbers  # a second report does not take the first one's numbers away
    assert main(arguments) == 2  # they are there already
    assert main([*arguments, "--overwrite"]) == 0
    assert sheet.read_bytes() == before
    assert not list(tmp_path.rglob("*.partial"))


@needs_browser
@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="pdftotext is not installed (Debian: poppler-utils)")
def test_the_pdf_says_what_the_page_says(write_result: Write, wave: np.ndarray, tmp_path: Path) -> None:
    folder = write_result(wave, HOSTILE)
    assert main(["report", str(folder), "--out", str(tmp_path / "out")]) == 0
    sheet = next((tmp_path / "out").glob("*.pdf"))
    text = subprocess.run(["pdftotext", "-layout", sheet, "-"], capture_output=True, text=True, check=True).stdout
    assert "<script>alert('ö')</script>" in text
    for wanted in ("Sa", "±", "µm", "Provenance", "SHA-256", "height_um.tif", "page 1"):
        assert wanted in text


def test_checks_of_a_calibration_are_stated_to_four_digits() -> None:
    check = {"name": "held-out error, degrees", "value": 1.6883128948182646, "limit": 5.0, "kind": "at most"}
    told = composing.check_lines({"checks": [check | {"passed": True}, check | {"value": "?", "passed": None}, 7]})
    assert [words for _, words in told] == ["1.688 (at most 5): passed", "? (at most 5): NOT passed"]


def test_a_result_that_cannot_be_measured_is_named(
    write_result: Write, wave: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = write_result(np.full_like(wave, np.nan), "empty")
    assert main(["measure", str(empty)]) == 2
    assert capsys.readouterr().err.startswith(f"retrosync: {empty}: every pixel")


def test_without_a_browser_the_page_is_written_and_a_sentence_names_what_is_missing(
    write_result: Write, wave: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(writing, "find_browser", lambda: None)
    report = ["report", str(write_result(wave, "one")), str(write_result(wave, "two")), "--out", str(tmp_path / "out")]
    assert main(report) == 1
    assert capsys.readouterr().err == f"retrosync: {writing.NO_BROWSER}\n"
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["numbers.csv", "one.html", "two.html"]
    (tmp_path / "out" / "one.pdf").write_bytes(b"of an earlier report")
    assert main([*report, "--overwrite", "--no-pdf"]) == 0
    assert not capsys.readouterr().err
    assert not (tmp_path / "out" / "one.pdf").exists()


def test_a_browser_that_fails_leaves_the_page_and_no_pdf(
    write_result: Write, wave: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(writing, "find_browser", lambda: "/bin/false")
    assert main(["report", str(write_result(wave, "one")), "--out", str(tmp_path / "out")]) == 2
    assert "one.html is written, but /bin/false makes no PDF of it" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["one.html"]

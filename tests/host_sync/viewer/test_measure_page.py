"""Measuring in the page, in a real browser: what is clicked is the recipe that the command measures with."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from drawn_frames import settle

from host_sync.cli.main import main

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")


def open_measuring(page: Any, title: str) -> None:
    page.set_viewport_size({"width": 1280, "height": 860})
    page.click(f".card a:has(.name:text-is({title!r}))")
    page.wait_for_selector(".stage[data-ready]")
    page.get_by_role("button", name="Measure", exact=True).click()
    calm(page)


def calm(page: Any) -> None:
    """All numbers are there, with their ±."""
    page.wait_for_selector(".panel [data-ready=yes]")
    page.wait_for_function("() => document.querySelector('.items .value')?.textContent.includes('…') === false")


def drag(page: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Drag between two places of the relief, in fractions of it."""
    box = page.locator(".surface").bounding_box()
    places = [(box["x"] + x * box["width"], box["y"] + y * box["height"]) for x, y in (start, end)]
    page.mouse.move(*places[0])
    page.mouse.down()
    page.mouse.move(*places[1], steps=5)
    page.mouse.up()


def middle_of(page: Any, selector: str) -> tuple[float, float]:
    """Middle of an element of the overlay, read in one step: each drawing replaces all its elements."""
    settle(page)
    return tuple(
        page.evaluate(
            "selector => { const box = document.querySelector(selector).getBoundingClientRect();"
            " return [box.x + box.width / 2, box.y + box.height / 2]; }",
            selector,
        )
    )


def numbers(page: Any, name: str) -> dict[str, str]:
    """Numbers of an item by their names."""
    item = page.locator(f".item:has(input[aria-label='Name of {name}'])" if name != "surface" else ".item:has(h2)")
    rows = item.locator(".number")
    return {
        rows.nth(at).locator(".quantity").text_content(): rows.nth(at).locator(".value").text_content()
        for at in range(rows.count())
    }


def test_what_is_clicked_is_measured_and_saved(
    served: Any, results: Path, visit: Callable[..., Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = visit(served)
    page.wait_for_selector(".card")
    open_measuring(page, "hill")
    for tool, start, end in (
        ("Step", (0.35, 0.3), (0.65, 0.32)),
        ("Circle", (0.5, 0.5), (0.6, 0.5)),
        ("Angle", (0.35, 0.55), (0.45, 0.65)),
        ("Region", (0.3, 0.25), (0.7, 0.75)),
        ("Mask", (0.4, 0.7), (0.5, 0.72)),
    ):
        page.get_by_role("button", name=tool, exact=True).click()
        drag(page, start, end)
    page.get_by_label("L-filter").fill("400")
    page.get_by_label("L-filter").press("Tab")
    page.get_by_label("Sa of surface: at most, µm").fill("0.001")
    page.get_by_label("Sa of surface: at most, µm").press("Tab")
    page.wait_for_selector(".number[data-verdict=undecided]:has-text('without that of the pixel pitch')")
    page.get_by_label("± of the pixel pitch").fill("0.2")
    page.get_by_label("± of the pixel pitch").press("Tab")
    page.wait_for_selector(".number[data-verdict=fail]:has-text('Sa')")
    page.get_by_label("slopes beyond the balls'").check()
    calm(page)
    with page.expect_download() as saving:
        page.get_by_role("link", name="Save recipe").click()
    path = tmp_path / saving.value.suggested_filename
    saving.value.save_as(path)
    assert main(["measure", str(results / "hill"), "--recipe", str(path), "--json"]) == 1
    (record,) = json.loads(capsys.readouterr().out)
    assert record["recipe"]["l_filter_um"] == 400.0
    assert record["recipe"]["keep_extrapolated"] is True
    assert record["recipe"]["scale"]["pixel_pitch_share"] == 0.002
    assert len(record["recipe"]["mask"]) == 1
    for name in ("surface", "step 1", "angle 1"):
        shown = numbers(page, name)
        assert len(shown) > 0
        for one in (one for one in record["quantities"] if one["subject"] == name and one["value"] is not None):
            assert one["sentence"].startswith(f"{one['name']} {shown[one['name']]}")
    assert " ± " in numbers(page, "surface")["Sa"]


def test_no_uncertainty_is_unknown_while_it_is_computed(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    page.wait_for_selector(".card")
    open_measuring(page, "hill")
    page.route("**/measure?*samples=1*", lambda _: None)
    page.get_by_role("button", name="Distance", exact=True).click()
    page.get_by_role("button", name="Place in the middle").click()
    label = page.wait_for_selector(".lines .label:has-text('±')").text_content()
    assert label.endswith(" ± …")
    assert all(text.endswith(" ± …") for text in numbers(page, "distance 1").values())


@pytest.mark.slow
def test_labels_lie_over_neither_each_other_nor_a_handle(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    page.wait_for_selector(".card")
    open_measuring(page, "hill")
    for tool in ("Line", "Distance", "Circle", "Volume"):
        page.get_by_role("button", name=tool, exact=True).click()
        page.get_by_role("button", name="Place in the middle").click()
        page.wait_for_selector(f".item:has(input[aria-label='Name of {tool.lower()} 1'])")
    calm(page)
    boxes = [one.bounding_box() for one in page.locator(".lines .label").all()]
    assert len(boxes) == 4
    for at, one in enumerate(boxes):
        for other in boxes[:at]:
            beside = one["x"] + one["width"] <= other["x"] or other["x"] + other["width"] <= one["x"]
            assert beside or abs(one["y"] - other["y"]) > 10.0
    for handle in page.locator("[data-handle]").all():
        box = handle.bounding_box()
        place = [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2]
        assert page.evaluate("([x, y]) => document.elementFromPoint(x, y).dataset.handle !== undefined", place)


def test_undo_goes_back_and_redo_forward(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    page.wait_for_selector(".card")
    open_measuring(page, "hill")
    page.get_by_role("button", name="Line", exact=True).click()
    drag(page, (0.4, 0.4), (0.6, 0.4))
    page.wait_for_selector(".item:has(input[aria-label='Name of line 1'])")
    page.keyboard.press("Control+z")
    page.wait_for_selector(".item:has(input[aria-label='Name of line 1'])", state="detached")
    page.keyboard.press("Control+Shift+z")
    page.wait_for_selector(".item:has(input[aria-label='Name of line 1'])")
    calm(page)
    before = page.get_by_label("to right", exact=True).input_value()
    x, y = middle_of(page, "[data-handle='profile:0:1']")
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 40, y, steps=3)
    page.mouse.up()
    assert float(page.get_by_label("to right", exact=True).input_value()) > float(before)


def test_the_keyboard_alone_measures(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    page.wait_for_selector(".card")
    open_measuring(page, "hill")
    page.keyboard.press("3")  # without a click on the relief
    page.wait_for_selector(".toolbar [aria-pressed=true]:text('3-D')")
    page.keyboard.press("3")
    page.get_by_role("button", name="Distance", exact=True).focus()
    page.keyboard.press("Enter")
    page.get_by_role("button", name="Place in the middle").focus()
    page.keyboard.press("Enter")
    page.wait_for_selector(".item:has(input[aria-label='Name of distance 1'])")
    page.locator(".places summary:visible").focus()
    page.keyboard.press("Enter")
    page.get_by_label("from right", exact=True).fill("300")
    page.get_by_label("from right", exact=True).press("Enter")
    calm(page)
    assert " ± " in numbers(page, "distance 1")["in height"]


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.slow)])
def test_measuring_passes_the_accessibility_scan(served: Any, visit: Callable[..., Any], scheme: str) -> None:
    page = visit(served, color_scheme=scheme)
    page.wait_for_selector(".card")
    open_measuring(page, "hill")
    for tool in ("Step", "Sphere"):
        page.get_by_role("button", name=tool, exact=True).click()
        page.get_by_role("button", name="Place in the middle").click()
    for words, limit in (("at least", "10"), ("at most", "30")):
        page.get_by_label(f"Sa of surface: {words}, µm").fill(limit)
        page.get_by_label(f"Sa of surface: {words}, µm").press("Tab")
        calm(page)
    page.wait_for_selector(".charts .chart")
    found = axe.Axe().run(page).response["violations"]
    assert [(one["id"], [node["target"] for node in one["nodes"]]) for one in found] == []


def test_a_bad_recipe_file_is_refused_in_a_sentence(served: Any, visit: Callable[..., Any], tmp_path: Path) -> None:
    page = visit(served)
    page.wait_for_selector(".card")
    open_measuring(page, "hill")
    path = tmp_path / "bad.toml"
    path.write_text("form = 'cube'\n")
    page.get_by_label("Open", exact=True).set_input_files(path)
    page.wait_for_selector(".problem:has-text('is not a form')")
    assert all("400" in problem for problem in visit.problems)  # type: ignore[attr-defined]
    visit.problems.clear()  # type: ignore[attr-defined]
    path.write_text("[[step]]\nname = 'kept'\nfrom_um = [100, 600]\nto_um = [3000, 640]\n")
    page.get_by_label("Open", exact=True).set_input_files(path)
    page.wait_for_selector(".item:has(input[aria-label='Name of kept'])")


@pytest.mark.slow
def test_one_recipe_measures_many_scans_with_their_trend(
    served: Any, visit: Callable[..., Any], tmp_path: Path
) -> None:
    page = visit(served)
    page.wait_for_selector(".card")
    open_measuring(page, "hill")
    page.get_by_label("Sa of surface: at most, µm").fill("1")
    page.get_by_label("Sa of surface: at most, µm").press("Tab")
    page.get_by_label("± of the pixel pitch").fill("0.2")
    page.get_by_label("± of the pixel pitch").press("Tab")
    page.get_by_label("± is").select_option("2")
    calm(page)
    page.get_by_role("button", name="Measure many scans …").click()
    page.get_by_role("button", name="Measure", exact=True).click()
    page.wait_for_selector(".count:has-text('3 of 3 scans measured')")
    assert page.locator(".numbers tbody tr").count() == 3
    assert page.locator(".numbers td.fail").count() >= 1
    page.wait_for_selector(".trend .chart .dot")
    words = page.locator(".trend p").first.text_content()
    assert "control limits" in words
    assert " µm (± not known), range" in words, "one of the results states none"
    assert "bars: ± (k = 2)" in (page.locator(".trend p").nth(1).text_content() or "")
    found = axe.Axe().run(page).response["violations"]
    assert [(one["id"], [node["target"] for node in one["nodes"]]) for one in found] == []
    with page.expect_download() as saving:
        page.get_by_role("link", name="Save table as CSV").click()
    saving.value.save_as(tmp_path / "numbers.csv")
    head, *rows = (tmp_path / "numbers.csv").read_text().splitlines()
    assert head.startswith('scan,taken,"surface: Sa, µm",± of surface: Sa,verdict of surface: Sa')
    assert len(rows) == 3

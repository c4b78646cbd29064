"""The page in a real browser, which draws with its own software renderer; see .ci/test-deps for the browser."""

import csv
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from drawn_frames import settle

from device.bundles.scan import ScanBundle
from device.surface import HeightMap
from host_sync.render.shading import shade

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")


def open_scan(page: Any, title: str) -> None:
    page.click(f".card a:has(.name:text-is({title!r}))")
    page.wait_for_selector(".stage[data-ready]")


def stage_picture(page: Any) -> np.ndarray:
    """The stage as it is on the screen, R, G, B."""
    data = page.locator(".surface").screenshot()
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def set_slider(page: Any, label: str, value: int) -> None:
    page.get_by_label(label, exact=True).fill(str(value))


def test_the_list_opens_and_is_searched(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    page.wait_for_selector(".card")
    assert "code" not in page.url
    assert page.locator(".card").count() == 4
    page.fill("input[type=search]", "moved")
    page.wait_for_selector(".count:text-is('1 scan')")
    assert page.locator(".card .name").all_text_contents() == ["moved"]
    page.fill("input[type=search]", "no such thing")
    page.wait_for_selector(".count:text-is('0 scans')")


def test_pixels_are_as_bright_as_computed(served: Any, results: Path, visit: Callable[..., Any]) -> None:
    page = visit(served)
    open_scan(page, "hill")
    page.select_option("select:has(option[value=white])", "white")
    page.get_by_role("button", name="1:1").click()
    page.wait_for_selector(".stage[data-level='0']")
    set_slider(page, "Exaggerate", 0)
    z_um = tifffile.imread(results / "hill" / "height_um.tif")
    row, column = slice(20, 140), slice(60, 260)  # between the tools above and the legend below
    seen = []
    for azimuth, elevation in ((135, 40), (20, 25)):
        set_slider(page, "Direction", azimuth)
        set_slider(page, "Elevation", elevation)
        settle(page)
        shown = stage_picture(page)
        expected = 255.0 * shade(HeightMap(z_um, 12.0), azimuth, elevation)
        top, left = ((size - whole) / 2 for size, whole in zip(shown.shape[:2], z_um.shape, strict=True))
        place = np.float32([[1, 0, left], [0, 1, top]])
        moved = cv2.warpAffine(np.nan_to_num(expected, nan=255.0), place, shown.shape[1::-1])
        rows = slice(int(top) + row.start, int(top) + row.stop)
        columns = slice(int(left) + column.start, int(left) + column.stop)
        off = np.abs(shown[rows, columns].astype(float) - moved[rows, columns, None])
        assert off.mean() < 1.0
        assert np.percentile(off, 99.0) < 3.0
        seen.append(shown[rows, columns].astype(float))
    assert np.abs(seen[1] - seen[0]).mean() > 10.0


def test_zoomed_in_each_pixel_is_one_square_of_its_own_brightness(
    served: Any, results: Path, visit: Callable[..., Any]
) -> None:
    page = visit(served)
    open_scan(page, "hill")
    page.select_option("select:has(option[value=white])", "white")
    set_slider(page, "Exaggerate", 0)
    page.get_by_role("button", name="1:1").click()
    for _ in range(6):
        page.get_by_role("button", name="+", exact=True).click()
    page.wait_for_selector(".stage[data-level='0']")
    settle(page)
    shown = stage_picture(page)[..., 0].astype(float)
    z_um = tifffile.imread(results / "hill" / "height_um.tif")
    expected = 255.0 * shade(HeightMap(z_um, 12.0))
    zoom = 1.5**6
    rows, columns = np.mgrid[90:115, 125:155]
    across = (columns - (z_um.shape[1] - 1) / 2) * zoom + shown.shape[1] / 2
    down = (rows - (z_um.shape[0] - 1) / 2) * zoom + shown.shape[0] / 2
    for off in (-0.35, 0.0, 0.35):  # within a pixel nothing changes
        seen = shown[(down + off * zoom).astype(int), (across + off * zoom).astype(int)]
        assert np.abs(seen - expected[rows, columns]).max() < 2.5


def test_the_light_is_dragged_over_the_relief(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    open_scan(page, "hill")
    page.get_by_role("button", name="Light", exact=True).click()
    box = page.locator(".surface").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x + 40, y)
    page.mouse.down()
    page.mouse.move(x + 5, y + 100)
    page.mouse.move(x, y + 150)
    page.mouse.up()
    assert page.get_by_label("Direction", exact=True).input_value() == "270"
    expected = np.degrees(np.arccos(150 / (min(box["width"], box["height"]) / 2)))
    assert float(page.get_by_label("Elevation", exact=True).input_value()) == pytest.approx(expected, abs=1.0)


def test_in_space_the_relief_turns_and_hides_what_lies_behind(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    open_scan(page, "hill")
    flat = stage_picture(page)
    page.get_by_role("button", name="3-D").click()
    settle(page)
    seen = stage_picture(page)
    page.locator(".surface canvas").focus()
    page.keyboard.press("ArrowRight")
    settle(page)
    turned = stage_picture(page)
    middle = np.s_[150:400, 250:500]
    assert np.abs(seen[middle].astype(int) - flat[middle]).mean() > 3.0
    assert np.abs(seen[middle].astype(int) - turned[middle]).mean() > 1.0
    box = page.locator(".surface").bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 300)
    page.mouse.down()
    page.mouse.move(box["x"] + 380, box["y"] + 330, steps=3)
    page.mouse.up()
    settle(page)
    assert np.abs(stage_picture(page)[middle].astype(int) - turned[middle]).mean() > 1.0


def test_a_profile_that_is_drawn_is_the_array(served: Any, results: Path, visit: Callable[..., Any]) -> None:
    page = visit(served)
    open_scan(page, "hill")
    page.get_by_role("button", name="1:1").click()
    for _ in range(3):
        page.get_by_role("button", name="+", exact=True).click()
    page.get_by_role("button", name="Profile", exact=True).click()
    page.wait_for_selector(".drawer:not([hidden])")
    settle(page)
    box = page.locator(".surface").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2 + 1.0
    page.mouse.move(x - 60, y)
    page.mouse.down()
    page.mouse.move(x + 10, y, steps=2)
    page.mouse.move(x + 60, y, steps=2)
    page.mouse.up()
    page.wait_for_selector("a:text('Save as CSV'):visible")
    page.wait_for_function("() => document.querySelector('.panel input[max=\"279\"]').value !== ''")
    page.wait_for_selector("[aria-busy=false]")
    settle(page)
    href = page.get_by_role("link", name="Save as CSV").get_attribute("href")
    text = page.evaluate("async (address) => (await fetch(address)).text()", href)
    table = list(csv.DictReader(io.StringIO(text)))
    row, first, last = (
        round(float(table[at][name])) for at, name in ((0, "row_px"), (0, "column_px"), (-1, "column_px"))
    )
    assert (abs(row - 105), last - first) == (pytest.approx(0, abs=1), pytest.approx(120 / 1.5**3, abs=1))
    z_um = tifffile.imread(results / "hill" / "height_um.tif")[row, first : last + 1]
    np.testing.assert_allclose([float(line["height_um"]) for line in table], z_um, rtol=1e-7)
    page.locator(".plot-cursor").fill("30")
    said = page.locator(".plot-cursor").get_attribute("aria-valuetext")
    assert f"{z_um[30]:.1f} ± 1.5 µm" in said
    assert "µm" in page.locator(".plot .axis").all_text_contents()[1]


def test_two_scans_are_compared_and_their_shift_is_said(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    for title in ("hill", "moved"):
        page.get_by_label(f"Compare {title}").check()
    page.get_by_role("link", name="Compare the two").click()
    page.wait_for_selector("button:text-is('Difference'):not([disabled])")
    said = page.locator(".found").text_content()
    numbers = [float(number) for number in re.findall(r"[\d.]+(?= µm)", said)]
    assert numbers[:2] == pytest.approx([48.0, 84.0], abs=2.0)
    assert ("down" in said, "left" in said, "rms" in said) == (True, True, True)
    assert page.locator(".side .stage").count() == 2
    for _ in range(3):
        page.locator(".side .stage").first.get_by_role("button", name="+", exact=True).click()
    settle(page)
    scale = page.locator(".side .scale-bar").first.text_content()
    page.get_by_role("button", name="Difference").click()
    page.wait_for_selector(".alone .stage[data-ready]")
    settle(page)
    assert page.locator(".alone .scale-bar").text_content() == scale
    page.locator(".alone .stage").get_by_role("button", name="1:1").click()
    settle(page)
    scale = page.locator(".alone .scale-bar").text_content()
    page.get_by_role("button", name="Side by side").click()
    settle(page)
    assert page.locator(".side .scale-bar").all_text_contents() == [scale, scale]
    page.get_by_role("button", name="Difference").click()
    assert page.locator(".alone .legend-title").text_content() == "Difference, µm"


def test_a_video_shows_its_frames(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    open_scan(page, "a film")
    page.get_by_role("button", name="Through the middle").click()
    page.wait_for_selector(".drawer:not([hidden])")
    page.get_by_label("Frame", exact=True).fill("0")
    page.wait_for_selector(".player[aria-busy=false] output:text('1 of 5')")
    page.locator(".surface canvas").focus()
    settle(page)
    before = stage_picture(page)
    page.get_by_label("Frame", exact=True).fill("4")
    page.wait_for_selector(".player[aria-busy=false] output:text('5 of 5')")
    settle(page)
    middle = np.s_[100:300, 250:500]
    assert np.abs(stage_picture(page)[middle].astype(int) - before[middle]).mean() > 5.0
    page.get_by_role("button", name="Play").click()
    page.wait_for_selector(".player output:text('3 of 5')")
    page.get_by_role("button", name="Pause").click()


def test_the_keyboard_alone_will_do(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    page.wait_for_selector(".card")

    def tab_to(selector: str) -> None:
        for _ in range(60):
            page.keyboard.press("Tab")
            if page.evaluate("(selector) => document.activeElement.matches(selector)", selector):
                return
        pytest.fail(f"{selector} cannot be reached by Tab")

    tab_to(".card a")
    page.keyboard.press("Enter")
    page.wait_for_selector(".stage[data-ready]")
    tab_to(".surface canvas")
    page.wait_for_selector(".reading:has-text('row')")
    reading = page.locator(".reading").text_content()
    page.keyboard.press("+")
    page.keyboard.press("ArrowRight")
    page.wait_for_function("(old) => document.querySelector('.reading').textContent !== old", arg=reading)
    page.keyboard.press("Shift+ArrowRight")
    assert page.get_by_label("Direction", exact=True).input_value() == "129"
    page.keyboard.press("3")
    page.wait_for_selector(".toolbar [aria-pressed=true]:text('3-D')")
    page.keyboard.press("?")
    page.wait_for_selector("dialog[open]")
    page.keyboard.press("Escape")
    tab_to(".panel input[max='209']")
    for value in ("30", "10", "30", "90"):
        page.keyboard.type(value)
        page.keyboard.press("Tab")
    page.wait_for_selector(".drawer:not([hidden])")
    assert "Length 960 µm" in page.locator(".plot-summary").text_content()


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.slow)])
def test_every_part_passes_the_accessibility_scan(served: Any, visit: Callable[..., Any], scheme: str) -> None:
    page = visit(served, color_scheme=scheme)
    keys = served.keys()
    page.wait_for_selector(".card img")
    places = {"scan": f"#/scan/{keys['hill']}"}
    if scheme == "light":
        places = {"list": None} | places | {"compare": f"#/compare/{keys['hill']}/{keys['moved']}"}
    for place, address in places.items():
        if address:
            page.goto(f"{served.origin}/{address}")
            page.wait_for_selector(".stage[data-ready]")
        if place == "scan":
            page.get_by_role("button", name="Through the middle").click()
            page.wait_for_selector(".drawer:not([hidden])")
        found = axe.Axe().run(page).response["violations"]
        assert [(place, one["id"], [node["target"] for node in one["nodes"]]) for one in found] == []


def test_names_from_an_enemy_stay_words(
    served: Any,
    serve: Callable[[Path], Any],
    library: tuple[Path, list[ScanBundle]],
    world: Any,
    visit: Callable[..., Any],
) -> None:
    page = visit(served)
    page.wait_for_selector(".card")
    open_scan(page, world.HOSTILE)
    assert page.locator(".warning.doubts").text_content() == f"⚠ Doubt: reconstruction: a warning {world.HOSTILE}"
    (words,) = page.locator(".warning:not(.doubts):not([hidden])").all_text_contents()
    assert words == f"reconstruction: a warning {world.HOSTILE}"
    assert page.locator("#where").text_content() == world.HOSTILE
    page.get_by_role("button", name="Through the middle").click()
    page.wait_for_selector(".drawer:not([hidden])")
    assert page.locator(".plot title").text_content() == f"Profile of {world.HOSTILE}"
    assert page.evaluate("window.stolen") is None
    page = visit(serve(library[0]))
    page.wait_for_selector(f".facts:has-text({world.HOSTILE[:20]!r})")
    page.get_by_label("Verdict").select_option("retake")
    page.wait_for_selector(".count:text-is('1 scan')")
    assert page.locator(".card .name").all_text_contents() == ["plate"]
    assert page.evaluate("window.stolen") is None


def test_what_is_not_there_is_said_with_a_way_back(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    page.wait_for_selector(".card")
    page.goto(f"{served.origin}/#/scan/none")
    page.wait_for_selector("[role=alert]:has-text('no such scan')")
    page.get_by_role("link", name="Back to the list").click()
    page.wait_for_selector(".card")
    assert all("404" in problem for problem in visit.problems)  # type: ignore[attr-defined]
    visit.problems.clear()  # type: ignore[attr-defined]


def test_on_a_telephone_nothing_is_cut_off(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served, has_touch=True, is_mobile=True, device_scale_factor=2)
    page.set_viewport_size({"width": 390, "height": 844})
    page.wait_for_selector(".card")
    open_scan(page, "hill")
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    assert page.evaluate("document.querySelector('main').scrollWidth") == 390
    box = page.locator(".toolbar").bounding_box()
    page.touchscreen.tap(box["x"] + 150, box["y"] + 20)
    page.get_by_label("Level curves").check()
    page.evaluate("document.querySelector('main').scrollTop = 0")
    before = page.locator(".scale-bar").text_content()
    touch = page.context.new_cdp_session(page)
    for kind, apart in (("touchStart", 40), ("touchMove", 80), ("touchMove", 130), ("touchEnd", None)):
        fingers = [] if apart is None else [{"x": 195 - apart, "y": 300}, {"x": 195 + apart, "y": 300}]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})
    settle(page)
    assert page.locator(".scale-bar").text_content() != before


def overlap(page: Any, first: str, second: str) -> bool:
    """Return whether two elements share a pixel of the screen."""
    one, other = (page.locator(selector).first.bounding_box() for selector in (first, second))
    return all(
        one[at] < other[at] + other[size] and other[at] < one[at] + one[size]
        for at, size in (("x", "width"), ("y", "height"))
    )


def shown_columns(page: Any) -> float:
    """Width of the relief on the screen, by what its own colours cover, as a fraction of the stage's."""
    picture = stage_picture(page).astype(int)
    inside = (np.abs(picture - picture[2, 2]).max(axis=2) > 12).mean(axis=0) > 0.2
    return float(inside.mean())


def test_plots_leave_the_relief_whole_and_nothing_lies_over_it(served: Any, visit: Callable[..., Any]) -> None:
    page = visit(served)
    page.set_viewport_size({"width": 1280, "height": 800})
    open_scan(page, "moved")
    before = shown_columns(page)
    page.get_by_role("button", name="Through the middle").click()
    page.wait_for_selector(".plot .line")
    settle(page)
    handle, surface = (page.locator(one).first.bounding_box() for one in (".lines .end", ".surface"))
    assert surface["height"] > 250
    assert shown_columns(page) < before
    assert surface["x"] < handle["x"] < surface["x"] + surface["width"]
    for cover in (".legend", ".scale-bar", ".toolbar"):
        assert not overlap(page, ".surface", cover)
    page.get_by_role("button", name="3-D").click()
    page.get_by_role("button", name="Clear").click()
    page.get_by_role("button", name="3-D").click()
    settle(page)
    assert shown_columns(page) == pytest.approx(before, abs=0.02)


def test_numbers_pictures_and_links_are_taken_along(served: Any, visit: Callable[..., Any], tmp_path: Path) -> None:
    page = visit(served, permissions=["clipboard-read", "clipboard-write"])
    open_scan(page, "hill")

    def copied(button: str) -> str:
        page.evaluate("() => navigator.clipboard.writeText('')")
        page.get_by_role("button", name=button, exact=True).click()
        # A predicate of `wait_for_function` that returns a promise holds at once.
        return str(
            page.evaluate("""async () => {
            for (;;) {
                const text = await navigator.clipboard.readText();
                if (text !== '') return text;
                await new Promise(requestAnimationFrame);
            }
        }""")
        )

    assert copied("Copy link") == f"{served.access.link}{page.evaluate('location.hash')}"
    page.get_by_role("button", name="Through the middle").click()
    page.wait_for_selector(".plot .line")
    assert copied("Copy").startswith("row_px,column_px,distance_um,height_um")
    with page.expect_download() as saving:
        page.get_by_role("button", name="Save picture").click()
    saving.value.save_as(tmp_path / saving.value.suggested_filename)
    picture = cv2.imread(str(tmp_path / "hill.png"))
    assert picture.shape[1] == page.locator(".surface").bounding_box()["width"]
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 1000
    page.evaluate(
        """() => {
            const data = new DataTransfer();
            const text = "[[distance]]\\nname = 'dropped'\\nfrom_um = [9, 9]\\nto_um = [900, 9]";
            data.items.add(new File([text], "own.toml"));
            dispatchEvent(new DragEvent("drop", { dataTransfer: data }));
        }"""
    )
    page.wait_for_selector(".item:has(input[aria-label='Name of dropped']) .value")
    assert "\ndropped\t" in copied("Copy numbers")
    page.emulate_media(media="print")
    assert page.locator(".toolbar").is_hidden()
    assert page.locator(".item .value").first.is_visible()


def test_scans_of_one_name_are_distinguished(
    serve: Callable[..., Any], world: Any, visit: Callable[..., Any], tmp_path: Path
) -> None:
    for day in ("monday", "tuesday"):
        world.write_result(tmp_path / day / "coin", world.surface(), "coin")
    page = visit(serve(tmp_path))
    page.wait_for_selector(".card")
    assert [words.partition(" · ")[0] for words in page.locator(".facts").all_text_contents()] == [
        "monday/coin",
        "tuesday/coin",
    ]
    assert page.get_by_label("Compare coin monday/coin").count() == 1
    page.evaluate(
        """() => {
            const data = new DataTransfer();
            data.items.add(new File(["x"], "own.toml"));
            dispatchEvent(new DragEvent("drop", { dataTransfer: data }));
        }"""
    )
    assert page.get_by_role("alert").text_content().startswith("Open a scan first")

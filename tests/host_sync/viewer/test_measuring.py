"""Measuring from the page: the numbers are those of `retrosync measure` with the recipe that the page saves."""

import http.client
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from device.bundles.scan import ScanBundle
from host_sync.cli.main import main
from host_sync.viewer.app import MAX_BODY
from host_sync.viewer.catalogue import Catalogue, ListFilter

RECIPE = {
    "region_um": [200, 200, 2600, 2000],
    "form": "plane",
    "l_filter_um": 400,
    "parameters": ["Sa", "functional"],
    "step": [{"name": "step 1", "from_um": [100, 600], "to_um": [3000, 640], "width_um": 100}],
    "tolerance": [{"number": "Sa", "low": 0.1, "high": 500}],
    "scale": {"pixel_pitch_share": 0.001},
}


def post(served: Any, path: str, body: bytes) -> tuple[int, Any]:
    connection = http.client.HTTPConnection("127.0.0.1", served.access.port, timeout=60)
    try:
        headers = {"Host": served.origin.removeprefix("http://"), "Cookie": served.cookie}
        connection.request("POST", path, body, headers)
        answer = connection.getresponse()
        data = answer.read()
        return answer.status, json.loads(data) if answer.getheader("content-type") == "application/json" else data
    finally:
        connection.close()


def measured(served: Any, title: str, recipe: dict[str, Any], samples: int = 1) -> Any:
    status, answer = post(
        served, f"/api/scan/{served.keys()[title]}/measure?samples={samples}", json.dumps(recipe).encode()
    )
    assert status == 200, answer
    return answer


def test_the_page_measures_as_the_command_does(
    served: Any, results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = measured(served, "hill", RECIPE)
    path = tmp_path / "recipe.toml"
    path.write_text(answer["text"])
    # Partly done: the hill has no step, which the page and the command state alike.
    assert main(["measure", str(results / "hill"), "--recipe", str(path), "--json"]) == 1
    (record,) = json.loads(capsys.readouterr().out)
    assert len(record["quantities"]) > 8
    for shown, one in zip(answer["quantities"], record["quantities"], strict=True):
        assert {name: shown[name] for name in one} == one
        assert shown["number"] in one["sentence"]
    (sa,) = [one for one in answer["quantities"] if one["name"] == "Sa"]
    assert sa["limits"] == {"low": 0.1, "high": 500.0, "verdict": "pass"}
    assert " ± " in sa["number"]


def test_without_samples_the_values_stay_and_no_uncertainty_is_stated(served: Any) -> None:
    quick, whole = (measured(served, "hill", RECIPE, samples) for samples in (0, 1))
    for one, other in zip(quick["quantities"], whole["quantities"], strict=True):
        assert one["value"] == other["value"]
        assert one["uncertainty"] is None


def test_the_core_line_is_that_of_the_parameters(served: Any) -> None:
    answer = measured(served, "hill", RECIPE, 0)
    top, bottom = answer["ratio"]["core_um"]
    (sk,) = [one["value"] for one in answer["quantities"] if one["name"] == "Sk"]
    assert top - bottom == pytest.approx(sk, rel=1e-9)
    assert answer["ratio"]["height_um"] == sorted(answer["ratio"]["height_um"], reverse=True)
    assert sum(answer["histogram"]["percent"]) == pytest.approx(100.0)


def test_a_saved_recipe_comes_back_as_its_keys(served: Any) -> None:
    text = measured(served, "hill", RECIPE, 0)["text"]
    again = measured(served, "hill", {"text": text}, 0)
    assert again["text"] == text
    assert again["recipe"]["step"][0]["to_um"] == [3000.0, 640.0]


@pytest.mark.parametrize("title", ["a film", "moved"])
def test_what_has_no_samples_is_measured_without_them(served: Any, title: str) -> None:
    answer = measured(served, title, {"parameters": ["Sa"], "form": "none"})
    (sa,) = answer["quantities"]
    assert sa["value"] > 1.0
    assert sa["uncertainty"] is None


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"{", "is not JSON"),
        (b"[1]", "is not JSON"),
        (b'{"form": "cube"}', "is not a form"),
        (b'{"stepp": []}', "accepted keys are"),
        (b'{"text": "form = "}', "is not TOML"),
        (b'{"region_um": [9000, 9000, 9100, 9100]}', "inside it"),
    ],
)
def test_what_is_no_recipe_is_refused_in_a_sentence(served: Any, body: bytes, words: str) -> None:
    status, answer = post(served, f"/api/scan/{served.keys()['hill']}/measure", body)
    assert status == 400
    assert words in answer["error"]


def test_a_body_without_end_is_refused(served: Any) -> None:
    status, answer = post(served, f"/api/scan/{served.keys()['hill']}/measure", b" " * (MAX_BODY + 1))
    assert status == 413
    assert b"too large" in answer


def test_without_the_token_nothing_is_measured(served: Any, serve: Callable[[Path], Any]) -> None:
    assert served.ask(f"/api/scan/{served.keys()['hill']}/measure", "POST")[0] == 403


def test_numbers_of_quick_looks_and_videos_carry_their_doubts(
    serve: Callable[[Path], Any], library: tuple[Path, list[ScanBundle]], results: Path, tmp_path: Path
) -> None:
    root, _ = library
    asked = {"parameters": ["Sa"]}
    quick = next(entry for entry in Catalogue(root).list(ListFilter()).entries if entry.kind == "quick look")
    expected = ["reconstruction: the handheld's verdict is retake: as pressed"]
    assert list(quick.doubts) == expected
    answer = measured(serve(root), quick.title, asked, samples=0)
    assert answer["doubts"] == expected
    assert all(set(expected) <= set(one["doubts"]) for one in answer["quantities"])
    film = tmp_path / "films" / "film"
    shutil.copytree(results / "film", film)
    record = json.loads((film / "result.json").read_text())
    doubts = [
        {"kind": "failed calibration", "reason": "held-out error"},
        {"kind": "uncovered sector", "reason": "no ball", "sectors": ["upper left corner"]},
    ]
    (film / "result.json").write_text(json.dumps(record | {"doubts": doubts}))
    answer = measured(serve(film.parent), "a film", asked | {"region_um": [2000, 1500, 2600, 2000]}, samples=0)
    assert answer["doubts"] == ["failed calibration: held-out error", "uncovered sector: no ball"]
    for one in answer["quantities"]:  # the region lies in another sector
        assert [words for words in one["doubts"] if "sector" in words or "calibration" in words] == answer["doubts"][:1]

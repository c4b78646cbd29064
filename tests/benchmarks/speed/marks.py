"""The marks: how each is computed, and when it is met. A mark without its figures is neither met nor missed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

Figures = Mapping[str, Any]
IDLE_SCALING = 1.8
"""Two processes that only count must reach this relative to one; else no two idle cores are available."""


MAX_OVER_EXACT = 1.01
MAX_DIFFERENCE_DEG, MAX_OTHER_PIXELS = 1e-3, 1e-4
"""Mean angle between our slopes and plain numpy's, and fraction of the pixels that only one of them finds valid."""

MAX_FRAME_OFF_SIGMA = 0.3
"""Difference of nine tenths of a video frame's heights to the frame reconstructed alone, in its uncertainties."""

MAX_HEIGHT_ERROR, MAX_OVER_UNTABULATED = 0.2, 1.05
"""Height error of the quick look, relative to the root mean square of the relief, and relative to the error of the map
without tables."""

MAX_SCAN_ERROR = 0.1
"""Height error of a scan, relative to the root mean square of the relief."""

PYAMG = ("pyamg ruge-stuben", "pyamg smoothed aggregation")


@dataclass(frozen=True)
class Mark:
    """One mark and its rule.

    value : from the figures; raises KeyError, or returns None, when a figure or a peer is missing
    requires : whether it counts at all, for example an accuracy that must not be traded for speed
    """

    name: str
    item: int
    words: str
    sense: Literal["at least", "at most"]
    limit: float
    value: Callable[[Figures], float | None]
    requires: Callable[[Figures], bool] = lambda _: True

    def judged(self, figures: Figures) -> dict[str, Any]:
        """Value, limit and whether it is met: True, False, or None where undecided."""
        try:
            value = self.value(figures)
            countable = value is not None and self.requires(figures)
        except KeyError:
            value, countable = None, True
        met = None
        if value is not None:
            enough = value >= self.limit if self.sense == "at least" else value <= self.limit
            met = enough and countable
        return {
            "value": value,
            "mark": self.limit,
            "met": met,
            "sense": self.sense,
            "item": self.item,
            "words": self.words,
        }


def judge(figures: Figures) -> dict[str, dict[str, Any]]:
    """Every mark by name."""
    return {mark.name: mark.judged(figures) for mark in MARKS}


def _ms(figures: Figures, *path: str) -> float:
    return float(_at(figures, *path)["min_ms"])


def _at(figures: Figures, *path: str) -> Any:
    for name in path:
        figures = figures[name]
    return figures


def _over_exact(figures: Figures, part: str) -> float:
    """Error of the exact solution combined with our distance to it, relative to the former; worst of several fields."""
    return float(_at(figures, "integration", part, "accuracy", "over_exact"))


def _exact_enough(part: str) -> Callable[[Figures], bool]:
    return lambda f: _over_exact(f, part) <= MAX_OVER_EXACT


def _faster(part: str, peer: str) -> Callable[[Figures], float]:
    return lambda f: _ms(f, "integration", part, peer) / _ms(f, "integration", part, "ours")


def _beside_pyamg(figures: Figures) -> float:
    """Relative to the faster of pyamg's two solvers, on the same system."""
    part: Figures = _at(figures, "integration", "beside pyamg")
    return float(min(part[name]["min_ms"] for name in PYAMG) / part["ours, two-point"]["min_ms"])


def _both_exact(figures: Figures) -> bool:
    """Whether ours and both of pyamg's found the solution of that system, within noise."""
    part: Figures = _at(figures, "integration", "beside pyamg")
    return all(part[name]["over_exact"] <= MAX_OVER_EXACT for name in ("ours, two-point", *PYAMG))


def _slopes_agree(figures: Figures) -> bool:
    """Whether our kernel gives the slopes of plain numpy on the same pixels."""
    ours = _at(figures, "gradients", "ours")
    return bool(
        ours["mean_difference_to_numpy_deg"] <= MAX_DIFFERENCE_DEG and ours["share_of_other_pixels"] <= MAX_OTHER_PIXELS
    )


def _frames_agree(name: str) -> Callable[[Figures], bool]:
    return lambda f: _at(f, "video", name, "off_sigma_p90") <= MAX_FRAME_OFF_SIGMA


def _look_is_right(figures: Figures) -> bool:
    """Whether the timed quick look shows the true coin as accurately as the map itself would."""
    look = _first(_at(figures, "handheld"))
    most = min(MAX_HEIGHT_ERROR, MAX_OVER_UNTABULATED * look["untabulated_height_error_share"])
    return bool(look["height_error_share"] <= most)


def _largest_scan(figures: Figures) -> Any:
    return max(_at(figures, "pipeline").values(), key=lambda scan: scan["megapixels"])


def _scan_is_right(figures: Figures) -> bool:
    """Whether the timed scan shows the true coin."""
    return bool(_largest_scan(figures)["height_error_share"] <= MAX_SCAN_ERROR)


def _workers(figures: Figures) -> float | None:
    """None while other work keeps the cores busy."""
    part = _at(figures, "two workers")
    return part["scaling"] if part["scaling_of_counting"] >= IDLE_SCALING else None


def _batch(figures: Figures) -> float | None:
    """None while other work keeps the cores busy."""
    part = _at(figures, "two workers")
    return float(part["batch"]["two_over_one"]) if part["scaling_of_counting"] >= IDLE_SCALING else None


def _first(figures: Mapping[str, Any]) -> Any:
    return next(iter(figures.values()))


def _per_pixel(large: tuple[str, ...], small: tuple[str, ...]) -> Callable[[Figures], float]:
    return lambda f: _ms(f, *large) / _ms(f, *small) / _at(f, "sizes", "large_over_small")


def _pipeline_per_pixel(figures: Figures) -> float | None:
    """Largest scan relative to the one nearest to 1.5 MP."""
    scans = list(_at(figures, "pipeline").values())
    small = min(scans, key=lambda scan: abs(scan["megapixels"] - 1.5))
    large = _largest_scan(figures)
    if small is large:
        return None
    return float(large["min_ms"] / large["megapixels"] / (small["min_ms"] / small["megapixels"]))


def _identical_lights(figures: Figures) -> bool:
    """Whether three lights give the heights and ± of three channels, to the last bit."""
    return bool(_at(figures, "lights", "three_lights_identical"))


def _lights_cpu(figures: Figures, name: str, other: str) -> float:
    return float(_at(figures, "lights", name, "cpu_ms") / _at(figures, "lights", other, "cpu_ms"))


def _press(name: str) -> Callable[[Figures], float]:
    return lambda f: float(_at(f, "one press", name))


MARKS = (
    Mark("unweighted_over_dctn", 1, "full rectangle: times as fast as scipy dctn with 2 workers", "at least", 3.0,
         _faster("unweighted", "scipy dctn, 2 workers"), _exact_enough("unweighted")),
    Mark("unweighted_over_floor", 1, "full rectangle: times the time of reading p, q and writing z", "at most", 10.0,
         lambda f: 1.0 / _faster("unweighted", "floor")(f), _exact_enough("unweighted")),
    Mark("unweighted_error", 1, "full rectangle: what is added to the exact solution's error, %", "at most", 1.0,
         lambda f: 100.0 * (_over_exact(f, "unweighted") - 1.0)),
    Mark("weighted_over_dctn", 2, "weights and holes: times as fast as dctn, which has neither", "at least", 1.0,
         _faster("weighted", "scipy dctn, 2 workers"), _exact_enough("weighted")),
    Mark("weighted_error", 2, "weights and holes: what is added to the exact solution's error, %", "at most", 1.0,
         lambda f: 100.0 * (_over_exact(f, "weighted") - 1.0)),
    Mark("weighted_over_pyamg", 2, "weights and holes, 1456x1088: times as fast as the quicker of pyamg's", "at least",
         100.0, _beside_pyamg, _both_exact),
    Mark("agreement_with_direct_px", 2, "weights and holes: largest difference to the sparse direct solution, px",
         "at most", 1e-4, lambda f: _at(f, "integration", "beside direct", "difference", "largest_px")),
    Mark("gradients_over_network", 3, "slopes per pixel: share of the peer network's time", "at most", 0.07,
         lambda f: _ms(f, "gradients", "ours") / _ms(f, "gradients", "torch network"), _slopes_agree),
    Mark("pipeline_s", 4, "raw file to results on disk, largest frame, without the sigma map, s", "at most", 1.5,
         lambda f: 1e-3 * _largest_scan(f)["without sigma"]["min_ms"]),
    Mark("sigma_map_s", 4, "the sigma map of the same frame, s", "at most", 2.0,
         lambda f: 1e-3 * (_largest_scan(f)["min_ms"] - _largest_scan(f)["without sigma"]["min_ms"])),
    Mark("pipeline_whole_s", 4, "raw file to results on disk, largest frame, sigma map included, s", "at most", 2.5,
         lambda f: 1e-3 * _largest_scan(f)["min_ms"], _scan_is_right),
    Mark("pipeline_peak_gb", 4, "peak memory of the same, all included, GB", "at most", 2.5,
         lambda f: 1e-3 * _largest_scan(f)["peak_mb"]),
    Mark("video_weighted_fps", 5, "video with weights, frames a second", "at least", 30.0,
         lambda f: _at(f, "video", "weighted", "best_fps"), _frames_agree("weighted")),
    Mark("video_unweighted_fps", 5, "video without weights, frames a second", "at least", 45.0,
         lambda f: _at(f, "video", "unweighted", "best_fps"), _frames_agree("unweighted")),
    Mark("two_workers", 6, "two single-thread workers over one, where two cores are idle", "at least", 1.6, _workers),
    Mark("batch_two_over_one", 6, "raw files to results by two processes over one, where two cores are idle",
         "at least", 1.7, _batch),
    Mark("cluster_over_pool", 6, "the same by two workers of a dask cluster over two processes", "at least", 0.9,
         lambda f: _at(f, "two workers", "batch", "cluster_over_pool")),
    Mark("handheld_ms", 7, "handheld: 2028x1520 counts to the quick look's heights on one core, ms", "at most", 14.0,
         lambda f: _first(_at(f, "handheld"))["total"]["min_ms"], _look_is_right),
    Mark("cost_unweighted", 8, "time per pixel at 12 MP over that at 1.6 MP: full rectangle", "at most", 1.3,
         _per_pixel(("integration", "unweighted", "ours"), ("integration", "unweighted, small", "ours"))),
    Mark("cost_weighted", 8, "the same: weights and holes", "at most", 1.3,
         _per_pixel(("integration", "weighted", "ours"), ("integration", "beside pyamg", "ours"))),
    Mark("cost_gradients", 8, "the same: slopes per pixel", "at most", 1.3,
         _per_pixel(("gradients", "ours"), ("gradients", "small", "ours"))),
    Mark("cost_pipeline", 8, "the same: raw file to results on disk", "at most", 1.3, _pipeline_per_pixel),
    Mark("three_lights_over_channels", 10, "three lights: CPU time of a frame over three channels'", "at most", 1.05,
         lambda f: _lights_cpu(f, "three lights", "three channels"), _identical_lights),
    Mark("six_lights_over_three", 10, "six lights: CPU time of a frame over three lights'", "at most", 2.2,
         lambda f: _lights_cpu(f, "six lights", "three lights")),
    Mark("press_cue_ms", 9, "one press: button down to light and cue, ms", "at most", 100.0, _press("cue_ms")),
    Mark("press_lift_ms", 9, "one press: frame in memory, you may lift, ms", "at most", 500.0, _press("may_lift_ms")),
    Mark("press_disk_ms", 9, "one press: safe on disk, CPU time included, ms", "at most", 1500.0, _press("on_disk_ms")),
    Mark("press_verdict_ms", 9, "one press: verdict after the lift cue, ms", "at most", 1000.0,
         _press("verdict_after_lift_ms")),
    Mark("press_preview_ms", 9, "one press: relief preview, ms", "at most", 2000.0, _press("preview_ms")),
    Mark("press_ready_ms", 9, "one press: ready again, cues played, ms", "at most", 2000.0, _press("ready_again_ms")),
    Mark("press_refused_ms", 9, "one press: a refusal's cue and reason, ms", "at most", 100.0, _press("refused_ms")),
    Mark("coach_hz", 9, "press coach: readings a second", "at least", 10.0, _press("coach_hz")),
    Mark("coach_cpu_ms", 9, "press coach: CPU time a reading, ms", "at most", 20.0, _press("coach_cpu_ms")),
    Mark("calibration_s", 9, "guided calibration on the twin, s", "at most", 180.0, _press("calibration_virtual_s")),
)  # fmt: skip
"""Every mark, in the order of issue and note."""

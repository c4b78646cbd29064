"""Measures an entry by a recipe from the page: the engine, the recipe and the words of `retrosync measure`."""

from __future__ import annotations

from dataclasses import replace
from threading import Lock
from typing import Any, Final

import msgspec
import numpy as np

from device.surface import Float32Array, HeightMap
from host_sync.errors import MeasurementError
from host_sync.iso25178.areal_parameters import MaterialRatioCurve, core_line, core_parameters
from host_sync.measurement.measurement import Measurement
from host_sync.measurement.recipe import Recipe, checked, from_options, recipe_of
from host_sync.results.reader import ResultSurface, read_result
from host_sync.results.record import ResultRecord
from host_sync.viewer.entry import Entry, Heights

SOURCE: Final = "recipe"
RATIO_POINTS: Final = 201
BINS: Final = 64
MIN_CURVE: Final = 10
"""Fewest valid pixels with a material ratio curve."""


class Measuring:
    """Measures entries; the surface that was measured last is kept.

    Parameters
    ----------
    heights : reads the entries' height maps
    """

    def __init__(self, heights: Heights) -> None:
        self._heights = heights
        self._kept: tuple[str, ResultSurface] | None = None
        self._lock = Lock()

    def measure(self, entry: Entry, page: int, recipe: Recipe, *, samples: bool) -> dict[str, Any]:
        """Return the answer to the page.

        samples : whether to compute uncertainties, which takes many times as long

        Raises
        ------
        MeasurementError
            The region or the form is not on the surface.
        UnreadableResult
            The result is damaged.
        """
        # Compiled code is loaded when it is first needed, so that the list appears at once.
        from host_sync.measurement.measure import measure
        from host_sync.measurement.measurement import as_record
        from host_sync.measurement.recipe import recipe_text

        surface = self._surface(entry, page)
        found = measure(surface if samples else replace(surface, samples_um=None), recipe)
        record = as_record(found)
        for shown, one in zip(record["quantities"], found.quantities, strict=True):
            shown["number"] = one.number
        record["doubts"] = [doubt.sentence for doubt in found.doubts]
        record.pop("result")
        return record | {
            "title": entry.title,
            "text": recipe_text(recipe),
            "samples": samples,
            "ratio": _ratio(found),
            "histogram": _histogram(found.surface.z_um),
        }

    def _surface(self, entry: Entry, page: int) -> ResultSurface:
        stamp = f"{entry.stamp()}:{page}:{entry.doubts}"
        with self._lock:
            if self._kept is not None and self._kept[0] == stamp:
                return self._kept[1]
        surface = read_result(entry.folder) if entry.kind == "result" else self._bare(entry, page)
        with self._lock:
            self._kept = stamp, surface
        return surface

    def _bare(self, entry: Entry, page: int) -> ResultSurface:
        """Return a height map without a result's samples: of a quick look, a difference or a frame of a video."""
        record = ResultRecord(
            name=entry.title,
            method=entry.kind,
            rows=entry.shape[0],
            columns=entry.shape[1],
            pixel_pitch_um=entry.pitch_um,
        )
        height = HeightMap(self._heights.read(entry, page), entry.pitch_um)
        return ResultSurface(entry.folder, record, height, sigma_um=self._heights.sigma(entry), stated=entry.reasons)


def recipe_from_page(body: bytes) -> Recipe:
    """Return the recipe in a request: its keys as JSON, or a file's text under the one key `text`.

    Raises
    ------
    MeasurementError
        Names the key and what is accepted.
    """
    try:
        given = msgspec.json.decode(body, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MeasurementError(f"{SOURCE}: is not JSON: {error}") from error
    if set(given) == {"text"} and isinstance(given["text"], str):
        return recipe_of(given["text"].encode(), SOURCE)
    return checked(from_options(Recipe(), given), SOURCE)


def _ratio(found: Measurement) -> dict[str, Any] | None:
    """Return the material ratio curve (Abbott) and the construction of Sk on it; heights in µm from the mean."""
    curve = MaterialRatioCurve.of(found.surface.z_um)
    if curve.falling_um.size < MIN_CURVE:
        return None
    shares = np.linspace(0.0, 1.0, RATIO_POINTS)
    top, bottom = core_line(curve.falling_um)
    return {
        "percent": (100.0 * shares).tolist(),
        "height_um": [curve.height_um(float(share)) for share in shares],
        "core_um": (top, bottom),
        "parameters": core_parameters(curve),
    }


def _histogram(z_um: Float32Array) -> dict[str, Any] | None:
    """Return shares of the area by height, µm from the mean."""
    seen = z_um[np.isfinite(z_um)].astype(np.float64)
    if seen.size < MIN_CURVE:
        return None
    count, edges = np.histogram(seen - seen.mean(), BINS)
    return {"edges_um": edges.tolist(), "percent": (100.0 * count / seen.size).tolist()}

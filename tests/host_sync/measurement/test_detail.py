"""Numbers of results that hold raw and shrunk detail."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
import tifffile

from device.surface import integrate_dct
from host_sync.measurement.measure import measure_result
from host_sync.measurement.recipe import Recipe
from host_sync.results.reader import read_result
from host_sync.results.record import SlopeNoise

PITCH_UM = 5.0
SHAPE = (180, 240)
SLOPE_NOISE = 0.01


@pytest.fixture(scope="module")
def noise_um() -> tuple[np.ndarray, SlopeNoise]:
    """Integrated white slopes without their long waves, and what a calibration would say of them."""
    rng = np.random.default_rng(5)
    p, q = (SLOPE_NOISE * rng.standard_normal(SHAPE).astype(np.float32) for _ in range(2))
    heights = integrate_dct(p, q, 1.0)
    heights = heights - cv2.GaussianBlur(heights, (0, 0), 8.0)
    down, across = np.gradient(heights)
    slope = float(np.sqrt(0.5 * (down.var() + across.var())))
    read_deg = float(np.degrees(SLOPE_NOISE))
    known = SlopeNoise(
        (0.0, 40.0), (read_deg,) * 2, (0.1 * read_deg,) * 2, slope / SLOPE_NOISE, 0.1, float(heights.std()) / slope, 2.0
    )
    return heights * PITCH_UM, known


def two_surfaces(write: Callable[..., Path], smooth_um: np.ndarray, noise: tuple[np.ndarray, SlopeNoise]) -> Path:
    noise_um, known = noise
    facts = {"surface_detail": "shrunk", "slope_noise": msgspec.to_builtins(known)}
    folder = write(smooth_um, error_um=1e-4, **facts)
    tifffile.imwrite(folder / "height_raw_um.tif", (smooth_um + noise_um).astype(np.float32))
    tifffile.imwrite(folder / "slope_sigma.tif", np.full(SHAPE, 1e-4, np.float32))
    return folder


def number(folder: Path, name: str, **keys: object) -> tuple[float, float | None, float]:
    recipe = msgspec.convert({"parameters": [name], "l_filter_um": 400.0, "form": "mean"} | keys, Recipe)
    found = next(q for q in measure_result(folder, recipe).quantities if q.name == name)
    assert found.value is not None
    assert found.uncertainty is not None
    return found.value, found.noise_taken_off, found.uncertainty


@pytest.mark.parametrize(("times", "off"), [(5.0, 0.03), (2.0, 0.06)])
@pytest.mark.parametrize("name", ["Sq", "Sa"])
def test_roughness_on_raw_detail_is_the_surface_s_without_noise(
    write_result: Callable[..., Path], noise_um: tuple[np.ndarray, SlopeNoise], name: str, times: float, off: float
) -> None:
    column = np.arange(SHAPE[1])
    wave = np.sqrt(2.0) * times * noise_um[0].std() * np.sin(2.0 * np.pi * column / 12.0)
    smooth_um = np.broadcast_to(wave, SHAPE)
    truth, _, _ = number(write_result(smooth_um, "truth", error_um=1e-4), name)
    value, taken, uncertainty = number(two_surfaces(write_result, smooth_um, noise_um), name)
    assert taken is not None
    assert taken > 0.0
    assert value == pytest.approx(truth, rel=off)
    assert value + taken > truth
    assert 0.0 < uncertainty < 0.1 * truth + 0.3 * taken + 0.1 * value


@pytest.mark.parametrize("name", ["Sz", "Sp", "Sv"])
def test_noise_is_taken_off_an_extreme_as_well_as_its_uncertainty_states(
    write_result: Callable[..., Path], noise_um: tuple[np.ndarray, SlopeNoise], name: str
) -> None:
    size = 10.0 * noise_um[0].std()
    column = np.arange(SHAPE[1])
    errors, stated = [], []
    for smooth in (size * np.sin(2.0 * np.pi * column / 30.0), 2.0 * size * ((column < 100) | (column > 140))):
        smooth_um = np.broadcast_to(smooth, SHAPE)
        truth, _, _ = number(write_result(smooth_um, "truth", error_um=1e-4), name)
        for turn in range(4):
            noise = np.roll(noise_um[0], 41 * turn, 1)[:: 1 - 2 * (turn % 2)]
            value, taken, uncertainty = number(two_surfaces(write_result, smooth_um, (noise, noise_um[1])), name)
            assert taken is not None
            assert taken > 0.0
            errors.append(value - truth)
            stated.append(uncertainty)
    assert 0.4 < np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(stated))) < 1.4


def test_all_is_measured_on_the_detail_that_is_asked_for(
    write_result: Callable[..., Path], noise_um: tuple[np.ndarray, SlopeNoise]
) -> None:
    folder = two_surfaces(write_result, np.zeros(SHAPE, np.float32), noise_um)
    shrunk, taken, _ = number(folder, "Sz", detail="shrunk")
    raw, _, _ = number(folder, "Sz", detail="raw")
    assert taken is None
    assert shrunk < 0.2 * raw or raw == 0.0


def test_noise_alone_has_no_roughness(
    write_result: Callable[..., Path], noise_um: tuple[np.ndarray, SlopeNoise]
) -> None:
    value, taken, _ = number(two_surfaces(write_result, np.zeros(SHAPE, np.float32), noise_um), "Sq")
    assert taken is not None
    assert value < 0.5 * noise_um[0].std()


def test_either_detail_of_a_result_can_be_had(
    write_result: Callable[..., Path], noise_um: tuple[np.ndarray, SlopeNoise]
) -> None:
    surface = read_result(two_surfaces(write_result, np.zeros(SHAPE, np.float32), noise_um))
    raw = surface.with_detail("raw")
    assert surface.detail == "shrunk"
    assert raw.detail == "raw"
    assert raw.other is surface.height
    assert surface.with_detail(None) is surface
    assert raw.slope_sigma is not None
    assert surface.slope_sigma is not None
    assert float(np.median(raw.slope_sigma)) > float(np.median(surface.slope_sigma))
    back = raw.with_detail("shrunk")
    assert back.slope_sigma is not None
    np.testing.assert_allclose(back.slope_sigma, surface.slope_sigma, rtol=1e-2)

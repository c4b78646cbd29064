"""Gwyddion finds scale, orientation, values and mask in every format that it opens."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from device.surface import Float32Array

SIZE_M = (53 * 12e-6, 37 * 12e-6)
Read = Callable[[Path], dict[int, dict[str, Any]]]
TOLERANCE_UM = {"gsf": 1e-6, "gwy": 1e-12, "x3p": 1e-6, "sur": 1e-7, "sdf": 1e-12, "al3d": 1e-6, "png": 1.3e-4}
"""Half a step of the format's own numbers for heights to 11 µm."""
WITHOUT_MASK = {"sur": -2.0, "png": 0.0}
"""Gwyddion takes the number that stands for invalid as a height; the others become its mask."""


@pytest.mark.parametrize("form", TOLERANCE_UM)
def test_scale_orientation_values_and_mask(
    form: str, exported: Callable[..., Path], gwyddion: Read, z_um: Float32Array
) -> None:
    height = gwyddion(exported(form))[0]
    assert height["values"].shape == z_um.shape
    assert height["size"] == pytest.approx(SIZE_M, rel=1e-6)
    assert height["unit"] == "m"
    valid = np.isfinite(z_um)
    error_um = np.abs(height["values"] * 1e6 - z_um)[valid]
    assert error_um.max() <= TOLERANCE_UM[form]
    if form in WITHOUT_MASK:
        assert height["masked"] is None
        assert height["values"][~valid].max() * 1e6 < np.nanmin(z_um)  # never within the surface
    else:
        assert np.array_equal(height["masked"], ~valid)


def test_gwy_carries_the_uncertainty(
    exported: Callable[..., Path], gwyddion: Read, z_um: Float32Array, sigma_um: Float32Array
) -> None:
    channels = gwyddion(exported("gwy"))
    assert [channels[number]["title"] for number in (0, 1)] == ["Height", "Standard uncertainty of height"]
    sigma = channels[1]
    valid = np.isfinite(sigma_um)
    assert np.abs(sigma["values"] * 1e6 - sigma_um)[valid].max() < 1e-12
    assert np.array_equal(sigma["masked"], ~valid)
    assert sigma["unit"] == "m"


def test_float_tiff_opens_with_both_pages_and_their_masks(
    exported: Callable[..., Path], gwyddion: Read, z_um: Float32Array, sigma_um: Float32Array
) -> None:
    channels = gwyddion(exported("tiff"))
    for number, field in enumerate((z_um, sigma_um)):
        valid = np.isfinite(field)
        assert np.array_equal(channels[number]["values"][valid], field[valid])
        assert np.array_equal(channels[number]["masked"], ~valid)


@pytest.mark.parametrize("form", ["gsf", "gwy", "x3p", "sur", "sdf", "al3d", "png"])
def test_a_surface_without_gaps_has_no_mask(
    form: str, exported: Callable[..., Path], gwyddion: Read, write_result: Callable[..., Path], z_um: Float32Array
) -> None:
    whole = np.nan_to_num(z_um, nan=1.5)
    write_result(whole)
    height = gwyddion(exported(form))[0]
    assert height["masked"] is None
    assert np.abs(height["values"] * 1e6 - whole).max() <= TOLERANCE_UM[form]

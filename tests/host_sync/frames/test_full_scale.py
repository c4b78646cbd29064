"""Counts of fewer bits in files of 16: where light is clipped is found, whatever the depth and however it is stored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from device.calibration.acceptance import REFERENCE_CLIPPED
from device.errors import FrameError
from host_sync import api
from host_sync.calibration.consistency import check_reference
from host_sync.errors import FrameSetError
from host_sync.frames.channels import count_values, full_scale_of
from host_sync.frames.frame_set import load_frame_set
from host_sync.frames.linear_light import frame_of_values, read_frame

SHAPE = (60, 80)
TEXT = """
name = "deep"
pixel_pitch_um = 20.0
encoding = "ENCODING"
[reference]
image = "flat.tif"
[[press]]
image = "press.tif"
ball_radius_mm = 0.4
[[scan]]
name = "one"
image = "scan.tif"
"""


def light(brightest: float, seed: int = 0) -> np.ndarray:
    """A field of uneven light with noise, fractions of full scale, clipped at 1."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    hill = brightest * np.exp(-(((row - 25) / 50) ** 2 + ((column - 45) / 60) ** 2))
    noise = np.random.default_rng(seed).normal(0.0, 0.01, (*SHAPE, 3))
    return np.clip(hill[..., None] * np.array([1.0, 0.93, 0.8]) + noise, 0.0, 1.0)


def counts(values: np.ndarray, bits: int, *, shifted: bool) -> np.ndarray:
    whole = np.rint(values * ((1 << bits) - 1)).astype(np.uint16)
    return whole << (16 - bits) if shifted else whole


def write_set(folder: Path, bits: int, brightest: float, *, shifted: bool, encoding: str = "linear") -> Path:
    for seed, name in enumerate(("flat", "press", "scan")):
        tifffile.imwrite(
            folder / f"{name}.tif", counts(light(brightest, seed), bits, shifted=shifted), photometric="rgb"
        )
    path = folder / "frameset.toml"
    path.write_text(TEXT.replace("ENCODING", encoding))
    return path


@pytest.mark.parametrize("shifted", [False, True])
@pytest.mark.parametrize("bits", range(9, 17))
def test_a_clipped_reference_is_refused_at_every_depth(tmp_path: Path, bits: int, shifted: bool) -> None:
    frame_set = load_frame_set(write_set(tmp_path, bits, 1.3, shifted=shifted))
    assert frame_set.reference is not None
    reference = read_frame(frame_set.reference)
    true = (light(1.3) >= 1.0).any(axis=-1)
    assert true.mean() > REFERENCE_CLIPPED
    assert reference.clipped[true].all()
    assert reference.rgb.max() == pytest.approx(1.0, abs=0.003)
    with pytest.raises(FrameError, match="the reference is saturated over"):
        check_reference(reference)


@pytest.mark.parametrize("shifted", [False, True])
@pytest.mark.parametrize("bits", range(9, 17))
def test_unclipped_counts_of_every_depth_are_not_called_clipped(tmp_path: Path, bits: int, shifted: bool) -> None:
    frame_set = load_frame_set(write_set(tmp_path, bits, 0.85, shifted=shifted))
    assert frame_set.reference is not None
    reference = read_frame(frame_set.reference)
    assert reference.clipped.mean() == 0.0
    assert reference.rgb == pytest.approx(light(0.85), abs=1.5 / (1 << bits) + 0.003)


def test_counts_that_end_under_a_number_of_bits_are_clipped_there() -> None:
    values = np.minimum(counts(light(1.3), 12, shifted=False), 4031)  # 12 bit less a black level
    assert full_scale_of(count_values([values]), None, "linear") == 4031


def test_a_stated_full_scale_counts_where_counts_allow_it() -> None:
    dim = count_values([counts(light(0.2), 12, shifted=False)])
    assert full_scale_of(dim, None, "linear") == 1023
    assert full_scale_of(dim, 4095, "linear") == 4095
    assert full_scale_of(dim, 877, "linear") == 1023  # a header that holds the image's own maximum
    assert full_scale_of(dim, 127, "linear") == 1023  # and one that counts exceed


@pytest.mark.parametrize("tag", [281, 341])
def test_a_header_says_the_full_scale(tmp_path: Path, tag: int) -> None:
    path = write_set(tmp_path, 12, 0.2, shifted=False)
    for seed, name in enumerate(("flat", "press", "scan")):
        pixels = counts(light(0.2, seed), 12, shifted=False)
        stated = [(tag, "H", 1, 4095, True)]
        tifffile.imwrite(tmp_path / f"{name}.tif", pixels, photometric="rgb", extratags=stated)
    frame_set = load_frame_set(path)
    assert (frame_set.full_scale, frame_set.states_full_scale) == (4095, True)


def test_srgb_of_12_bit_is_asked_for_unless_it_is_certain(tmp_path: Path) -> None:
    path = write_set(tmp_path, 12, 0.85, shifted=False, encoding="srgb")
    with pytest.raises(FrameSetError, match=r"state full_scale, 4095 for a camera of 12 bit"):
        load_frame_set(path)
    path.write_text(path.read_text().replace("[reference]", "full_scale = 4095\n[reference]"))
    frame_set = load_frame_set(path)
    assert frame_set.reference is not None
    assert read_frame(frame_set.reference).rgb.max() == pytest.approx(((0.88 + 0.055) / 1.055) ** 2.4, abs=0.03)
    assert load_frame_set(write_set(tmp_path, 12, 1.3, shifted=False, encoding="srgb")).full_scale == 4095


@pytest.mark.parametrize(
    ("brightest", "stated", "words"),
    [(1.3, 65535, "65535 is stated, and light is clipped at 4095"), (0.8, 1023, "1023 is stated, and counts reach 3")],
)
def test_a_stated_full_scale_that_counts_contradict_is_refused(
    tmp_path: Path, brightest: float, stated: int, words: str
) -> None:
    from host_sync.api_arguments import image_form

    path = write_set(tmp_path, 12, brightest, shifted=False)
    path.write_text(path.read_text().replace("[reference]", f"full_scale = {stated}\n[reference]"))
    with pytest.raises(FrameSetError, match=words):
        load_frame_set(path)
    with pytest.raises(FrameSetError, match=words):
        image_form([counts(light(brightest), 12, shifted=False)], "linear", stated, 1.0)


def test_scans_take_the_full_scale_of_their_calibration(tmp_path: Path) -> None:
    dim = load_frame_set(write_set(tmp_path, 12, 0.2, shifted=False))
    assert dim.full_scale == 1023
    as_calibrated = dim.scaled_as(4095)
    assert as_calibrated.scans[0].frame.full_scale == 4095
    assert dim.scaled_as(None) is dim
    with pytest.raises(FrameSetError, match="counts above 511"):
        dim.scaled_as(511)


def test_arrays_show_where_they_are_clipped() -> None:
    from host_sync.api_arguments import image_form

    clipped = counts(light(1.3), 12, shifted=False)
    form = image_form([clipped], "linear", None, 1.0)
    assert form.full_scale == 4095
    assert frame_of_values(clipped, "linear", form.full_scale).clipped.mean() > REFERENCE_CLIPPED
    fractions = frame_of_values(clipped / 65535.0, "linear")
    assert np.array_equal(fractions.clipped, frame_of_values(clipped, "linear", 4095).clipped)
    assert not frame_of_values(light(0.8), "linear").clipped.any()


def test_the_api_refuses_a_clipped_reference_in_12_bit() -> None:
    press = api.Press(counts(light(0.8, 1), 12, shifted=False), 0.4)
    with pytest.raises(FrameError, match="the reference is saturated"):
        api.calibrate([press], reference=counts(light(1.3), 12, shifted=False), pixel_pitch_um=20.0)
    with pytest.raises(FrameSetError, match="full_scale"):
        api.calibrate([press], reference=counts(light(0.8), 12, shifted=False), pixel_pitch_um=20.0, full_scale=-3)

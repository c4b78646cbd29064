"""Pixels that are not square show in the skin around balls; stated, they change nothing but the frame's size."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from device.balls.sphere import Ball
from device.calibration.acceptance import Check
from device.imaging.flat_field import LinearFrame, make_flat_field
from device.inverse_map.near_light import IlluminationMap
from host_sync.calibration.assessment import (
    MAX_TOO_WIDE,
    PIXEL_SHAPE,
    Assessment,
    PixelShape,
    checks,
    diameter_note,
    fraction_too_wide,
    measure_pixel_shape,
    widest_contact,
)
from host_sync.calibration.balls import PressFrame, apply_fit, locate
from host_sync.calibration.frames import CalibrationFrames, calibrate_frames
from host_sync.calibration.radii import fit_to
from host_sync.calibration.scale import ScaleUncertainty
from host_sync.frames.image_info import square_frame

SHAPE = (210, 280)
RADIUS_PX = 36.0
PLACES = ((70.0, 70.0), (200.0, 75.0), (140.0, 110.0), (75.0, 140.0), (205.0, 140.0))


def pressed(column: float, row: float) -> np.ndarray:
    """Heights in pixels: a ball's cap, and outside its contact skin that returns to rest."""
    down, across = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    apart, contact, reach = np.hypot(down - row, across - column), 0.65 * RADIUS_PX, 0.35 * RADIUS_PX
    at_edge = np.sqrt(RADIUS_PX**2 - contact**2)
    edge = contact / at_edge * reach
    cap = np.sqrt(RADIUS_PX**2 - np.minimum(apart, contact) ** 2) - at_edge + edge
    return np.where(apart < contact, cap, edge * np.exp(-(apart - contact) / reach))


def frame(height: np.ndarray, rows_kept: float, seed: int, cast: float = 0.0) -> LinearFrame:
    """The skin under three distant lamps, its rows resized as a stream's are.

    cast : what raised skin takes of the first lamp's light behind it
    """
    q, p = np.gradient(height)
    normal = np.dstack([-p, -q, np.ones_like(p)]) / np.sqrt(1.0 + p**2 + q**2)[..., None]
    low, around = np.radians(40.0), np.radians([90.0, 210.0, 330.0])
    lamps = np.stack([np.cos(low) * np.cos(around), np.cos(low) * np.sin(around), np.full(3, np.sin(low))])
    light = 0.5 * np.maximum(normal @ lamps, 0.0) / lamps[2] * np.array([1.0, 0.9, 0.7])
    behind = np.roll(height, 30, axis=0) > 0.3 * RADIUS_PX
    light[..., 0] *= 1.0 - cast * cv2.GaussianBlur((behind & (height < 0.3 * RADIUS_PX)).astype(float), (0, 0), 2.0)
    size = (SHAPE[1], round(SHAPE[0] * rows_kept))
    light = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
    light = np.clip(light + np.random.default_rng(seed).normal(0.0, 0.003, light.shape), 0.0, 1.0)
    return LinearFrame(light.astype(np.float32), np.zeros(light.shape[:2], np.bool_))


def shape_of(rows_kept: float, stated: float = 1.0, cast: float = 0.0) -> PixelShape | None:
    reference = square_frame(frame(np.zeros(SHAPE), rows_kept, 99), stated)
    flat_field = make_flat_field(reference)
    radius_px = RADIUS_PX * (rows_kept if stated > 1.0 else 1.0)  # of the square pixels, which are the larger ones
    presses = [
        PressFrame(f"press-{seed}", square_frame(frame(pressed(*place), rows_kept, seed, cast), stated), radius_px)
        for seed, place in enumerate(PLACES)
    ]
    located = [locate(press, flat_field) for press in presses]
    fit = fit_to(located, IlluminationMap.of(flat_field)).finished()
    return measure_pixel_shape(apply_fit(located, fit), fit.map)


def test_square_pixels_are_found_square() -> None:
    shape = shape_of(1.0)
    assert shape is not None
    assert shape.ratio == pytest.approx(1.0, abs=0.01)
    assert shape.disagreement(20.0) == ""


@pytest.mark.parametrize("rows_kept", [0.92, 0.85])
def test_a_stream_that_was_resized_is_contradicted_with_the_figure(rows_kept: float) -> None:
    shape = shape_of(rows_kept)
    assert shape is not None
    assert shape.ratio == pytest.approx(1.0 / rows_kept, abs=shape.sigma)
    assert f"{shape.ratio:.3f} ± {shape.sigma:.3f}" in shape.disagreement(20.0)
    assert f"pixel_pitch_um = [20, {20.0 * shape.ratio:.4g}]" in shape.disagreement(20.0)


def test_skin_that_the_map_misreads_leaves_a_doubt_and_accuses_nobody() -> None:
    doubtful = PixelShape(0.9, 0.15, 6)
    assert doubtful.disagreement(20.0).startswith("the shape of pixels is not confirmed: by the skin around 6 balls")
    assert "0.90 ± 0.30" in doubtful.disagreement(20.0)
    assert doubtful.off <= doubtful.allowed


@pytest.mark.parametrize("ratio", [0.954, 1.047])
def test_a_shape_that_is_a_twentieth_off_passes_with_the_figure(ratio: float) -> None:
    shape = PixelShape(ratio, 0.031, 12)
    assert shape.off <= shape.allowed
    assert f"is {ratio:.2f} ± 0.06 of the stated" in shape.disagreement(20.0)


def test_derivatives_that_disagree_raise_the_uncertainty() -> None:
    lone, all_agree = shape_of(1.0, cast=0.5), shape_of(1.0)
    assert lone is not None
    assert all_agree is not None
    assert lone.sigma > 1.5 * all_agree.sigma
    assert lone.off <= lone.allowed


def test_the_stated_shape_is_not_contradicted() -> None:
    shape = shape_of(0.85, stated=1.0 / 0.85)
    assert shape is not None
    assert shape.ratio == pytest.approx(1.0, abs=0.015)


@pytest.mark.parametrize("stated", [False, True])
def test_two_stated_pitches_confirm_the_shape(stated: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass(frozen=True)
    class Made:
        assessment: Assessment
        pitch_um: float = 20.0

    failed = (Check(PIXEL_SHAPE, 0.25, 0.05, "at most"), Check("balls used", 5.0, 4.0, "at least"))
    scale = ScaleUncertainty(None, None, None, None, ())
    shape = PixelShape(1.2, 0.02, 9)
    notes = ("a note", shape.disagreement(20.0))
    made = Made(Assessment(None, scale, None, failed, notes, shape))  # type: ignore[arg-type]
    monkeypatch.setattr("host_sync.calibration.frames.calibrate_lights", lambda *_, **__: made)
    monkeypatch.setattr("host_sync.calibration.frames.identified", lambda calibration: calibration)
    frames = CalibrationFrames((), None, 20.0, states_pixel_shape=stated, left_out=("a press is black",))
    found = calibrate_frames(frames).assessment
    said = ("a note", shape.against_stated) if stated else notes
    assert (found.passed, found.notes) == (stated, (*said, "a press is black"))


@pytest.mark.parametrize(("stated", "asks"), [(RADIUS_PX, False), (2.0 * RADIUS_PX, True)])
def test_a_diameter_given_as_the_radius_is_asked_for(stated: float, asks: bool) -> None:
    flat_field = make_flat_field(frame(np.zeros(SHAPE), 1.0, 99))
    presses = [PressFrame(f"press-{i}", frame(pressed(*place), 1.0, i), stated) for i, place in enumerate(PLACES)]
    located = [locate(press, flat_field) for press in presses]
    assert sum(len(press.balls) for press in located) >= 3
    assert any("is ball_radius_mm the diameter?" in note for note in diameter_note(widest_contact(located))) == asks


@pytest.mark.parametrize(("factor", "is_possible"), [(1.0, True), (0.5, False)])
def test_labels_of_a_ball_that_cannot_press_as_wide_do_not_pass(factor: float, is_possible: bool) -> None:
    """A pixel pitch twice too large halves the ball in pixels; whoever labels contacts draws them narrow enough."""
    flat_field = make_flat_field(frame(np.zeros(SHAPE), 1.0, 99))
    radius_px = factor * RADIUS_PX
    presses = [
        PressFrame(
            f"press-{seed}",
            frame(pressed(*place), 1.0, seed),
            radius_px,
            (Ball(float(place[0]), float(place[1]), 0.6 * radius_px, radius_px),),
            labelled_by_hand=True,
        )
        for seed, place in enumerate(PLACES)
    ]
    fraction = fraction_too_wide([locate(press, flat_field) for press in presses])
    assert (fraction <= MAX_TOO_WIDE) is is_possible


def test_another_shape_does_not_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("host_sync.calibration.assessment.fit_checks", lambda *_: ("first", "share"))
    (check,) = checks([], 1.0, 0.01, None, PixelShape(1.09, 0.02, 8))[4:]  # type: ignore[arg-type]
    assert (check.name, check.passed) == (PIXEL_SHAPE, False)

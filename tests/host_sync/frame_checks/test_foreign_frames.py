"""Every kind of foreign frame by every object of the twin's gallery: none is accepted, no honest one is refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import msgspec
import numpy as np
import pytest

from device.acquisition.capture import CaptureSettings, capture
from device.balls.detector import find_balls
from device.balls.sphere import Ball
from device.errors import CalibrationMismatch
from device.imaging.flat_field import LinearFrame, demosaic, flat_field_correct, make_flat_field
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.interfaces import LiftOff, OperatorRequest, PressBall, PressObject
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from hal.simulator.operator import gallery_names
from host_sync.frame_checks.frame_model import FrameModel
from host_sync.results.record import FrameCheck, refusals

RADIUS_MM, PITCH_MM = 3.0, 0.048
CLEAR = np.zeros((256, 256), bool)
PLACES = ((0.25, 0.25), (0.75, 0.3), (0.5, 0.5), (0.3, 0.75), (0.7, 0.75))


@dataclass(frozen=True)
class Device:
    """A small twin with a coat of its own: what calibrates it, and a scan of every object of the gallery."""

    reference: LinearFrame
    model: FrameModel
    scans: Mapping[str, LinearFrame]

    def check(self, rgb: np.ndarray) -> tuple[FrameCheck, ...]:
        flat_field = make_flat_field(self.reference)
        light = np.ascontiguousarray(rgb, np.float32)
        return self.model.check(
            flat_field_correct(LinearFrame(light, (light >= 0.98).any(axis=-1)), flat_field), flat_field
        )


def made(profile: BoardProfile, contrast: float, seed: int, faces: tuple[str, ...]) -> Device:
    twin = msgspec.structs.replace(profile.twin, pigment_contrast=contrast, seed=seed)
    bench = build(msgspec.structs.replace(profile, twin=twin), VirtualClock())
    with twin_hardware(bench) as hardware:

        def shoot(request: OperatorRequest) -> LinearFrame:
            hardware.operator.ask(request)
            hardware.button.wait_for_press(None)
            return demosaic(capture(hardware, CaptureSettings.of_board(hardware)))

        reference = shoot(LiftOff())
        presses = [shoot(PressBall(RADIUS_MM, *place)) for place in PLACES]
        scans = {name: shoot(PressObject(name)) for name in faces}
    flat_field = make_flat_field(reference)
    images = [flat_field_correct(press, flat_field) for press in presses]
    balls: list[tuple[Ball, ...]] = [find_balls(image, RADIUS_MM / PITCH_MM).found for image in images]
    return Device(reference, FrameModel.of(reference, flat_field, list(zip(images, balls, strict=True))), scans)


@pytest.fixture(scope="module")
def device(small_twin: BoardProfile) -> Device:
    return made(small_twin, 0.015, 1, gallery_names())


@pytest.fixture(scope="module")
def other(small_twin: BoardProfile) -> Device:
    """The same design, another copy: its coat is its own."""
    return made(small_twin, 0.015, 2, ("coin",))


def dimmed(channel: int, level: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda rgb: rgb * np.where(np.arange(3) == channel, level, 1.0)


KINDS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], str]] = {
    "red 15 % weaker": (dimmed(0, 0.85), "darker in red"),
    "green 15 % weaker": (dimmed(1, 0.85), "darker in green"),
    "blue 15 % weaker": (dimmed(2, 0.85), "darker in blue"),
    "all 10 % darker": (lambda rgb: 0.9 * rgb, "darker in all channels"),
    "all 10 % brighter": (lambda rgb: 1.1 * rgb, "brighter in all channels"),
    "shifted": (lambda rgb: np.roll(rgb, 12, axis=1), "+12 columns and +0 rows off"),
    "mirrored": (lambda rgb: rgb[:, ::-1], "mirrored left to right"),
    "upside down": (lambda rgb: rgb[::-1], "mirrored top to bottom"),
    "turned": (lambda rgb: rgb[::-1, ::-1], "turned by 180 degrees"),
    "channels swapped": (lambda rgb: rgb[..., ::-1], "the channels are in the order B, G, R"),
    "channels rotated": (lambda rgb: rgb[..., [1, 2, 0]], "the channels are in the order"),
    "blurred": (lambda rgb: cv2.GaussianBlur(rgb, (0, 0), 2.0), "it is blurred"),
}


@pytest.mark.parametrize("name", gallery_names())
def test_an_honest_frame_passes_every_check(device: Device, name: str) -> None:
    checks = device.check(device.scans[name].rgb)
    assert [check.outcome for check in checks] == ["passed"] * 4, checks


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", gallery_names())
def test_a_foreign_frame_is_refused_for_the_right_reason(device: Device, name: str, kind: str) -> None:
    change, words = KINDS[kind]
    (refused,) = refusals(device.check(change(device.scans[name].rgb)))
    assert words in refused


def test_another_copy_of_the_same_device_is_found_by_its_coat(device: Device, other: Device) -> None:
    (refused,) = refusals(device.check(other.scans["coin"].rgb))
    assert "pattern of the reference's skin is missing" in refused


def test_every_refusal_has_its_figure_and_limit(device: Device) -> None:
    for change, _ in KINDS.values():
        (refused,) = [c for c in device.check(change(device.scans["step"].rgb)) if c.outcome == "refused"]
        assert refused.limit is not None
        assert refused.value is not None or "mirrored" in refused.words or "turned" in refused.words


def test_a_field_without_untouched_skin_still_shows_its_lamps(device: Device) -> None:
    """Sandpaper that covers the field and beyond: slopes everywhere, on the average none."""
    random = np.random.default_rng(3)
    shape = device.reference.shape
    rough = [cv2.GaussianBlur(random.standard_normal(shape), (0, 0), 4.0) for _ in range(2)]
    p, q = (0.12 * part / part.std() for part in rough)
    towards = np.radians([90.0, 210.0, 330.0])
    shade = np.stack([1.0 + 1.7 * (p * np.cos(a) + q * np.sin(a)) for a in towards], axis=-1)
    pressed = device.reference.rgb * np.maximum(shade / np.sqrt(1.0 + p**2 + q**2)[..., None], 0.02)
    assert refusals(device.check(pressed)) == []
    for kind in ("red 15 % weaker", "green 15 % weaker", "blue 15 % weaker", "all 10 % darker"):
        change, words = KINDS[kind]
        (refused,) = refusals(device.check(change(pressed)))
        assert words in refused


def test_an_even_coat_is_not_said_to_be_checked(small_twin: BoardProfile) -> None:
    device = made(small_twin, 0.0, 1, ("coin",))
    outcome = {check.name: check.outcome for check in device.check(device.scans["coin"].rgb)}
    assert outcome["pattern position"] == outcome["pattern sharpness"] == "not checked"
    assert outcome["light levels"] == "passed"
    assert any("no pattern of the skin" in words for words in device.model.blind)
    assert refusals(device.check(0.9 * device.scans["coin"].rgb))


def test_a_quarter_turn_is_found_by_the_frames_size(device: Device) -> None:
    with pytest.raises(CalibrationMismatch, match="turned by 90 degrees"):
        device.check(np.rot90(device.scans["coin"].rgb))


def test_quarter_turns_of_a_square_field_are_found_by_the_pattern() -> None:
    random = np.random.default_rng(5)
    coat = 1.0 + 0.02 * random.standard_normal((256, 256, 1))
    reference, press, scan = (
        LinearFrame((0.4 * coat + 0.004 * random.standard_normal((256, 256, 3))).astype(np.float32), CLEAR)
        for _ in range(3)
    )
    flat_field = make_flat_field(reference)
    model = FrameModel.of(reference, flat_field, [(flat_field_correct(press, flat_field), ())])
    assert refusals(model.check(flat_field_correct(scan, flat_field), flat_field)) == []
    for turns, words in ((1, "anticlockwise"), (-1, "90 degrees clockwise")):
        turned = LinearFrame(np.ascontiguousarray(np.rot90(scan.rgb, turns)), CLEAR)
        (refused,) = refusals(model.check(flat_field_correct(turned, flat_field), flat_field))
        assert words in refused

"""The twin judged by certified specimens with the program's own command; its certificate tells the figures.

usage: python tests/benchmarks/accuracy/check_standard.py DIR [--skin flake]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.guided_calibration import press_places
from device.imaging.flat_field import demosaic
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.interfaces import LiftOff, OperatorRequest, PressBall
from hal.simulator.bench import build
from hal.simulator.hardware import twin_hardware
from hal.simulator.scene import Press
from hal.simulator.surfaces import Block, Sinusoid, Sphere, Step
from host_sync.certificate.certificate import Certificate, certificate_of_frame_set
from host_sync.frames.frame_set import load_frame_set
from tests.benchmarks.accuracy.twin_instrument import BALL_RADIUS_MM, reference_profile

ROWS: Final = 544
COLUMNS: Final = 728
PITCH_UM: Final = 24.0
"""The reference profile's field with half its resolution: minutes less."""

SCANS: Final = 2
FACE: Final = Block(4.5, 3.5)
SPHERE_MM: Final = 4.0
PERIOD_MM: Final = 1.5
STEPS_UM: Final = (50.0, 100.0, 200.0)

_HEAD: Final = f'name = "twin"\npixel_pitch_um = {PITCH_UM:g}\nencoding = "linear"\n[reference]\nimage = "rest-0.png"\n'
_PRESS: Final = '[[press]]\nimage = "{file}"\nball_radius_mm = {radius:g}\nball_radius_tolerance_mm = 0.0025\n'
_SPECIMEN: Final = """name = "{name}"
kind = "{kind}"
certified_um = {value:g}
expanded_uncertainty_um = {expanded:g}
certificate = "the twin's own geometry"
{axis}
{scans}
[measure]
{measure}
"""


def checked_twin(folder: Path, report_progress: Callable[[str], None], skin: str = "diffuse") -> Certificate:
    """The certificate of the twin with a skin, everything in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    report_progress("check standards: frames")
    specimens = list(_make_frames(_profile(skin), folder))
    frame_set = load_frame_set(folder / "frameset.toml")
    return certificate_of_frame_set(
        frame_set, specimens, folder / "certificate", lambda w: report_progress(f"check: {w}")
    )[0]


def certificate_figures(folder: Path, report_progress: Callable[[str], None]) -> Iterator[tuple[str, float]]:
    """Figures of the certificate, for `make accuracy`."""
    certificate = checked_twin(folder / "check-standard", report_progress)
    judged = [abs(one.e_n) for one in certificate.specimens if one.e_n is not None]
    if judged:
        yield "certificate: worst |E_n|", max(judged)
    names = {"α_z": "amplification in z", "l_z": "linearity in z", "N_M": "noise", "z_FLT": "flatness"}
    names |= {"α_x": "amplification in x", "α_y": "amplification in y", "W_R": "edge width"}
    for one in certificate.characteristics:
        if one.value is not None:
            yield f"certificate: {names[one.symbol]}", one.value


def _profile(skin: str) -> BoardProfile:
    profile = reference_profile(skin)
    sensor = msgspec.structs.replace(profile.sensor, rows=ROWS, columns=COLUMNS, pixel_pitch_um=PITCH_UM)
    twin = msgspec.structs.replace(profile.twin, pigment_contrast=0.01)
    return msgspec.structs.replace(profile, sensor=sensor, twin=twin)


def _make_frames(profile: BoardProfile, folder: Path) -> Iterator[Path]:
    """Write reference, ball presses and scans of every specimen; yields the specimens' files."""
    bench = build(profile, VirtualClock(start_ns=5_000_000_000))
    with twin_hardware(bench) as hardware:
        plan = CaptureSettings.of_board(hardware)

        def shoot(file: str, request: OperatorRequest | None = None) -> None:
            if request is not None:
                hardware.operator.ask(request)
                hardware.button.wait_for_press(None)
            _write(folder / file, demosaic(capture(hardware, plan)).rgb)

        for number in range(1 + SCANS):
            shoot(f"rest-{number}.png", LiftOff())
        text = _HEAD
        for number, place in enumerate(press_places()):
            shoot(file := f"press-{number:02d}.png", PressBall(BALL_RADIUS_MM, *place))
            text += _PRESS.format(file=file, radius=BALL_RADIUS_MM)
        text += '[[scan]]\nname = "rest"\nimage = "rest-1.png"\n'
        (folder / "frameset.toml").write_text(text, encoding="utf-8")
        for name, (press, words) in _specimens().items():
            bench.place(press)
            for number in range(SCANS):
                shoot(f"{name}-{number}.png")
            yield _describe(folder, name, [f"{name}-{number}.png" for number in range(SCANS)], words)
    flat = {"kind": "flat", "value": 0.0, "expanded": 0.1, "measure": ""}
    yield _describe(folder, "rest", [f"rest-{number}.png" for number in range(1, 1 + SCANS)], flat)


def _specimens() -> dict[str, tuple[Press, dict[str, object]]]:
    """What is pressed, and what its file says of it."""
    x, y = 0.5 * (COLUMNS - 1) * PITCH_UM, 0.5 * (ROWS - 1) * PITCH_UM
    across = f"from_um = [{x - 3000}, {y}]\nto_um = [{x + 3000}, {y}]\nwidth_um = 600"
    along = f"from_um = [{x}, {y - 2600}]\nto_um = [{x}, {y + 2600}]\nwidth_um = 600"
    pitch = "\npixel_pitch_share = 0.002"
    found: dict[str, tuple[Press, dict[str, object]]] = {}
    for rise_um in STEPS_UM:
        step = Press(Step(FACE, 1e-3 * rise_um, 0.15), (0.0, 0.0), 0.0, 0.5)
        words = {"kind": "step", "value": rise_um, "expanded": 0.005 * rise_um, "measure": across}
        found[f"step-{rise_um:g}"] = step, words
    half = 1000.0
    region = f"region_um = [{x - half}, {y - half}, {x + half}, {y + half}]"
    ball = Press(Sphere(SPHERE_MM), (0.0, 0.0), 0.0, 0.8)
    found["sphere"] = ball, {"kind": "sphere", "value": 1e3 * SPHERE_MM, "expanded": 2.5, "measure": region}
    for axis, turn, line in (("x", 0.0, across), ("y", 0.5 * np.pi, along)):
        waves = Press(Sinusoid(Block(4.0, 4.0), PERIOD_MM, 0.03), (0.0, 0.0), float(turn), 0.4)
        found[f"period-{axis}"] = waves, {
            "kind": "period", "value": 1e3 * PERIOD_MM, "expanded": 0.5, "measure": line + pitch,
            "axis": f'axis = "{axis}"',
        }  # fmt: skip
    return found


def _describe(folder: Path, name: str, images: list[str], words: dict[str, object]) -> Path:
    path = folder / f"{name}.toml"
    scans = "\n".join(f'[[scan]]\nimage = "{image}"' for image in images)
    path.write_text(_SPECIMEN.format(**{"axis": "", "name": name, "scans": scans} | words), encoding="utf-8")
    return path


def _write(path: Path, rgb: NDArray[np.float32]) -> None:
    values = np.clip(np.rint(rgb * 65535.0), 0, 65535).astype(np.uint16)
    if not cv2.imwrite(str(path), np.ascontiguousarray(values[..., ::-1])):
        raise OSError(f"{path} cannot be written")


def main() -> int:
    """Judge one twin and print its certificate's tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--skin", default="diffuse")
    arguments = parser.parse_args()
    certificate = checked_twin(arguments.folder, lambda words: sys.stderr.write(f"{words}\n") and None, arguments.skin)
    for one in (*certificate.specimens, *certificate.characteristics):
        sys.stdout.write(f"{one}\n")
    return 0 if certificate.agrees else 1


if __name__ == "__main__":
    sys.exit(main())

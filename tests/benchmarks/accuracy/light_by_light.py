"""Presses of the twin taken light by light, reconstructed with and without the frames of single lights.

    python -m tests.benchmarks.accuracy.light_by_light [diffuse | flake | sharp-flake]

Coin, step, texture and balls at the places of the certificate, against the twin's truth: root mean square errors of
heights (µm) and slopes inside the contact and on sloping skin beside it.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from device.acquisition.capture import CaptureSettings, capture
from device.imaging.flat_field import bin_bayer, demosaic
from device.imaging.frame_light import without_ambient
from hal.interfaces import OperatorRequest, PressBall, PressObject
from host_sync.light_groups import CHANNELS
from host_sync.reconstruction.pipeline import Reconstruction, reconstruct
from host_sync.reconstruction.slope_reading import LightSequence
from tests.benchmarks.accuracy.ball_error import inner_contact
from tests.benchmarks.accuracy.twin_instrument import BALL_RADIUS_MM, TwinInstrument, TwinScan, reference_profile
from tests.benchmarks.accuracy.twin_verdict import PLACES

SLOPING: Final = 0.02
"""Slope from which skin beside a contact counts."""

Errors = tuple[float, float, float, float]


def errors(found: Reconstruction, scan: TwinScan) -> Errors:
    """Heights (µm) in contact and beside it, slopes in contact and beside it, root mean square."""
    truth = scan.truth
    contact = inner_contact(truth.contact)
    beside = ~truth.contact & (np.hypot(truth.p, truth.q) > SLOPING)
    z_um, slope = found.height.z_um - truth.z_um, np.hypot(found.p - truth.p, found.q - truth.q)

    def rms(values: np.ndarray, where: np.ndarray) -> float:
        return float(np.sqrt(np.nanmean(np.square(values[where]))))

    return rms(z_um, contact), rms(z_um, beside), rms(slope, contact), rms(slope, beside)


def sequence_of(instrument: TwinInstrument, request: OperatorRequest, name: str) -> tuple[TwinScan, LightSequence]:
    """One press under all lights and under each alone."""
    hardware = instrument.hardware
    with hardware:
        hardware.operator.ask(request)
        hardware.button.wait_for_press(None)
        plan = CaptureSettings.of_board(hardware)
        scan = TwinScan(name, capture(hardware, plan), instrument.truth())
        dark = capture(hardware, replace(plan, currents_ma={}))
        seen = {
            light: bin_bayer(without_ambient(capture(hardware, replace(plan, currents_ma={light: ma})), dark)).rgb
            for light, ma in plan.currents_ma.items()
        }
    own = {int(np.argmax(rgb.mean(axis=(0, 1)))): light for light, rgb in seen.items()}
    lights = tuple(own[channel] for channel in range(CHANNELS))
    alone = np.stack([seen[light][..., channel] for channel, light in enumerate(lights)], axis=-1)
    return scan, LightSequence(lights, alone)


def main(arguments: list[str] | None = None) -> int:
    """Print the errors of every press, without and with single lights, and of all together."""
    given = sys.argv[1:] if arguments is None else arguments
    skin = given[0] if given else "diffuse"
    requests: dict[str, OperatorRequest] = {name: PressObject(name) for name in ("coin", "step", "texture")}
    requests |= {f"ball at {place}": PressBall(BALL_RADIUS_MM, *place) for place in PLACES}
    every = []
    with tempfile.TemporaryDirectory() as folder:
        instrument = TwinInstrument(reference_profile(skin), Path(folder))
        for name, request in requests.items():
            scan, sequence = sequence_of(instrument, request, name)
            frame, calibration = demosaic(scan.frame), instrument.calibration
            both = [errors(reconstruct(frame, calibration, name, sequence=one), scan) for one in (None, sequence)]
            every.append(both)
            sys.stdout.write(f"{name:24s} {_words(both)}\n")
            sys.stdout.flush()
    together = np.sqrt(np.square(np.array(every)).mean(axis=0))
    sys.stdout.write(f"{skin + ', rms of all':24s} {_words(together.tolist())}\n")
    return 0


def _words(both: list[Errors]) -> str:
    """Without and with single lights, side by side."""
    titles = ("heights in contact", "beside", "slopes in contact", "beside")
    digits = (1, 1, 4, 4)
    pairs = zip(titles, digits, *both, strict=True)
    return ", ".join(f"{title} {one:.{n}f} -> {other:.{n}f}" for title, n, one, other in pairs)


if __name__ == "__main__":
    sys.exit(main())

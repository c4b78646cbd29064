"""A part named by the QR code or barcode before the camera, by the whole instrument."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from device.bundles.scan import Annotations
from device.instrument.events import Failed, Info
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.board_profile import BoardProfile
from hal.clock import VirtualClock
from hal.frame import CameraSettings, RawFrame
from hal.simulator.bench import SimulatedScene
from hal.simulator.hardware import twin_hardware


class LabelScene(SimulatedScene):
    """A world with a printed label before the camera: `label` is its reflectance, of the frame's shape."""

    label: NDArray[np.float64] | None = None

    def expose(self, index: int, began_ns: int, settings: CameraSettings) -> RawFrame:
        frame = super().expose(index, began_ns, settings)
        if self.label is None:
            return frame
        lit = frame.black_level_dn + (frame.mosaic - frame.black_level_dn) * self.label
        return replace(frame, mosaic=np.maximum(lit, 0.0).astype(np.uint16))


def label_of(text: str, shape: tuple[int, int], mirrored: bool) -> NDArray[np.float64]:
    """A QR code in the middle of white paper."""
    code = cv2.QRCodeEncoder.create().encode(text)
    side = min(shape) * 3 // 4
    drawn = cv2.resize(code, (side, side), interpolation=cv2.INTER_NEAREST)
    paper = np.full(shape, 0.9)
    top, left = (shape[0] - side) // 2, (shape[1] - side) // 2
    paper[top : top + side, left : left + side] = np.where(drawn > 127, 0.9, 0.1)
    return paper[:, ::-1] if mirrored else paper


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_part_is_named_by_its_code(small_twin: BoardProfile, calibrated: BundleStore, mirrored: bool) -> None:
    bench = LabelScene(small_twin, VirtualClock(start_ns=5_000_000_000), 1)
    hardware = twin_hardware(bench)
    with Instrument(hardware, BundleStore(calibrated.root, bench.clock, boot_id="b0075e1f")) as instrument:
        instrument.set_sticky(Annotations(job="lids", part="old"))
        instrument.read_code()
        instrument.step()
        (refused,) = [event.sentence for event in instrument.take_events() if isinstance(event, Failed)]
        assert "no code was read" in refused
        assert instrument.state.sticky.part == "old"
        bench.label = label_of("LID-0042", hardware.camera.shape, mirrored)
        instrument.read_code()
        instrument.step()
        assert "The next part is LID-0042." in [e.sentence for e in instrument.take_events() if isinstance(e, Info)]
        assert instrument.state.sticky == Annotations(job="lids", part="LID-0042")

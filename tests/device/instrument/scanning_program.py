"""A program that scans without end on the twin in virtual time, until it is killed: `scanning_program.py STORE`.

Every published scan is printed before the next one begins.
"""

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec

from device.instrument.events import ScanFinished
from device.instrument.instrument import Instrument
from device.store.store import BundleStore
from hal.board_profile import load_board_profile
from hal.factory import open_hardware


def main(root: Path) -> None:
    """Scan and print without end: capture on this thread, the disk on another, as on the instrument."""
    reference = load_board_profile("twin")
    sensor = msgspec.structs.replace(reference.sensor, columns=364, rows=272, pixel_pitch_um=48.0)
    hardware = open_hardware(msgspec.structs.replace(reference, sensor=sensor))
    with Instrument(hardware, BundleStore(root, hardware.clock), ThreadPoolExecutor(1)) as instrument:
        while True:
            instrument.press()
            instrument.step()
            for event in instrument.take_events():
                if isinstance(event, ScanFinished):
                    sys.stdout.write(event.scan_id + "\n")
                    sys.stdout.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))

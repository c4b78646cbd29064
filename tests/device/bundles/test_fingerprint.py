from __future__ import annotations

import msgspec
import pytest

from device.bundles.fingerprint import Fingerprint


def changed_light(fingerprint: Fingerprint, **change: object) -> Fingerprint:
    red, *others = fingerprint.lights
    return msgspec.structs.replace(fingerprint, lights=(msgspec.structs.replace(red, **change), *others))


def test_agrees_with_itself_and_with_what_the_camera_rounds(fingerprint: Fingerprint) -> None:
    rounded = msgspec.structs.replace(fingerprint, exposure_us=fingerprint.exposure_us * 1.005)
    assert fingerprint.mismatch(fingerprint) is None
    assert fingerprint.mismatch(rounded) is None


def test_every_difference_is_reported_with_both_values(fingerprint: Fingerprint) -> None:
    other = msgspec.structs.replace(fingerprint, channel_order="BGGR", exposure_us=4000.0, analogue_gain=2.0)
    sentence = fingerprint.mismatch(other)
    assert sentence is not None
    for part in ("channel order (RGGB, not BGGR)", "exposure (2000 µs, not 4000 µs)", "gain (1, not 2)"):
        assert part in sentence


@pytest.mark.parametrize(
    ("change", "part"),
    [
        ({"current_ma": 7.0}, "current of light red (6.4 mA, not 7 mA)"),
        ({"position_mm": (0.0, 21.651, 12.5)}, "position of light red"),
        ({"name": "crimson"}, "lights (red R, not crimson R)"),
    ],
)
def test_a_changed_light_is_reported(fingerprint: Fingerprint, change: dict[str, object], part: str) -> None:
    sentence = fingerprint.mismatch(changed_light(fingerprint, **change))
    assert sentence is not None
    assert part in sentence

"""The self-test: every part in order, each light as the camera sees it, and a sentence that names the faulty part."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

from device.acquisition.capture import (
    FRAME_TIMEOUT_S,
    CaptureSettings,
    capture,
    capture_with_faults,
    check_frame,
    retry_with_restart,
)
from device.errors import CalibrationError, DeviceError
from device.imaging.frame_light import BRIGHTEST_PERCENTILE, Levels, channel_levels
from device.quality.press_faults import LOW_BATTERY
from hal.board_profile import LightConfig
from hal.errors import HalError
from hal.hardware import Hardware
from hal.interfaces import LiftOff, LightFault

State = Literal["ok", "warning", "failed", "skipped"]

DARK_LEVEL: Final = 0.02
"""Maximum level of a frame with all lights off; above it, outside light enters."""

MIN_LEVEL: Final = 0.02
"""Minimum level, as a fraction of full scale, at which a light counts as visible."""

PUSH_TIMEOUT_S: Final = 20.0


@dataclass(frozen=True, slots=True)
class Finding:
    """Outcome of the test of one part."""

    part: str
    state: State
    sentence: str


def selftest(hardware: Hardware, ask_for_push: bool = False) -> Iterator[Finding]:
    """Test every part in order; a failed part does not stop the test of the others.

    ask_for_push : also wait for a push of the button
    """
    yield _tested("power", lambda: _power(hardware))
    if fault := root_fault():
        yield Finding("root file system", "warning", fault)
    with ExitStack() as held:
        button = _tested("button", lambda: _button(hardware, held))
        yield button
        lights = _tested("light driver", lambda: _light_driver(hardware, held))
        yield lights
        works = _works(lights)
        yield _tested("indicator", lambda: _indicator(hardware, held)) if works else _skipped("indicator", lights)
        camera = _tested("camera", lambda: _camera(hardware, held))
        yield camera
        broken = next((finding for finding in (lights, camera) if not _works(finding)), None)
        if broken:
            yield from (_skipped(f"light {light.name}", broken) for light in hardware.profile.lights)
        else:
            yield from _seen_lights(hardware)
        if ask_for_push:
            yield _tested("button push", lambda: _push(hardware)) if _works(button) else _skipped("button push", button)


def check_light_visible(hardware: Hardware, plan: CaptureSettings, light: LightConfig) -> str:
    """Check that the camera sees a light, alone so that crosstalk of others cannot hide a dead one.

    Of lights that are always on, the light's own channel is looked at.

    Returns the driver's flags for it, such as "open", or an empty text.

    Raises
    ------
    CalibrationError
        It is not visible.
    """
    always_on = hardware.profile.lights_always_on
    alone = plan if always_on else replace(plan, currents_ma={light.name: plan.currents_ma[light.name]}, granted=None)
    captured = capture_with_faults(hardware, alone)
    flags = ", ".join(fault.kind for fault in captured.light_faults or () if fault.light == light.name)
    if channel_levels(captured.frame, BRIGHTEST_PERCENTILE)["RGB".index(light.colour)] < MIN_LEVEL:
        driver = f" (the driver reports {flags})" if flags else ""
        raise CalibrationError(f"light {light.name} is hardly visible{driver}: run `retroscan selftest`")
    return flags


def _tested(part: str, test: Callable[[], Finding]) -> Finding:
    """Return the finding of a test; an error becomes a failed part."""
    try:
        return test()
    except (HalError, DeviceError) as error:
        return Finding(part, "failed", str(error))


def _works(finding: Finding) -> bool:
    return finding.state in {"ok", "warning"}


def _skipped(part: str, because: Finding) -> Finding:
    return Finding(part, "skipped", f"not tested because the {because.part} failed")


def _power(hardware: Hardware) -> Finding:
    with hardware.power as power:
        reading = power.read()
    if reading.under_voltage:
        return Finding("power", "failed", "the supply voltage is too low: use a stronger supply and a shorter cable")
    if reading.complaints:
        return Finding("power", "failed", "; ".join(reading.complaints))
    if reading.battery_share is not None and reading.battery_share < LOW_BATTERY:
        return Finding("power", "warning", f"the battery is at {reading.battery_share:.0%}: charge it")
    if reading.was_under_voltage:
        return Finding("power", "warning", "the supply voltage was too low since the start: use a stronger supply")
    measured = "not measured on this board" if reading.under_voltage is None else "the supply is good"
    if reading.battery_mv is not None and reading.battery_share is not None:
        measured += f", battery {reading.battery_share:.0%} ({reading.battery_mv * 1e-3:.2f} V)"
    return Finding("power", "ok", measured)


def _button(hardware: Hardware, held: ExitStack) -> Finding:
    held.enter_context(hardware.button)
    if hardware.button.is_down():
        return Finding(
            "button", "failed", "the button is held down or its line is shorted: release it, check its wires"
        )
    return Finding("button", "ok", "the button is released")


def _light_driver(hardware: Hardware, held: ExitStack) -> Finding:
    held.enter_context(hardware.lights)
    if hardware.profile.lights_always_on:
        return Finding("light driver", "ok", f"{', '.join(hardware.lights.names)} are always on and cannot be switched")
    return Finding("light driver", "ok", f"the driver of {', '.join(hardware.lights.names)} answers, lights are off")


def _indicator(hardware: Hardware, held: ExitStack) -> Finding:
    if hardware.profile.driver != "twin" and hardware.profile.indicator is None:
        return Finding("indicator", "ok", "this board has no indicator")
    held.enter_context(hardware.indicator)
    hardware.indicator.show("good")
    return Finding("indicator", "ok", "two short flashes were shown")


def _camera(hardware: Hardware, held: ExitStack) -> Finding:
    camera = held.enter_context(hardware.camera)
    frame = retry_with_restart(camera, lambda: camera.next_frame(FRAME_TIMEOUT_S))
    check_frame(frame, hardware.profile.sensor, camera.camera_id)
    rows, columns = frame.shape
    return Finding(
        "camera",
        "ok",
        f"{camera.camera_id} delivers {columns}x{rows} {frame.bayer_order}, black {frame.black_level_dn:g}",
    )


def _seen_lights(hardware: Hardware) -> Iterator[Finding]:
    """Yield the dark frame, then each light alone; of lights that are always on, each channel."""
    if hardware.profile.lights_always_on:
        yield Finding("darkness", "skipped", "the lights of this sensor are always on")
        yield from (
            _tested(f"light {light.name}", lambda light=light: _channel(hardware, light))  # type: ignore[misc]
            for light in hardware.profile.lights
        )
        return
    try:
        dark = _levels(hardware, {})
    except (HalError, DeviceError) as error:
        yield Finding("darkness", "failed", str(error))
        return
    if max(dark) > DARK_LEVEL:
        sentence = f"with all lights off the frame is at {max(dark):.0%} of full scale: close the housing, seat the gel"
        yield Finding("darkness", "warning", sentence)
    else:
        yield Finding("darkness", "ok", "with all lights off the frame is dark")
    for light in hardware.profile.lights:
        yield _tested(f"light {light.name}", lambda light=light: _light(hardware, light, dark))  # type: ignore[misc]


def _light(hardware: Hardware, light: LightConfig, dark: Levels) -> Finding:
    """Return one light alone: whether it is visible, its colour, and the driver's flags."""
    part = f"light {light.name}"
    levels = _levels(hardware, {light.name: light.current_ma})
    risen = [lit - unlit for lit, unlit in zip(levels, dark, strict=True)]
    flags = _flags_of(hardware, light)
    where = f"channels {', '.join(map(str, light.channels))}" if light.channels else "its channel"
    if max(risen) < MIN_LEVEL:
        driver = f"the driver reports {flags}" if flags else "the driver reports no fault"
        return Finding(part, "failed", f"not visible to the camera; {driver}: check its LEDs and wires on {where}")
    seen = "RGB"[risen.index(max(risen))]
    if seen != light.colour:
        return Finding(part, "failed", f"should be {light.colour} but is {seen}: two lights are swapped; check {where}")
    own = risen["RGB".index(light.colour)]
    if flags:
        return Finding(part, "warning", f"visible at {own:.0%}, but driver reports {flags}: check its LEDs on {where}")
    return Finding(part, "ok", f"visible at {own:.0%} of full scale")


def _channel(hardware: Hardware, light: LightConfig) -> Finding:
    """Return one light by its channel, while all shine."""
    level = _levels(hardware, hardware.profile.currents_ma)["RGB".index(light.colour)]
    if level < MIN_LEVEL:
        return Finding(f"light {light.name}", "failed", "not visible to the camera: check the sensor's cable and gel")
    return Finding(f"light {light.name}", "ok", f"channel {light.colour} at {level:.0%} of full scale, all lights on")


def _levels(hardware: Hardware, currents_ma: dict[str, float]) -> Levels:
    """Return the median levels of a frame under these currents (mA)."""
    settings = hardware.profile.camera.settings
    plan = CaptureSettings(settings, hardware.lights.granted_ma(currents_ma))
    return channel_levels(capture(hardware, plan), 50.0)


def _flags_of(hardware: Hardware, light: LightConfig) -> str:
    """Return the driver's flags for one light while it is on, such as "open"."""
    lights = hardware.lights
    lights.switch_on(lights.granted_ma({light.name: light.current_ma}))
    try:
        flags: tuple[LightFault, ...] = lights.faults()
    finally:
        lights.off()
    return ", ".join(flag.kind for flag in flags if flag.light == light.name)


def _push(hardware: Hardware) -> Finding:
    hardware.button.clear_presses()
    hardware.operator.ask(LiftOff())
    press = hardware.button.wait_for_press(PUSH_TIMEOUT_S)
    if press is None:
        sentence = f"not pushed within {PUSH_TIMEOUT_S:g} s, or not wired: check button.line"
        return Finding("button push", "failed", sentence)
    return Finding("button push", "ok", f"pushed for {press.held_s:.2f} s")


# A check that the root file system is as read-only as the kernel's command line asks.

PROC = Path("/proc")
WRITABLE: Final = (
    "the root file system is writable although it is meant to be read-only: run install.sh --read-only again"
)
"""The initramfs had no overlay and went on without it: each power cut then meets files that are being written."""


def root_fault() -> str | None:
    """Return a sentence when an overlay was asked for and `/` is none, else None."""
    try:
        asked = (PROC / "cmdline").read_text(encoding="utf-8", errors="replace").split()
        mounts = (PROC / "self" / "mounts").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:  # no Linux
        return None
    if not any(word.startswith("overlayroot=") and word != "overlayroot=disabled" for word in asked):
        return None
    kinds = [fields[2] for line in mounts if len(fields := line.split()) > 2 and fields[1] == "/"]
    return None if kinds and kinds[-1] == "overlay" else WRITABLE

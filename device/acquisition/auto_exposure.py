"""Exposure and light currents, set so that ball presses use the sensor's range without saturation.

Near light varies several-fold over the field, and slopes that face a light are brighter than flat skin: a flat level of
half of full scale would clip. Hence the brightest level of ball presses near each light decides, and the flat level
follows from it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from device.acquisition.calibrate import prompt_and_wait
from device.acquisition.capture import CaptureSettings, capture
from device.acquisition.selftest import check_light_visible
from device.bundles.fingerprint import SettingsRecord
from device.errors import CalibrationError
from device.imaging.frame_light import BRIGHTEST_PERCENTILE, Levels, channel_levels
from device.store.choices import BALANCE, BalanceRecord
from hal.board_profile import LightConfig, SensorConfig
from hal.frame import CameraSettings
from hal.hardware import Hardware
from hal.interfaces import PressBall

AIMED_LEVEL: Final = 0.84
"""Target for the brightest level; leaves room for filter crosstalk and for a light's coarsest current step."""

SATURATED_LEVEL: Final = 0.95
MAX_HALVINGS: Final = 4
MIN_STEPS: Final = 50
"""Minimum exposure in sensor steps: shorter ones are too coarse, as one step would be more than 2 %."""

MAX_CURRENT: Final = 0.9
MIN_CURRENT: Final = 0.05
"""Fractions of a light's maximum current: below, the driver's steps are coarse; above, LEDs get hot."""

BORDER_MARGIN: Final = (1 / 8, 1 / 6)
"""Minimum distance of a press from the borders, as fractions of columns and rows, like the calibration's presses."""


@dataclass(frozen=True, slots=True)
class ExposureBalance:
    """Exposure and currents that bring ball presses to the target level.

    plan : the capture settings found
    predicted : brightest level, R, G, B, that ball presses are predicted to reach with them
    before, before_predicted : the settings that it replaces, and the same for them; above 1 they saturate
    limit : what keeps exposure or currents from being other ones, one sentence; empty if nothing does
    """

    plan: CaptureSettings
    predicted: Levels
    before: CaptureSettings
    before_predicted: Levels
    limit: str


class ExposureSearch:
    """Finds exposure and currents from one ball press near each light, press by press.

    Parameters
    ----------
    hardware : with the mounted gel
    ball_radius_mm : of the ball
    before : settings to compare with; None: the board profile's
    """

    def __init__(self, hardware: Hardware, ball_radius_mm: float, before: CaptureSettings | None = None) -> None:
        self._hardware = hardware
        self._radius_mm = ball_radius_mm
        self.plan = CaptureSettings.of_board(hardware)
        self._before = before or self.plan
        self._responses: list[list[float]] = []

    @property
    def taken(self) -> int:
        """Presses so far; one for each light is wanted."""
        return len(self._responses)

    @property
    def is_complete(self) -> bool:
        """True if `result` can be asked for."""
        return self.taken == len(self._hardware.profile.lights)

    @property
    def instruction(self) -> str:
        """Return where to press next, one sentence."""
        return f"press the ball as close to light {self._light.name} as possible, hold it, push the button."

    @property
    def request(self) -> PressBall:
        """Return what the operator should press next."""
        return PressBall(self._radius_mm, *_nearest_place(self._hardware.profile.sensor, self._light))

    def measure(self) -> None:
        """Measure the ball that is pressed now. Errors as for `auto_exposure`."""
        check_light_visible(self._hardware, self.plan, self._light)
        self._responses.append(_response(self._hardware, self.plan))

    def result(self) -> ExposureBalance:
        """Return what was found. Errors as for `auto_exposure`."""
        highest = [max(values) for values in zip(*self._responses, strict=True)]
        found, limit = _plan_for(self._hardware, self.plan.settings, highest)
        return ExposureBalance(found, _levels(highest, found), self._before, _levels(highest, self._before), limit)

    @property
    def _light(self) -> LightConfig:
        return self._hardware.profile.lights[self.taken]


def _levels(responses: list[float], plan: CaptureSettings) -> Levels:
    """Return the brightest level, R, G, B, that ball presses reach with a plan."""
    red, green, blue = (
        response * current * plan.settings.exposure_us
        for response, current in zip(responses, plan.currents_ma.values(), strict=True)
    )
    return red, green, blue


def auto_exposure(hardware: Hardware, ball_radius_mm: float, report_progress: Callable[[str], None]) -> ExposureBalance:
    """Return the exposure and currents for this gel and these lights, from one ball press near each light.

    Raises
    ------
    CalibrationError
        A light is too weak or too strong, or the frame saturates even with the weakest currents.
    HalError, FrameNotConfirmed
        The hardware failed.
    """
    search = ExposureSearch(hardware, ball_radius_mm)
    while not search.is_complete:
        report_progress(f"Exposure: {search.instruction}")
        prompt_and_wait(hardware, search.request)
        search.measure()
    return search.result()


def _nearest_place(sensor: SensorConfig, light: LightConfig) -> tuple[float, float]:
    """Return the field's point nearest to a light, as fractions of columns and rows."""
    fractions = [
        0.5 + position_mm / (size * sensor.pixel_pitch_um * 1e-3)
        for position_mm, size in zip(light.position_mm[:2], (sensor.columns, sensor.rows), strict=True)
    ]
    column, row = (min(max(f, margin), 1.0 - margin) for f, margin in zip(fractions, BORDER_MARGIN, strict=True))
    return column, row


def _response(hardware: Hardware, plan: CaptureSettings) -> list[float]:
    """Return the brightest level of each channel per mA and µs; the light is halved until nothing saturates."""
    for halving in range(MAX_HALVINGS + 1):
        dimmed = _dimmed(hardware, plan, 0.5**halving)
        currents_ma = dimmed.currents_ma
        _check_lit(currents_ma)
        frame = capture(hardware, dimmed)
        levels = channel_levels(frame, BRIGHTEST_PERCENTILE)
        if max(levels) >= SATURATED_LEVEL:
            continue
        exposed_us = frame.granted.exposure_us
        return [level / (c * exposed_us) for level, c in zip(levels, currents_ma.values(), strict=True)]
    raise CalibrationError(
        f"the frame saturates even with the light divided by {2**MAX_HALVINGS}: shield the gel from daylight, or "
        "shorten camera.exposure_us"
    )


def _check_lit(currents_ma: Mapping[str, float]) -> None:
    """Refuse a light that the driver's steps round down to zero."""
    for name, current_ma in currents_ma.items():
        if current_ma <= 0.0:
            raise CalibrationError(
                f"light {name} saturates at its lowest current: shorten camera.exposure_us, or shield the gel from "
                "daylight"
            )


def _dimmed(hardware: Hardware, plan: CaptureSettings, fraction: float) -> CaptureSettings:
    """Return a plan with that fraction of the light: of the currents, or of the exposure where lights are always on."""
    if not hardware.profile.lights_always_on:
        asked = {name: fraction * current for name, current in plan.currents_ma.items()}
        return CaptureSettings(plan.settings, hardware.lights.granted_ma(asked))
    step_us = hardware.profile.sensor.exposure_step_us
    exposure_us = max(fraction * plan.settings.exposure_us // step_us, 1.0) * step_us
    return CaptureSettings(CameraSettings(exposure_us, plan.settings.analogue_gain), plan.currents_ma)


def _plan_for_exposure(
    hardware: Hardware, settings: CameraSettings, doses: list[float], longest_us: float
) -> CaptureSettings:
    """Return settings that bring the brightest channel to the target level by exposure alone.

    For boards whose lights are always on.
    """
    currents_ma = hardware.profile.currents_ma
    exposure_us = min(dose / current for dose, current in zip(doses, currents_ma.values(), strict=True))
    step_us = hardware.profile.sensor.exposure_step_us
    if not step_us <= exposure_us <= longest_us:
        raise CalibrationError(
            f"the lights need an exposure of {exposure_us:.0f} µs and {step_us:g} to {longest_us:.0f} µs are possible: "
            "set camera.analogue_gain"
        )
    return CaptureSettings(CameraSettings(exposure_us // step_us * step_us, settings.analogue_gain), currents_ma)


def _plan_for(hardware: Hardware, settings: CameraSettings, responses: list[float]) -> tuple[CaptureSettings, str]:
    """Return settings that bring every channel to the target level, and what limits the exposure.

    The limit is one sentence, empty where the exposure is the board's.
    """
    lights = hardware.lights
    doses = [AIMED_LEVEL / response for response in responses]
    longest_us = hardware.profile.frame_period_us or 1e6
    if hardware.profile.lights_always_on:
        return _plan_for_exposure(hardware, settings, doses, longest_us), "The lights are always on: exposure alone."
    enough_us = max(doses) / (MAX_CURRENT * lights.max_ma)
    fine_us = min(doses) / (MIN_CURRENT * lights.max_ma)
    shortest_us = min(MIN_STEPS * hardware.profile.sensor.exposure_step_us, longest_us)
    exposure_us = max(min(settings.exposure_us, fine_us), enough_us, shortest_us)
    if exposure_us > longest_us:
        weakest = lights.names[doses.index(max(doses))]
        raise CalibrationError(
            f"light {weakest} is too weak: it needs {exposure_us:.0f} µs and at most {longest_us:.0f} µs are possible; "
            "raise the gain or mount the light closer"
        )
    granted_ma = lights.granted_ma({name: dose / exposure_us for name, dose in zip(lights.names, doses, strict=True)})
    _check_lit(granted_ma)
    found = CaptureSettings(CameraSettings(exposure_us, settings.analogue_gain), granted_ma)
    weakest, strongest = lights.names[doses.index(max(doses))], lights.names[doses.index(min(doses))]
    limits = {
        shortest_us: f"Shorter exposures are too coarse for the sensor: {exposure_us:.0f} µs is its shortest.",
        fine_us: f"Light {strongest} is strong: the exposure is shorter, or its current would be too coarse to set.",
        enough_us: f"Light {weakest} is weak: the exposure is longer, with {MAX_CURRENT * lights.max_ma:.0f} mA "
        f"for it, of at most {lights.max_ma:.0f} mA.",
        settings.exposure_us: "",
    }
    return found, limits[exposure_us]


# Exposure and light currents of the next calibration.


def calibration_settings(hardware: Hardware, root: Path) -> CaptureSettings:
    """Return what the next calibration is taken with; a balance of another gel, board or other lights does not count.

    hardware : with the mounted gel
    """
    usual, balance = CaptureSettings.of_board(hardware), BALANCE.read_sound(root)
    if balance is None or (balance.board, balance.gel_id) != (hardware.profile.name, hardware.profile.gel.id):
        return usual
    if set(balance.currents_ma) != set(hardware.lights.names):
        return usual
    asked_ma = {name: balance.currents_ma[name] for name in hardware.lights.names}
    return CaptureSettings(balance.settings.settings, hardware.lights.granted_ma(asked_ma))


def keep_balance(hardware: Hardware, root: Path, plan: CaptureSettings) -> None:
    """Take later calibrations of this gel with these settings. Errors as for `RecordFile.write`."""
    balance = BalanceRecord(
        board=hardware.profile.name,
        gel_id=hardware.profile.gel.id,
        settings=SettingsRecord.of(plan.settings),
        currents_ma=dict(plan.currents_ma),
    )
    BALANCE.write(root, balance)

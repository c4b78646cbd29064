"""Inputs of a calibration: a frame set, or a calibration bundle of a handheld."""

from __future__ import annotations

from typing import Any, Final

from device.bundles.calibration import CALIBRATION_MANIFEST, CalibrationBundle, CalibrationRecord
from device.imaging.flat_field import demosaic
from hal.board_profile import BoardProfile, load_board_profile
from hal.errors import BoardProfileError
from host_sync.calibration.balls import GridSpacing, PressFrame
from host_sync.calibration.frames import CalibrationFrames
from host_sync.calibration_file.cache import key_of
from host_sync.errors import FrameSetError
from host_sync.frames.frame_set import FrameSet, FrameSpec, PressSpec
from host_sync.frames.linear_light import mark_pattern, read_frame

NO_REFERENCE_FRAMES: Final = 24
"""At most so many frames stand in for a missing reference."""


def frames_of_set(frame_set: FrameSet) -> CalibrationFrames:
    """Return the frames that a frame set's calibration is made from.

    Raises
    ------
    FrameSetError
        A frame is unreadable.
    """
    presses = tuple(press_frame(press, frame_set) for press in frame_set.presses)
    reference = read_frame(frame_set.reference) if frame_set.reference else None
    others = tuple(read_frame(frame) for frame in stand_ins(frame_set))
    return CalibrationFrames(
        presses,
        reference,
        frame_set.pixel_pitch_um,
        others,
        frame_set.lights,
        lights_mm=frame_set.lights_mm,
        pupil_height_mm=frame_set.pupil_height_mm,
        states_pixel_shape=frame_set.states_pixel_shape,
        states_diameters=frame_set.states_diameters,
        pitch_tolerance=frame_set.pitch_tolerance,
        marks=mark_pattern(frame_set.reference) if frame_set.reference else None,
    )


def frames_of_bundle(bundle: CalibrationBundle) -> CalibrationFrames:
    """Return the frames of a calibration bundle, with the balls that the device found in them.

    Raises
    ------
    RecordError
        A frame is damaged.
    """
    record = bundle.record
    presses = tuple(
        PressFrame(
            name=press.file,
            frame=demosaic(bundle.press_frame(press)),
            radius_px=press.ball_radius_mm * 1e3 / record.pixel_pitch_um,
            balls=tuple(ball.ball for ball in press.balls),
        )
        for press in record.presses
        if press.balls
    )
    reference = demosaic(bundle.reference())
    board = _known_board(record)
    on_usb = board is not None and board.uvc is not None  # its lights are no points
    lights_mm = () if on_usb else tuple(light.position_mm for light in record.fingerprint.lights)
    return CalibrationFrames(
        presses, reference, record.pixel_pitch_um, lights_mm=lights_mm, pupil_height_mm=_pupil_height_mm(record, board)
    )


def _pupil_height_mm(record: CalibrationRecord, board: BoardProfile | None) -> float | None:
    """Return the camera's height over untouched skin; of an older record, which does not hold it, that of its board."""
    return board.pupil_height_mm if record.pupil_height_mm is None and board is not None else record.pupil_height_mm


def _known_board(record: CalibrationRecord) -> BoardProfile | None:
    """Return the profile of a calibration's board; None of a builder's own."""
    if record.board.endswith(".toml"):
        return None
    try:
        return load_board_profile(record.board)
    except BoardProfileError:
        return None


def key_of_set(frame_set: FrameSet) -> str:
    """Return the digest of everything that a frame set's calibration is made from.

    Raises
    ------
    FrameSetError
        A frame is unreadable.
    """
    specs = [press.frame for press in frame_set.presses]
    specs += [frame_set.reference] if frame_set.reference else stand_ins(frame_set)
    presses = [_settings(press, frame_set) for press in frame_set.presses]
    settings: tuple[Any, ...] = (
        frame_set.pixel_pitch_um,
        presses,
        [(len(spec.images), spec.encoding) for spec in specs],
    )
    stored = frame_set.pixel_shape, frame_set.full_scale
    settings = (*settings, "stored", stored) if stored != (1.0, None) else settings
    settings = (*settings, frame_set.lights) if frame_set.lights else settings
    settings = (*settings, "light places", frame_set.lights_mm) if frame_set.lights_mm else settings
    settings = (*settings, "two pitches") if frame_set.states_pixel_shape else settings
    settings = (*settings, "diameters") if frame_set.states_diameters else settings
    settings = (*settings, "± pitch", frame_set.pitch_tolerance) if frame_set.pitch_tolerance is not None else settings
    settings = (*settings, "pupil", frame_set.pupil_height_mm) if frame_set.pupil_height_mm else settings
    try:
        return key_of(settings, [image for spec in specs for image in spec.images])
    except OSError as error:
        raise FrameSetError(f"{error.filename}: cannot be read ({error.strerror}): name another image") from error


def key_of_bundle(bundle: CalibrationBundle) -> str:
    """Return the digest of everything that a bundle's calibration is made from.

    Raises
    ------
    OSError
        A file is missing.
    """
    names = (CALIBRATION_MANIFEST, *bundle.record.raw_files)
    pupil_mm = _pupil_height_mm(bundle.record, _known_board(bundle.record))
    settings: Any = "bundle" if pupil_mm is None else ("bundle", pupil_mm)
    return key_of(settings, [bundle.directory / name for name in names])


def stand_ins(frame_set: FrameSet) -> list[FrameSpec]:
    """Return frames that help to stand in for a missing reference."""
    return [] if frame_set.reference else [scan.frame for scan in frame_set.scans[:NO_REFERENCE_FRAMES]]


def _settings(press: PressSpec, frame_set: FrameSet) -> tuple[Any, ...]:
    """Return what a frame set says of a press."""
    radii = (press.ball_radius_mm, press.radius_px, press.radius_tolerance_mm)
    return press.name, _source(press, frame_set), press.balls, *radii, press.grid_pitch_mm, press.grid_tolerance_mm


def press_frame(press: PressSpec, frame_set: FrameSet) -> PressFrame:
    """Return the press as calibration takes it; errors as for `read_frame`."""
    tolerance = press.radius_tolerance_mm
    return PressFrame(
        name=press.name,
        frame=read_frame(press.frame),
        radius_px=press.radius_px,
        balls=press.balls,
        labelled_by_hand=press.balls is not None,
        source=_source(press, frame_set),
        grid=GridSpacing(press.grid_pitch_mm, press.grid_tolerance_mm) if press.grid_pitch_mm else None,
        radius_tolerance=tolerance / press.ball_radius_mm if tolerance is not None else None,
    )


def _source(press: PressSpec, frame_set: FrameSet) -> str:
    """Return the press's file as seen from the frame set's folder."""
    image, folder = press.frame.images[0], frame_set.path.parent
    return str(image.relative_to(folder)) if image.is_relative_to(folder) else image.name

"""Inputs of a calibration, a frame set or a bundle of a handheld, and the calibrations made of them before."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import msgspec

from device.bundles.calibration import CALIBRATION_MANIFEST, CalibrationBundle, CalibrationRecord
from device.errors import FrameError
from device.imaging.flat_field import check_exposed, demosaic
from device.io.atomic import replace_file
from hal.board_profile import BoardProfile, load_board_profile
from hal.errors import BoardProfileError
from host_sync.calibration.balls import GridSpacing, PressFrame
from host_sync.calibration.frames import CalibrationFrames
from host_sync.calibration_file.kept_calibration import KeptCalibration, read_calibration_file
from host_sync.errors import CalibrationFileError, FrameSetError
from host_sync.frames.frame_set import FrameSet, FrameSpec, PressSpec
from host_sync.frames.linear_light import mark_pattern, read_frame
from host_sync.kernels.cache import KEPT_S, PACKAGES, state_of, user_cache

NO_REFERENCE_FRAMES: Final = 24
"""At most so many frames stand in for a missing reference."""


def frames_of_set(frame_set: FrameSet) -> CalibrationFrames:
    """Return the frames that a frame set's calibration is made from.

    A black or saturated press is left out, unless all are.

    Raises
    ------
    FrameSetError
        A frame is unreadable.
    """
    every = tuple(press_frame(press, frame_set) for press in frame_set.presses)
    faults = [_fault(press) for press in every]
    presses = tuple(press for press, fault in zip(every, faults, strict=True) if not fault) or every
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
        left_out=tuple(f"{fault}; it is not used" for fault in faults if fault) if presses is not every else (),
    )


def _fault(press: PressFrame) -> str:
    """Return why a press cannot be used whatever it shows; empty if it can."""
    try:
        check_exposed(press.frame, press.label)
    except FrameError as error:
        return str(error)
    return ""


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


# Calibrations that were made before, by a digest of everything they were made from.
#
# The digest covers the contents of the frames, what the frame set or bundle says of them, the state of the package's
# own source files, and the versions of the libraries that compute. So nothing in the cache is ever out of date; what
# nobody used for a month goes, and the least recently used go when there are too many.

LIBRARIES: Final = ("numpy", "scipy", "opencv-contrib-python-headless", "numba")
SUFFIX: Final = ".calibration"
MAX_BYTES: Final = 4 << 30
CHUNK_BYTES: Final = 1 << 22


class CalibrationCache:
    """Calibrations in a folder; a folder that cannot be read or written is one that keeps nothing.

    Parameters
    ----------
    folder : where they lie, None for nowhere
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    @classmethod
    def of_user(cls, environment: Mapping[str, str] = os.environ) -> CalibrationCache:
        """Return the user's cache."""
        home = user_cache(environment)
        return cls(home and home / "calibrations")

    def find(self, key: str) -> KeptCalibration | None:
        """Return the calibration with this key, None where there is none that can be read."""
        if self._folder is None:
            return None
        path = self._path(key)
        try:
            if not path.is_file():
                return None
            kept = read_calibration_file(path)
            os.utime(path)
        except CalibrationFileError:
            with suppress(OSError):
                path.unlink()
            return None
        except OSError:
            return None
        return kept if kept.facts.key == key else None

    def keep(self, kept: KeptCalibration) -> bool:
        """Keep a calibration under its key; returns whether it was possible."""
        if self._folder is None or not kept.facts.key:
            return False
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            replace_file(self._path(kept.facts.key), kept.as_file())
            self._prune(kept.facts.key)
        except OSError:
            return False
        return True

    def _path(self, key: str) -> Path:
        assert self._folder is not None  # noqa: S101 - asked only where there is one
        return self._folder / f"{key}{SUFFIX}"

    def _prune(self, own: str) -> None:
        """Remove what nobody used for a month, and the least recently used while there is more than `MAX_BYTES`."""
        assert self._folder is not None  # noqa: S101 - asked only where there is one
        found = sorted(
            ((one.stat(), one) for one in self._folder.glob(f"*{SUFFIX}")), key=lambda pair: pair[0].st_mtime
        )
        newest_s = max(facts.st_mtime for facts, _ in found)
        total = sum(facts.st_size for facts, _ in found)
        for facts, path in found:
            if path != self._path(own) and (facts.st_mtime < newest_s - KEPT_S or total > MAX_BYTES):
                path.unlink(missing_ok=True)
                total -= facts.st_size


def key_of(settings: object, files: Iterable[Path]) -> str:
    """Return the digest of settings, files' contents, the package's own state and the libraries' versions.

    Raises
    ------
    OSError
        A file cannot be read.
    """
    digest = blake2b(digest_size=16)
    digest.update(state_of(*PACKAGES).encode())
    digest.update(" ".join(f"{name} {version(name)}" for name in LIBRARIES).encode())
    digest.update(msgspec.msgpack.encode(settings))
    for path in files:
        digest.update(f"\0{path.stat().st_size}\0".encode())
        with path.open("rb") as stream:
            while chunk := stream.read(CHUNK_BYTES):
                digest.update(chunk)
    return digest.hexdigest()

"""Sources of a command's calibrations: a file that was named, the cache, or frames that calibrate now."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from device.bundles.calibration import CalibrationBundle
from device.errors import RecordError
from host_sync.calibration.calibrate import Calibration
from host_sync.calibration.frames import CalibrationFrames, calibrate_frames
from host_sync.calibration_file.inputs import (
    CalibrationCache,
    frames_of_bundle,
    frames_of_set,
    key_of_bundle,
    key_of_set,
)
from host_sync.calibration_file.kept_calibration import (
    Facts,
    KeptCalibration,
    facts_of,
    make_calibration,
    read_calibration_file,
)
from host_sync.errors import CalibrationFileError
from host_sync.frames.frame_set import FrameSet
from host_sync.frames.linear_light import mark_pattern

Progress = Callable[[str], None]


class Calibrator:
    """Gives the calibration of a frame set or bundle; each is made once, however often it is asked for.

    Parameters
    ----------
    cache : where calibrations are looked for, and kept
    given : a calibration that is taken whatever is asked for, with where it came from
    report_progress : is given a few words as each step begins
    obtained : is given every calibration and a sentence on where it came from
    paper : every calibration must hold the paper's model
    """

    def __init__(
        self,
        cache: CalibrationCache | None = None,
        *,
        given: tuple[KeptCalibration, str] | None = None,
        report_progress: Progress = lambda _: None,
        obtained: Callable[[KeptCalibration, str], None] = lambda _, __: None,
        paper: bool = False,
    ) -> None:
        self._cache = cache or CalibrationCache(None)
        self._given = given
        self._report_progress = report_progress
        self._obtained = obtained
        self._paper = paper
        self._known: dict[str, KeptCalibration] = {}

    @classmethod
    def of_file(
        cls,
        path: Path,
        *,
        obtained: Callable[[KeptCalibration, str], None] = lambda _, __: None,
        paper: bool = False,
    ) -> Calibrator:
        """Return a calibrator that always gives the calibration in a file.

        Raises
        ------
        CalibrationFileError
            It cannot be read, or does not hold the paper's model.
        """
        kept = read_calibration_file(path)
        if paper and kept.calibration.paper is None:
            raise CalibrationFileError(
                f"{path}: holds no model of the paper's method: make it with `retrosync calibrate --paper`"
            )
        return cls(given=(kept, f"from {path}, made {kept.facts.made_utc}"), obtained=obtained)

    @property
    def is_named(self) -> bool:
        """True if one calibration was named, which is taken whatever is asked for."""
        return self._given is not None

    def named(self) -> KeptCalibration:
        """Return the calibration that was named; only where one was."""
        assert self._given is not None  # noqa: S101 - the caller asked `is_named`, or made it so
        kept, source = self._given
        if not self._known:
            self._known[""] = kept
            self._obtained(kept, source)
        return kept

    def of_frame_set(self, frame_set: FrameSet) -> KeptCalibration:
        """Return the calibration that a frame set's presses carry.

        Raises
        ------
        FrameSetError, DeviceError
            A frame is unreadable, or the presses do not carry a calibration.
        """
        if self._given is not None:
            return self.named()
        self._report_progress("looking for an earlier calibration")
        key = key_of_set(frame_set)
        frame = frame_set.presses[0].frame
        marks = mark_pattern(frame_set.reference) if frame_set.reference else None

        def facts(calibration: Calibration) -> Facts:
            return facts_of(
                calibration,
                frame_set.name,
                key,
                encoding=frame.encoding,
                full_scale=frame.full_scale,
                pixel_shape=frame.pixel_shape,
                marks_px=marks.width_px if marks else 0.0,
            )

        return self._take(key, facts, lambda: frames_of_set(frame_set))

    def of_bundle(self, bundle: CalibrationBundle) -> KeptCalibration:
        """Return the calibration that the frames of a bundle and the balls that the device found in them carry.

        Raises
        ------
        RecordError, CalibrationError
            A frame is damaged, or the frames do not carry a calibration.
        """
        if self._given is not None:
            return self.named()
        try:
            key = key_of_bundle(bundle)
        except OSError as error:
            raise RecordError(f"{error.filename}: cannot be read ({error.strerror}): pull it again") from error

        def facts(calibration: Calibration) -> Facts:
            return facts_of(calibration, bundle.calibration_id, key, bundle=bundle)

        return self._take(key, facts, lambda: frames_of_bundle(bundle))

    def _take(
        self, key: str, facts: Callable[[Calibration], Facts], frames: Callable[[], CalibrationFrames]
    ) -> KeptCalibration:
        known = self._known.get(key)
        if known is not None:
            return known
        kept, source = self._cache.find(key), ""
        if kept is not None and not (self._paper and kept.calibration.paper is None):
            source = f"made {kept.facts.made_utc} and kept since"
        else:
            began_s = time.monotonic()
            self._report_progress("reading frames")
            kept = make_calibration(replace(frames(), paper=self._paper), facts, self._report_progress)
            source = f"made now in {time.monotonic() - began_s:.0f} s"
            if self._cache.keep(kept):
                source += " and kept for the next time"
        self._known[key] = kept
        self._obtained(kept, source)
        return kept


def calibrate_frame_set(
    frame_set: FrameSet, report_progress: Progress = lambda _: None, *, paper: bool = False
) -> Calibration:
    """Return the calibration that a frame set's presses carry, made now; errors as for `Calibrator.of_frame_set`."""
    report_progress("reading frames")
    return calibrate_frames(replace(frames_of_set(frame_set), paper=paper), report_progress)


def calibration_of(
    bundle: CalibrationBundle, report_progress: Progress = lambda _: None, *, paper: bool = False
) -> Calibration:
    """Return the calibration that a bundle carries, made now; errors as for `Calibrator.of_bundle`."""
    return calibrate_frames(replace(frames_of_bundle(bundle), paper=paper), report_progress)

"""The movie of a scan's press as a sequence of frames of full size."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from device.errors import RecordError
from device.imaging.mosaic_binning import unbin_mosaic
from host_sync.errors import SequenceError
from host_sync.frames.sequence import BadFrame, StoredFrame

if TYPE_CHECKING:
    from device.bundles.scan import ScanBundle


class BundleMovie:
    """Frames of half the size, each pixel of one colour four times, so that the scan's calibration reads them.

    Raises
    ------
    SequenceError
        The scan holds no movie.
    """

    def __init__(self, bundle: ScanBundle) -> None:
        movie = bundle.record.movie
        if movie is None:
            raise SequenceError(f"{bundle.scan_id}: holds no movie: scan with --capture movie, or name another scan")
        self._bundle, self._frames = bundle, movie.frames

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self._frames)

    @property
    def rate_hz(self) -> float | None:
        """Frames per second from the first to the last; None of a single frame."""
        lasting_ms = self._frames[-1].at_ms - self._frames[0].at_ms
        return 1e3 * (len(self._frames) - 1) / lasting_ms if lasting_ms > 0.0 else None

    def frames(self) -> Iterator[StoredFrame | BadFrame]:
        """Every frame."""
        for frame in self._frames:
            try:
                yield StoredFrame(frame.file, unbin_mosaic(self._bundle.movie_frame(frame.file)))
            except RecordError as error:
                yield BadFrame(frame.file, str(error))

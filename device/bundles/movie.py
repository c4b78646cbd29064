"""Record of the movie of a press, in the bundle of its scan."""

from __future__ import annotations

from typing import Annotated, Final

import msgspec

from device.bundles.record import Count, Figure, FileName, NotNegative, Record

MAX_MOVIE_FRAMES: Final = 200


class MovieFrameRecord(Record, frozen=True):
    """One frame of a movie.

    file : the raw frame, of the scan's size divided by the binning
    at_ms : after the first one's exposure began
    contact_fraction, depth_um : fraction of the field that is in contact, and how far the skin is raised, as the guide
        measures them; None where it cannot
    """

    file: FileName
    at_ms: NotNegative
    contact_fraction: Figure | None = None
    depth_um: Figure | None = None


class MovieRecord(Record, frozen=True):
    """The movie of a press.

    binning : pixels of one colour that were taken together, in each direction
    best : number of the frame that is, averaged with later ones that did not move, the scan's own raw frame
    frames : in order of time
    """

    binning: Annotated[int, msgspec.Meta(ge=2, le=2)]
    best: Count
    frames: Annotated[tuple[MovieFrameRecord, ...], msgspec.Meta(min_length=1, max_length=MAX_MOVIE_FRAMES)]

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the frames' files."""
        return tuple(frame.file for frame in self.frames)

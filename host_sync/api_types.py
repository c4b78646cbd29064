"""Types of the arguments and results of `host_sync.api`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from xarray import Dataset

    from device.surface import Float32Array
    from host_sync.results.reader import ResultSurface
    from host_sync.video.contact import Contact
    from host_sync.video.frame_solver import FrameSolver
    from host_sync.video.stream import LiveHeights

    Image = str | Path | tuple[str | Path, ...] | NDArray[Any]
    """An RGB image file; a grey one a light (three in R, G, B order); or an array of shape (H, W, N): uint8, uint16, or
    fractions of full scale."""

Encoding = Literal["linear", "srgb"]
Method = Literal["direct", "paper"]
Detail = Literal["shrunk", "raw"]
Kept = Literal["newest", "every"]


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """A calibration press: an image in which balls of one radius touch the skin.

    balls : (column, row, radius of the trusted contact) of each, pixels; None to have them found
    grid_pitch_mm : distance of neighbouring balls when they form a square grid

    >>> Press("ball-0.png", ball_radius_mm=0.96, balls=[(76.8, 80.6, 28.8)]).ball_radius_mm
    0.96
    """

    image: Image
    ball_radius_mm: float
    balls: Sequence[tuple[float, float, float]] | None = None
    grid_pitch_mm: float | None = None


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Result:
    """A reconstructed surface; every array has the shape (H, W), is float32, and NaN where nothing is known.

    It is shown in one line, and in a notebook as its relief with its doubts.

    surface : the same as the workstation's other parts take it

    >>> result = load_result("results/ball")
    >>> result
    <Result ball-6: 384 x 288 pixels of 20 µm, heights ... to ... µm, ± ... µm, ...>
    >>> bool(result.height_um[130, 154] > 200.0)  # the ball's apex, µm above untouched skin
    True
    """

    surface: ResultSurface

    @property
    def height_um(self) -> Float32Array:
        """Height, µm; zero at untouched skin unless a warning says that it is relative."""
        return self.surface.height.z_um

    @property
    def sigma_um(self) -> Float32Array | None:
        """Standard uncertainty of the height, µm; None where the result's folder does not hold it."""
        return self.surface.sigma_um

    @property
    def slopes(self) -> tuple[Float32Array, Float32Array]:
        """Slopes p along a row and q down a column, µm/µm."""
        from device.surface import surface_slopes

        return surface_slopes(self.surface.height)

    @property
    def pitch_um(self) -> float:
        """Distance of neighbouring pixels on the skin, µm."""
        return self.surface.height.pitch_um

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what speaks against the heights, one sentence each."""
        return tuple(doubt.sentence for doubt in self.surface.doubts)

    def __repr__(self) -> str:
        return f"<Result {self.surface.record.name}: {self._facts()}>"

    def _repr_html_(self) -> str:
        """Return the relief, facts and doubts, as a notebook shows them."""
        from base64 import b64encode
        from html import escape

        from host_sync.viewer.responses import thumbnail

        picture = b64encode(thumbnail(self.height_um, self.pitch_um)).decode()
        doubts = "".join(f"<li>doubt: {escape(words)}</li>" for words in self.warnings)
        name = escape(self.surface.record.name)
        return (
            f'<figure><img alt="Relief of {name}" src="data:image/webp;base64,{picture}">'
            f"<figcaption><b>{name}</b>: {escape(self._facts())}</figcaption><ul>{doubts}</ul></figure>"
        )

    def _facts(self) -> str:
        """Return the size, heights, the median ± and the number of doubts."""
        import numpy as np

        (rows, columns), known = self.height_um.shape, self.height_um[np.isfinite(self.height_um)]
        heights = f"heights {known.min():.4g} to {known.max():.4g} µm" if known.size else "no height"
        sigma_um = np.empty(0) if self.sigma_um is None else self.sigma_um[np.isfinite(self.sigma_um)]
        error = f"± {np.median(sigma_um):.2g} µm" if sigma_um.size else "± not known"
        doubts = f"{len(self.warnings)} doubt{'' if len(self.warnings) == 1 else 's'}"
        return f"{columns} x {rows} pixels of {self.pitch_um:g} µm, {heights}, {error}, {doubts}"

    def to_xarray(self) -> Dataset:
        """Return the result as a Dataset of the package xarray; coordinates in µm.

        Raises
        ------
        ArgumentError
            xarray is not installed.

        >>> dataset = load_result("results/ball").to_xarray()
        >>> sorted(dataset.data_vars), dataset.height.attrs["units"], dataset.attrs["method"]
        (['height', 'height_sigma', 'slope_p', 'slope_q'], 'um', 'direct')
        >>> bool(dataset.height.sel(x=3080.0, y=2600.0) > 200.0)
        True
        """
        import numpy as np

        from host_sync.errors import ArgumentError

        try:
            import xarray
        except ImportError as error:
            raise ArgumentError("xarray is not installed: pip install 'retrograph[xarray]'") from error
        rows, columns = self.height_um.shape
        p, q = self.slopes
        fields = {"height": (self.height_um, "um"), "slope_p": (p, "um/um"), "slope_q": (q, "um/um")}
        if self.sigma_um is not None:
            fields["height_sigma"] = (self.sigma_um, "um")
        places = {"y": np.arange(rows) * self.pitch_um, "x": np.arange(columns) * self.pitch_um}
        record = self.surface.record
        return xarray.Dataset(
            {name: (("y", "x"), values, {"units": unit}) for name, (values, unit) in fields.items()},
            {axis: ((axis,), at, {"units": "um"}) for axis, at in places.items()},
            {name: getattr(record, name) for name in ("name", "method", "calibration_id")} | {"doubts": self.warnings},
        )


@dataclass(frozen=True, slots=True, eq=False)
class HeightFrame:
    """Heights of one frame of a stream; arrays have the shape (H, W), are float32, and NaN where nothing is known.

    number : of the source's frames, from 0; those that were dropped count
    time_s : when it was taken, from the first frame on
    height_um : height, µm, zero at untouched skin
    sigma_um : its standard uncertainty, µm; None where it was not asked for
    problem : the reason why the frame has no heights, or no zero; None where all is well

    >>> with stream(["ball-6.png"], load_calibration("gel.calibration"), sigma=True) as heights:
    ...     (frame,) = heights
    >>> frame.number, frame.problem, bool(frame.contact.area_mm2 > 3.0 * frame.contact.area_sigma_mm2)
    (0, None, True)
    """

    number: int
    name: str
    time_s: float
    height_um: Float32Array
    sigma_um: Float32Array | None
    pitch_um: float
    problem: str | None = None

    @property
    def contact(self) -> Contact:
        """Contact with the skin: mask, area, centre, largest depth, each with its ± where `sigma_um` is known."""
        from host_sync.video.contact import find_contact

        return find_contact(self.height_um, self.pitch_um, self.sigma_um)


class HeightStream:
    """Heights of the frames of a source: an iterator, and a context manager that releases the source.

    shape, pitch_um : of the height maps

    >>> heights = stream(["ball-6.png"], load_calibration("gel.calibration"))
    >>> heights.shape, heights.pitch_um, heights.dropped, heights.problem
    ((288, 384), 20.0, 0, None)
    >>> heights.close()
    """

    def __init__(self, live: LiveHeights, solver: FrameSolver) -> None:
        self.shape, self.pitch_um = solver.shape, solver.pitch_um
        self._live, self._solved = live, iter(live)

    @property
    def dropped(self) -> int:
        """Number of frames that came while another was solved and were dropped."""
        return self._live.dropped

    @property
    def problem(self) -> str | None:
        """The sentence on a sensor that was unplugged and is looked for; None while it gives frames."""
        return self._live.problem

    def __iter__(self) -> Iterator[HeightFrame]:
        return self

    def __next__(self) -> HeightFrame:
        from host_sync.integration.zero_level import NO_ZERO

        one = next(self._solved)
        problem = NO_ZERO if one.statistics is not None and one.statistics.is_relative else one.reason
        return HeightFrame(
            one.number, one.name, self._live.time_s(one), one.height_um, one.sigma_um, self.pitch_um, problem
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the source."""
        self._live.close()

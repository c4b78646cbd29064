"""Six grey images of a groove against the maker's own height map: one half of the rows teaches, the other is compared.

    python -m tests.benchmarks.accuracy.groove [FOLDER]

FOLDER holds `image01.png` to `image06.png` and `heightmap.tmd` (gelsightinc/gsmatlab, demo/groove); by default
`groove` in the folder that RETROGRAPH_DATA names. Slopes of the taught half come from the maker's map, blurred by 1 px;
form and penalty are those by which either half of the taught rows reads the other best, so that the compared rows
choose nothing; the compared half is integrated with the rest, and a plane is taken off its difference. Depth: from the
0.5th to the 99.5th percentile.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from device.balls.sphere import BallSamples
from device.calibration.candidates import RegressorFit, RegressorForm, fit_regressor
from device.imaging.flat_field import LinearFrame, NormalizedImage, estimate_flat_field, flat_field_correct
from device.inverse_map.model import InverseMap
from device.inverse_map.training_domain import TrainingDomain
from device.surface import GradientField, stereographic_from_slope
from host_sync.export.array_formats import read_tmd
from host_sync.frames.frame_set import FrameSpec
from host_sync.frames.linear_light import read_frame
from host_sync.integration.integrate import integrate
from host_sync.light_groups import Group, choose_groups, in_group
from tests.benchmarks.accuracy.real_sets import data_folder

LIGHTS: Final = 6
SAMPLES: Final = 60_000
BANDS: Final = 2
FORMS: Final = tuple(RegressorForm(colour, place) for colour in (2, 3, 4) for place in (0, 1, 2))
PENALTIES: Final = tuple(float(value) for value in 10.0 ** np.arange(-6.0, 0.0))
TRUTH_BLUR_PX: Final = 1.0

Mask = NDArray[np.bool_]
Heights = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GrooveError:
    """Rms difference to the maker's map and depth of the compared rows, µm."""

    rms_um: float
    depth_um: float

    @property
    def percent(self) -> float:
        """The difference in percent of the depth."""
        return 100.0 * self.rms_um / self.depth_um


class Groove:
    """The images, the maker's heights z (µm) and their slopes p and q."""

    def __init__(self, folder: Path) -> None:
        height = read_tmd(folder / "heightmap.tmd")
        self.z = height.z_um.astype(np.float64)
        self.pitch_um = height.pitch_um
        images = tuple(folder / f"image{number:02d}.png" for number in range(1, LIGHTS + 1))
        self.frame: LinearFrame = read_frame(FrameSpec(images, "linear"))
        self.flat_field = estimate_flat_field([self.frame])
        self.groups: tuple[Group, ...] = choose_groups([self.frame])
        smooth = cv2.GaussianBlur(self.z, (0, 0), TRUTH_BLUR_PX)
        self.q, self.p = np.gradient(smooth / self.pitch_um)

    def rows(self, first: float, last: float) -> Mask:
        """The rows between two shares of the height, bool array of shape (H, W)."""
        count = self.z.shape[0]
        inside = np.zeros(self.z.shape, np.bool_)
        inside[round(first * count) : round(last * count)] = True
        return inside

    def error(self, taught: Mask, groups: Sequence[Group]) -> GrooveError:
        """The error of the rows that are not taught, by the mean slopes of these groups."""
        known = taught & np.isfinite(self.p + self.q)
        fields = [self._read(group, known) for group in groups]
        p, q = (np.mean(parts, axis=0).astype(np.float32) for parts in zip(*fields, strict=True))
        everywhere = np.ones(self.z.shape, np.bool_)
        height, _ = integrate(GradientField(p, q, everywhere, everywhere.astype(np.float32)), self.pitch_um)
        judged = ~taught & np.isfinite(self.z)
        off = _without_plane(height.z_um.astype(np.float64) - self.z, judged)[judged]
        low, high = np.percentile(_without_plane(self.z, judged)[judged], (0.5, 99.5))
        return GrooveError(float(np.sqrt(np.mean(off**2))), float(high - low))

    def _read(self, group: Group, known: Mask) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Slopes of the whole field by a map that the known pixels taught."""
        flat_field = np.ascontiguousarray(self.flat_field[..., list(group)])
        image: NormalizedImage = flat_field_correct(in_group(self.frame, group), flat_field)
        row, column = np.nonzero(known)
        chosen = np.random.default_rng(0).choice(len(row), SAMPLES, replace=False)
        row, column = row[chosen], column[chosen]
        samples = BallSamples(
            image.values[row, column],
            self.p[row, column].astype(np.float32),
            self.q[row, column].astype(np.float32),
            column.astype(np.float32),
            row.astype(np.float32),
            ((row - row.min()) * BANDS // (np.ptp(row) + 1)).astype(np.intp),
        )
        slope = np.stack([samples.p, samples.q], axis=-1).astype(np.float64)
        shape = (known.shape[0], known.shape[1])
        fitted = _best_fit(samples, slope, shape)
        solved = fitted.ridge.solve(fitted.penalty, slope, np.ones(len(slope)), np.ones(BANDS, np.bool_))
        steepest = float(np.hypot(samples.p, samples.q).max())
        curve = fitted.curve(solved)
        read = InverseMap(shape, TrainingDomain.observed(samples.intensity), curve, steepest).gradients(image)
        return read.p, read.q


def _best_fit(samples: BallSamples, slope: Heights, shape: tuple[int, int]) -> RegressorFit:
    """The learner whose form and penalty read each band of the taught rows best from the other."""
    wanted = stereographic_from_slope(slope[:, 0], slope[:, 1])
    judged = []
    for form in FORMS:
        ridge = fit_regressor(samples, shape, form, PENALTIES[0]).ridge
        held_out = ridge.held_out(
            PENALTIES, slope, np.ones(len(slope)), np.ones(BANDS, np.bool_), np.arange(BANDS, dtype=np.intp)
        )
        judged += [
            (float(np.mean((read - wanted) ** 2)), form, penalty)
            for penalty, read in zip(PENALTIES, held_out, strict=True)
        ]
    _, form, penalty = min(judged, key=lambda one: one[0])
    return fit_regressor(samples, shape, form, penalty)


def _without_plane(values: Heights, where: Mask) -> Heights:
    """Values less the plane that fits them there."""
    row, column = np.nonzero(where)
    design = np.stack([column, row, np.ones(len(row))], axis=-1).astype(np.float64)
    across, down, level = np.linalg.lstsq(design, values[where], rcond=None)[0]
    rows, columns = np.mgrid[: values.shape[0], : values.shape[1]]
    return np.asarray(values - (across * columns + down * rows + level))


def main() -> int:
    """Print the errors of both halves, with three lights and with six."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else data_folder() / "groove"
    if not (folder / "heightmap.tmd").is_file():
        sys.stderr.write(f"{folder}: holds no heightmap.tmd: set RETROGRAPH_DATA, or name the folder\n")
        return 2
    groove = Groove(folder)
    for name, taught in (
        ("lower half from upper", groove.rows(0.0, 0.5)),
        ("upper half from lower", groove.rows(0.5, 1.0)),
    ):
        parts = []
        for label, groups in (("three lights", groove.groups[:1]), ("six", groove.groups)):
            error = groove.error(taught, groups)
            parts.append(f"{label} {error.percent:.2f} % of {error.depth_um:.0f} µm")
        sys.stdout.write(f"{name}: {', '.join(parts)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())

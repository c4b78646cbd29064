"""Sizes and repeats: the full benchmark, or a quick one that only shows that everything runs."""

from __future__ import annotations

from dataclasses import dataclass

Shape = tuple[int, int]


@dataclass(frozen=True)
class Plan:
    """Sizes (H, W) and repeats.

    calibrated : size of the twin that is calibrated; its field is the same at every size
    presses : calibration presses on the workstation
    large, small : sizes of integration, gradients and cost: 12 MP and 1.6 MP
    direct : size for the sparse direct solver
    scans : raw frames for the whole pipeline
    handheld : raw frames for the quick look
    rounds : runs of each method
    frames : length of the video sequence
    lights_enlarged : times the rows and columns of the small frames under rings of lights
    """

    quick: bool
    calibrated: Shape
    presses: int
    large: Shape
    small: Shape
    direct: Shape
    scans: tuple[Shape, ...]
    handheld: tuple[Shape, ...]
    rounds: int
    frames: int
    lights_enlarged: int


FULL = Plan(
    quick=False,
    calibrated=(272, 364),
    presses=12,
    large=(3040, 4056),
    small=(1088, 1456),
    direct=(384, 512),
    scans=((380, 508), (1088, 1456), (1944, 2592), (3040, 4056)),
    handheld=((1520, 2028), (3040, 4056)),
    rounds=9,
    frames=12,
    lights_enlarged=2,
)

QUICK = Plan(
    quick=True,
    calibrated=(136, 182),
    presses=4,
    large=(144, 192),
    small=(72, 96),
    direct=(48, 64),
    scans=((192, 256),),
    handheld=((192, 256),),
    rounds=1,
    frames=2,
    lights_enlarged=1,
)


def named(shape: Shape) -> str:
    """A size as in figures: columns x rows."""
    return f"{shape[1]}x{shape[0]}"

"""Python interface: calibrate, reconstruct, integrate, measure, with numpy arrays in and out.

Importing it takes a few hundredths of a second: what computes is imported when it is called.

>>> from host_sync import api
>>> presses = [api.Press(f"ball-{i}.png", ball_radius_mm=0.96) for i in range(6)]
>>> calibration = api.calibrate(presses, reference="flat.png", pixel_pitch_um=20.0)
>>> result = api.reconstruct("ball-6.png", calibration)
>>> result.height_um.shape, result.height_um.dtype
((288, 384), dtype('float32'))

Bad input raises a `host_sync.errors.HostError` or a `device.errors.DeviceError`, whose message is one sentence; an
argument of the wrong type raises an `ArgumentError`, which is a HostError.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from host_sync.api_types import Detail, Encoding, HeightStream, Kept, Method, Press
from host_sync.api_types import HeightFrame as HeightFrame
from host_sync.api_types import Result as Result
from host_sync.kernels.process_settings import one_blas_thread

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from device.errors import DeviceError
    from device.surface import Float32Array
    from host_sync.api_types import Image
    from host_sync.calibration_file.kept_calibration import KeptCalibration
    from host_sync.errors import HostError
    from host_sync.library.library import Library
    from host_sync.measurement.quantity import Quantity


def calibrate(
    presses: Sequence[Press],
    *,
    reference: Image | None = None,
    pixel_pitch_um: float | tuple[float, float],
    encoding: Encoding = "linear",
    full_scale: int | None = None,
    paper: bool = False,
    pupil_height_mm: float | None = None,
) -> KeptCalibration:
    """Return the calibration that presses of balls carry; `write(path)` keeps it, `load_calibration` reads it.

    reference : the skin at rest; without it a stand-in is fitted to the presses
    pixel_pitch_um, pupil_height_mm : of pixels on the skin, and of the camera over it (`docs/frame-set.md`)
    encoding : how pixel values encode light
    full_scale : count at which a pixel of 16 bit is saturated; found from the images when None
    paper : also fit the paper's model, for `reconstruct(..., method="paper")`

    Raises
    ------
    FrameSetError, DeviceError
        An image is unreadable, or the presses do not carry a calibration.

    >>> labelled = [Press(f"ball-{i}.png", 0.96) for i in range(6)]
    >>> calibration = calibrate(labelled, reference="flat.png", pixel_pitch_um=20.0)
    >>> calibration.calibration.held_out_deg["direct"] < 5.0
    True
    >>> calibration.summary[0]  # what did not pass is named here
    'calibration passed (6 balls, held-out error ... degrees, ± of the height scale unknown ...)'
    >>> calibration.write("own.calibration")
    """
    from host_sync.api_arguments import (
        check_choice,
        height_of,
        image_form,
        linear_frame,
        pitch_and_shape,
        press_frame,
        press_list,
    )
    from host_sync.calibration.frames import CalibrationFrames
    from host_sync.calibration_file.kept_calibration import facts_of, make_calibration

    check_choice("encoding", encoding, Encoding)
    pitch_um, pixel_shape = pitch_and_shape(pixel_pitch_um)
    listed = press_list(presses)
    images = [press.image for press in listed] + ([reference] if reference is not None else [])
    form = image_form(images, encoding, full_scale, pixel_shape)
    frames = CalibrationFrames(
        tuple(press_frame(number, press, pitch_um, form) for number, press in enumerate(listed)),
        linear_frame(reference, form) if reference is not None else None,
        pitch_um,
        paper=paper,
        pupil_height_mm=height_of(pupil_height_mm),
    )
    with one_blas_thread():
        return make_calibration(
            frames,
            lambda found: facts_of(
                found,
                "a Python program",
                encoding=encoding,
                full_scale=form.full_scale,
                pixel_shape=pixel_shape,
            ),
        )


def calibrate_frame_set(path: str | Path, *, cached: bool = True, paper: bool = False) -> KeptCalibration:
    """Return the calibration of a frame set's file.

    cached : take it from the user's cache where it was made before, and keep it there
    paper : as for `calibrate`

    Raises
    ------
    FrameSetError, DeviceError
        The file or an image is unreadable, or the presses do not carry a calibration.

    >>> calibrate_frame_set("frameset.toml").facts.made_from
    'gel-3'
    """
    from host_sync.api_arguments import as_path
    from host_sync.calibration_file.calibrator import Calibrator
    from host_sync.calibration_file.inputs import CalibrationCache
    from host_sync.frames.frame_set import load_frame_set

    cache = CalibrationCache.of_user() if cached else None
    with one_blas_thread():
        return Calibrator(cache, paper=paper).of_frame_set(load_frame_set(as_path("path", path)))


def load_calibration(path: str | Path) -> KeptCalibration:
    """Return the calibration in a file that `retrosync calibrate` or `write` made.

    Raises
    ------
    CalibrationFileError
        It is missing, damaged, or of another version of the program.

    >>> load_calibration("gel.calibration").calibration.pitch_um
    20.0
    """
    from host_sync.api_arguments import as_path
    from host_sync.calibration_file.kept_calibration import read_calibration_file

    return read_calibration_file(as_path("path", path))


def reconstruct(
    image: Image,
    calibration: KeptCalibration,
    *,
    encoding: Encoding | None = None,
    full_scale: int | None = None,
    method: Method | None = None,
    detail: Detail = "shrunk",
    force: bool = False,
    out: str | Path | None = None,
) -> Result:
    """Return the surface that an image shows.

    encoding, full_scale : how pixel values encode light; as in calibration when None
    method : by default the one with the smaller held-out error
    detail : shrunk removes pixel noise, raw keeps it
    force : reconstruct an image too that the calibration does not explain
    out : folder for result files, as `retrosync reconstruct` writes them

    Raises
    ------
    FrameSetError, DeviceError
        The image is unreadable, black or saturated, or was not made as the calibration was.
    CalibrationFileError
        `calibration` is none; a file's is what `load_calibration` returns.
    OutputError
        The folder cannot be written.

    >>> result = reconstruct("ball-6.png", load_calibration("gel.calibration"))
    >>> bool(result.sigma_um[130, 154] < 0.1 * result.height_um[130, 154])
    True
    """
    from host_sync.api_arguments import as_path, check_calibration, check_choice, image_form, linear_frame
    from host_sync.reconstruction.pipeline import reconstruct as reconstruct_frame
    from host_sync.reconstruction.result_writer import result_record, write_result
    from host_sync.results.reader import ResultSurface

    check_calibration(calibration)
    for argument, given, choices in (("encoding", encoding, Encoding), ("method", method, Method)):
        if given is not None:
            check_choice(argument, given, choices)
    check_choice("detail", detail, Detail)
    folder = as_path("out", out) if out is not None else None
    name = Path(str(image)).stem if isinstance(image, str | Path) else "image"
    facts = calibration.facts
    scale = facts.full_scale if full_scale is None else full_scale
    frame = linear_frame(image, image_form([image], encoding or facts.encoding or "linear", scale, facts.pixel_shape))
    with one_blas_thread():
        found = reconstruct_frame(frame, calibration.calibration, name, method, force=force, detail=detail)
    if folder is not None:
        write_result(folder, found, calibration.calibration, name)
    return Result(
        ResultSurface(
            folder=folder or Path(name),
            record=result_record(name, found, calibration.calibration),
            height=found.height,
            samples_um=found.samples_um,
            slope_sigma=found.slope_sigma,
            sigma_um=found.sigma_um,
            extrapolated=found.extrapolated,
            other=found.other,
        )
    )


def reconstruct_many(
    images: Iterable[Image],
    calibration: KeptCalibration,
    *,
    workers: int | None = None,
    **options: Any,
) -> Iterator[Result | HostError | DeviceError]:
    """Yield the surfaces of many images in order, several at once; in place of one that cannot be used, the error.

    workers : images at once; by default as many as there are cores
    options : as of `reconstruct`, without `out`

    >>> found = reconstruct_many(["ball-6.png", "flat.png"], load_calibration("gel.calibration"), workers=2)
    >>> [bool(result.height_um.max() > 100.0) for result in found]
    [True, False]
    """
    from host_sync.api_arguments import check_calibration, reconstructed_in_order

    check_calibration(calibration)
    return reconstructed_in_order(lambda image: reconstruct(image, calibration, **options), images, workers)


def stream(
    source: int | str | Path | Iterable[NDArray[Any]],
    calibration: KeptCalibration,
    *,
    frames: Kept | None = None,
    sigma: bool = False,
    encoding: Encoding | None = None,
    full_scale: int | None = None,
    method: Method | None = None,
    force: bool = False,
) -> HeightStream:
    """Return heights of the frames of a sensor or a recording as they come: iterate over it, in a `with` statement.

    source : a board profile's name ("digit"), a camera's number, a movie or folder of frames, or arrays
    frames : "newest" drops those that came while one was solved, as by default of a sensor; "every" solves all
    sigma : also find the uncertainty of heights, which takes about twice as long
    encoding, full_scale, method, force : as of `reconstruct`

    Raises
    ------
    SourceError, SequenceError
        The source cannot be opened. A sensor that is unplugged later is said in `problem` and looked for again.
    CalibrationFileError
        `calibration` is none.

    >>> with stream(["ball-6.png"], load_calibration("gel.calibration")) as heights:
    ...     for frame in heights:
    ...         print(frame.height_um.shape, f"{frame.contact.depth_um:.0f} µm deep")
    (288, 384) ... µm deep
    """
    from host_sync.api_arguments import check_calibration, check_choice, open_stream

    check_calibration(calibration)
    for argument, given, choices in (
        ("frames", frames, Kept),
        ("encoding", encoding, Encoding),
        ("method", method, Method),
    ):
        if given is not None:
            check_choice(argument, given, choices)
    return open_stream(source, calibration, frames, sigma, encoding, full_scale, method, force)


def load_result(folder: str | Path) -> Result:
    """Return the result in a folder that `retrosync reconstruct` wrote.

    Raises
    ------
    UnreadableResult
        A file is missing or damaged.

    >>> load_result("results/ball").pitch_um
    20.0
    """
    from host_sync.api_arguments import as_path
    from host_sync.results.reader import read_result

    return Result(read_result(as_path("folder", folder)))


def mosaic(results: Sequence[str | Path], out: str | Path) -> Result:
    """Return the surface that overlapping presses of one object show together.

    results : folders that `retrosync reconstruct` wrote
    out : folder for the result; `mosaic.json` in it holds every overlap, used or rejected

    Raises
    ------
    MosaicError
        There are fewer than two presses, their pixel pitches differ, none overlap, or `out` is one of them.
    UnreadableResult
        A press's folder lacks a file, or one is damaged.
    OutputError
        The folder cannot be written, or holds other files.

    >>> whole = mosaic(["results/left", "results/right"], out="results/whole")
    >>> whole.height_um.shape[1] > load_result("results/left").height_um.shape[1]
    True
    """
    from host_sync.api_arguments import as_path, as_paths
    from host_sync.mosaic.presses import presses_of
    from host_sync.mosaic.stitch import stitch

    folders, whole = as_paths("results", results), as_path("out", out)
    with one_blas_thread():
        stitch(presses_of(folders, whole), whole)
    return load_result(whole)


def integrate(
    p: NDArray[Any], q: NDArray[Any], weights: NDArray[Any] | None = None, *, pitch_um: float = 1.0
) -> Float32Array:
    """Return heights in µm, float32 array (H, W), whose slopes are p along a row and q down a column, least squares.

    p, q : shape (H, W), µm/µm; a pixel that is not finite, or masked in a numpy masked array, is a hole
    weights : relative confidence of each pixel; a pixel of weight 0 or without a finite slope is a hole, NaN

    Raises
    ------
    IntegrationError
        p, q or weights are no arrays of numbers of one shape, a weight is negative, every pixel is a hole, or the pitch
        is not positive.

    >>> import numpy as np
    >>> row, column = np.mgrid[:60, :80]
    >>> z_um = integrate(np.full((60, 80), 0.1), np.zeros((60, 80)), pitch_um=5.0)
    >>> bool(np.ptp(z_um - 0.5 * column) < 1e-2)
    True
    """
    from host_sync.api_arguments import gradient_field, pitch_of
    from host_sync.integration.integrate import integrate as integrate_field

    height, _ = integrate_field(gradient_field(p, q, weights), pitch_of(pitch_um))
    return height.z_um


def measure(result: Result | str | Path, recipe: str | Path | None = None, **options: object) -> tuple[Quantity, ...]:
    """Return quantities of a surface, each with its uncertainty.

    result : from `reconstruct`, `load_result` or `mosaic`; or a folder, as `load_result` takes it
    recipe : TOML file of `docs/measurement.md`; without it the default one
    options : keys of a recipe that change it, such as `parameters=("Sa", "Sz")` or `form="plane"`

    Raises
    ------
    MeasurementError
        The recipe cannot be read, or a measurand is not found on the surface.
    UnreadableResult
        A file of the folder is missing or damaged.

    >>> (sa,) = measure(load_result("results/ball"), form="plane", parameters=("Sa",))
    >>> sa.name, sa.unit, sa.value > sa.uncertainty > 0.0
    ('Sa', 'µm', True)
    """
    from host_sync.api_arguments import as_path, surface_of
    from host_sync.measurement.measure import measure as measure_surface
    from host_sync.measurement.recipe import Recipe, checked, from_options, read_recipe

    surface = surface_of(result)
    chosen = read_recipe(as_path("recipe", recipe)) if recipe is not None else Recipe()
    chosen = checked(from_options(chosen, options), "options") if options else chosen
    return measure_surface(surface, chosen).quantities


def open_library(folder: str | Path) -> Library:
    """Return a library of pulled scans and calibrations; nothing is read yet.

    Raises
    ------
    LibraryError
        There is no such folder.

    >>> open_library("library").root.name
    'library'
    """
    from host_sync.api_arguments import as_path
    from host_sync.library.library import Library

    library = Library(as_path("folder", folder))
    library.require()
    return library

"""`retrosync import`: folders that other sensors' programs wrote, as a frame set."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from device.command_line import Folder
from host_sync.cli.console import DONE, print_line
from host_sync.errors import FrameSetError

if TYPE_CHECKING:
    from collections.abc import Callable

    from host_sync.importers.draft import Draft, Said

Kind = Literal["gelsight", "gs_sdk", "py3dcal", "taxim", "digit", "images"]
SET_FILE: Final = "frameset.toml"


def import_command(
    kind: Kind,
    source: Folder,
    /,
    *,
    out: Folder | None = None,
    pixel_pitch_um: float | None = None,
    ball_radius_mm: float | None = None,
    encoding: Literal["linear", "srgb"] | None = None,
    reference: Path | None = None,
) -> int:
    """Describe another program's folder as a frame set; its files stay as they are. What is missing is asked for.

    Parameters
    ----------
    kind
        gelsight: scan.yaml folders of the SDK and Mobile; gs_sdk: its calibration folder; py3dcal: its dataset; taxim:
        dataPack.npz beside its images; digit and images: a folder of RGB images.
    source
        The folder.
    out
        The frame set's file, or a folder for it; by default frameset.toml in the source's folder.
    pixel_pitch_um
        Distance of neighbouring pixels on the skin; goes before what the files say.
    ball_radius_mm
        Radius of the calibration ball; goes before what the files say.
    encoding
        How pixel values encode light.
    reference
        The image of untouched skin, or for gelsight its scan's folder.
    """
    from host_sync.importers.draft import Said

    for name, value in (("--pixel-pitch-um", pixel_pitch_um), ("--ball-radius-mm", ball_radius_mm)):
        if value is not None and not 0.0 < value < float("inf"):
            raise FrameSetError(f"{name} {value:g}: is no length: give a positive number")
    if not source.is_dir():
        raise FrameSetError(f"{source}: is no folder: name the folder that the other program wrote")
    draft = _importer(kind)(source, Said(pixel_pitch_um, ball_radius_mm, encoding, reference))
    path = out or source
    path = path if path.suffix == ".toml" else path / SET_FILE
    draft.write(path)
    lights = f" of {len(draft.lights)} lights" if draft.lights else ""
    print_line(f"{path}: {len(draft.presses)} presses and {len(draft.scans)} scans{lights}")
    for note in draft.notes:
        print_line(f"Note: {note}.")
    if not draft.reference:
        print_line("No frame of untouched skin is known: name it with --reference, or it is estimated from the frames.")
    if not draft.presses:
        print_line("No press calibrates: reconstruct with --calibration FILE.")
    for scan in draft.scans:
        if scan.height_map is not None:
            print_line(f"{scan.name}: the maker's height map is {scan.height_map}")
    return DONE


def _importer(kind: Kind) -> Callable[[Path, Said], Draft]:
    from host_sync.importers.ball_tables import import_gs_sdk, import_py3dcal
    from host_sync.importers.gelsight_scan import import_gelsight
    from host_sync.importers.image_folder import import_images
    from host_sync.importers.taxim_pack import import_taxim

    importers: dict[Kind, Callable[[Path, Said], Draft]] = {
        "gelsight": import_gelsight,
        "gs_sdk": import_gs_sdk,
        "py3dcal": import_py3dcal,
        "taxim": import_taxim,
        "digit": import_images,
        "images": import_images,
    }
    return importers[kind]

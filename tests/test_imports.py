"""What may import what, file by file; a new file is held to it without being named anywhere.

The contracts in `pyproject.toml` forbid paths between packages. Here every file's own imports are compared with what
its part of the house may use; as that holds for every file, it holds for whatever they reach together.
"""

import subprocess
import sys

import grimp
import pytest

PORTABLE_ROOMS = (
    "device.io",
    "device.surface",
    "device.imaging",
    "device.align",
    "device.inverse_map",
    "device.balls",
    "device.calibration",
    "device.bundles",
    "device.quick_look",
    "device.pairing",
    "device.errors",
    "device.shutdown",
    "device.command_line",
)
PORTABLE_LIBRARIES = {"numpy", "scipy", "cv2", "msgspec", "tifffile", "imagecodecs", "cyclopts", "filelock"}
PORTABLE_HAL = {
    "hal",
    "hal.board_profile",
    "hal.clock",
    "hal.validation",
    "hal.errors",
    "hal.frame",
    "hal.interfaces",
    "hal.profile_tables",
}
INSTRUMENT_ONLY = ("textual", "picamera2", "libcamera", "smbus2", "gpiod")


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    return grimp.build_graph("hal", "device", "host_sync", include_external_packages=True)


@pytest.fixture(scope="module")
def portable_device(graph: grimp.ImportGraph) -> set[str]:
    """Every module of the portable rooms, and the package itself."""
    return {"device", *PORTABLE_ROOMS}.union(*(graph.find_descendants(room) for room in PORTABLE_ROOMS))


def strangers(graph: grimp.ImportGraph, importers: set[str], allowed: set[str]) -> list[str]:
    """What those modules import beside the standard library and what is allowed, as `importer -> imported`."""
    known = allowed | sys.stdlib_module_names
    return sorted(
        f"{importer} -> {imported}"
        for importer in importers
        for imported in graph.find_modules_directly_imported_by(importer)
        if imported not in known
    )


def test_portable_rooms_of_the_handheld_import_portable_modules_only(
    graph: grimp.ImportGraph, portable_device: set[str]
) -> None:
    assert "device.surface" in portable_device
    assert strangers(graph, portable_device, portable_device | PORTABLE_HAL | PORTABLE_LIBRARIES) == []


def test_the_part_of_hal_that_portable_rooms_use_is_portable(graph: grimp.ImportGraph) -> None:
    assert strangers(graph, PORTABLE_HAL & graph.modules, PORTABLE_HAL | PORTABLE_LIBRARIES) == []


def test_the_workstation_uses_only_portable_rooms_of_the_instrument(
    graph: grimp.ImportGraph, portable_device: set[str]
) -> None:
    own = {"host_sync"} | graph.find_descendants("host_sync")
    reached = {imported for module in own for imported in graph.find_modules_directly_imported_by(module)}
    # A sensor that is plugged into the workstation: one module opens it, when it is asked to (decision 0025).
    own_sensor = {"hal.factory", "hal.hardware"} & graph.find_modules_directly_imported_by("host_sync.video.sensors")
    for module in own - {"host_sync.video.sensors"}:
        assert own_sensor.isdisjoint(graph.find_modules_directly_imported_by(module))
    of_the_instrument = {module for module in reached - own_sensor if module.partition(".")[0] in {"hal", "device"}}
    assert of_the_instrument - portable_device - PORTABLE_HAL == set()
    assert reached.isdisjoint(INSTRUMENT_ONLY)


IMPORT_ALL_OF_THE_WORKSTATION = """
import importlib, pkgutil, sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in BLOCKED:
            raise ModuleNotFoundError(f"{name} is not on a workstation", name=name)
        return None

BLOCKED = set(sys.argv[1:])
sys.meta_path.insert(0, Absent())
import host_sync
for module in pkgutil.walk_packages(host_sync.__path__, "host_sync.", onerror=lambda name: sys.exit(name)):
    importlib.import_module(module.name)
    print(module.name)
reached = BLOCKED | {"hal.simulator", "hal.drivers", "hal.hardware", "device.acquisition", "device.tui"}
sys.exit(", ".join(sorted(reached & set(sys.modules))) or 0)
"""


def test_every_module_of_the_workstation_loads_without_the_instruments_libraries(graph: grimp.ImportGraph) -> None:
    loaded = subprocess.run(
        [sys.executable, "-c", IMPORT_ALL_OF_THE_WORKSTATION, *INSTRUMENT_ONLY],
        capture_output=True,
        text=True,
        check=False,
    )
    assert loaded.returncode == 0, loaded.stderr
    assert set(loaded.stdout.split()) == graph.find_descendants("host_sync")

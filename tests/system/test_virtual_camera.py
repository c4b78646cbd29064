"""libcamera's virtual pipeline under our driver: what it can show, and that it is refused for what it cannot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

import pytest
from virtual_machine import VirtualMachine

pytestmark = pytest.mark.system

TREE = Path(__file__).parents[2]
SET_UP = """
mount -t configfs none /sys/kernel/config
mount -t 9p -o trans=virtio,version=9p2000.L,ro source /mnt/source
mount -t 9p -o trans=virtio,version=9p2000.L,ro handover /mnt/handover
/usr/local/lib/virtual/parts
/opt/camera/bin/python -m pip install --quiet --no-index --no-deps --no-compile /mnt/handover/retrograph-*.whl
mkdir /tmp/clauses
cp /mnt/source/tests/hal/conformance/test_camera.py /tmp/clauses/
cp /mnt/source/tests/system/virtual_camera/clauses.py /tmp/clauses/test_virtual_camera.py
cp /mnt/source/tests/system/virtual_camera/fixtures.py /tmp/clauses/conftest.py
"""
PASSED, REFUSED = 9, 4
"""Clauses that this camera satisfies, and those that it must refuse by name: they want raw, exposure and gain."""

RUN = """
cd /tmp
LIBCAMERA_LOG_LEVELS="*:FATAL" /opt/camera/bin/python -m pytest \
    -c /dev/null --rootdir /tmp/clauses -p no:cacheprovider --import-mode=importlib -q -rA /tmp/clauses
"""


@pytest.fixture(scope="module")
def machine(
    system_cache: Path,
    wheel: Path,
    tmp_path_factory: pytest.TempPathFactory,
    stage: Callable[[str], AbstractContextManager[None]],
) -> Iterator[VirtualMachine]:
    """With the test's agent as its first process: no systemd is wanted."""
    folder = tmp_path_factory.mktemp("vm")
    with ExitStack() as held:
        with stage("camera: boot"):
            machine = VirtualMachine(
                system_cache, folder, {"source": TREE, "handover": wheel.parent}, init="/usr/local/lib/virtual/agent"
            )
            held.enter_context(machine)
        yield machine


def test_clauses_of_a_camera_on_libcameras_virtual_pipeline(
    machine: VirtualMachine, stage: Callable[[str], AbstractContextManager[None]]
) -> None:
    with stage("camera: clauses"):
        machine.run(SET_UP)
        answer = machine.ask(RUN)
    lines = answer.text.splitlines()
    assert answer.code == 0, answer.text
    assert sum(line.startswith("PASSED") for line in lines) == PASSED, answer.text
    assert sum(line.startswith("XFAIL") for line in lines) == REFUSED, answer.text
    assert not any(line.startswith(("SKIPPED", "XPASS", "ERROR clauses")) for line in lines), answer.text

"""The driver of sensors on USB on the kernel's test camera, vivid; skipped where the board's kernel lacks it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

import pytest
from virtual_machine import VirtualMachine

pytestmark = pytest.mark.system

TREE = Path(__file__).parents[2]
SET_UP = """
mount -t 9p -o trans=virtio,version=9p2000.L,ro source /mnt/source
mount -t 9p -o trans=virtio,version=9p2000.L,ro handover /mnt/handover
/opt/camera/bin/python -m pip install --quiet --no-index --no-deps --no-compile /mnt/handover/retrograph-*.whl
mkdir /tmp/clauses
cp /mnt/source/tests/system/virtual_sensor/clauses.py /tmp/clauses/test_virtual_sensor.py
"""
PASSED = 5
RUN = """
cd /tmp
/opt/camera/bin/python -m pytest \
    -c /dev/null --rootdir /tmp/clauses -p no:cacheprovider --import-mode=importlib -q -rA /tmp/clauses
"""


@pytest.fixture(scope="module")
def machine(
    system_cache: Path,
    wheel: Path,
    tmp_path_factory: pytest.TempPathFactory,
    stage: Callable[[str], AbstractContextManager[None]],
) -> Iterator[VirtualMachine]:
    folder = tmp_path_factory.mktemp("vm")
    with ExitStack() as held:
        with stage("sensor on USB: boot"):
            machine = VirtualMachine(
                system_cache, folder, {"source": TREE, "handover": wheel.parent}, init="/usr/local/lib/virtual/agent"
            )
            held.enter_context(machine)
        yield machine


def test_clauses_of_a_sensor_on_usb_on_vivid(
    machine: VirtualMachine, stage: Callable[[str], AbstractContextManager[None]]
) -> None:
    if machine.ask("modprobe vivid n_devs=1 node_types=0x1").code != 0:
        pytest.skip("the virtual board's kernel has no vivid: build it with CONFIG_VIDEO_VIVID")
    with stage("sensor on USB: clauses"):
        machine.run(SET_UP)
        answer = machine.ask(RUN, timeout_s=400.0)
    assert answer.code == 0, answer.text
    assert sum(line.startswith("PASSED") for line in answer.text.splitlines()) == PASSED, answer.text

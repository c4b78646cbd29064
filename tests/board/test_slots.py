"""Two slots for the program: an update takes over only when it proves itself, and otherwise nothing has changed."""

import ast
import fcntl
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from broken_release import ENTRY, INSTRUMENT, SELF_TEST, spoiled

Run = Callable[..., subprocess.CompletedProcess[str]]
Release = Callable[..., Path]
SLOT = "board/retrograph-slot"
ROOT = Path(__file__).parents[2]


@pytest.fixture
def app(fresh: Path) -> Path:
    (fresh / "etc/default").mkdir(parents=True, exist_ok=True)
    (fresh / "etc/default/retroscan").write_text("RETROSCAN_BOARD=twin\n")
    return fresh / "data/app"


def version_in_use(app: Path) -> str:
    return (app / "current" / "ready").read_text().strip()


def put_on_trial(app: Path, starts: int = 0) -> None:
    """As it is between the swap and the first start."""
    previous = "b" if (app / "current").readlink() == Path("a") else "a"
    (app / "trial").write_text(f"{previous} {starts}\n")


def test_the_first_one_goes_into_slot_a(app: Path, run: Run, release: Release) -> None:
    assert run(SLOT, "install", release("1.0")).returncode == 0
    assert (app / "current").readlink() == Path("a")
    assert "slot a: 1.0, in use" in run(SLOT, "status").stdout


def test_updates_alternate(app: Path, run: Run, release: Release) -> None:
    for version, slot in (("1.0", "a"), ("1.1", "b"), ("1.2", "a")):
        assert run(SLOT, "install", release(version)).returncode == 0
        assert (app / "current").readlink() == Path(slot)
        assert version_in_use(app) == version


def test_one_that_fails_its_selftest_is_refused_and_the_old_one_stays(app: Path, run: Run, release: Release) -> None:
    run(SLOT, "install", release("1.0"))
    ran = run(SLOT, "install", release("1.1", selftest=3))
    assert ran.returncode == 1
    assert "version 1.1 fails its self-test: version 1.0 stays" in ran.stderr
    assert "mend the hardware" not in ran.stderr
    assert version_in_use(app) == "1.0"
    assert not (app / "trial").exists()
    assert run(SLOT, "rollback").returncode == 3, "what failed is nothing to go back to"
    assert version_in_use(app) == "1.0"


def test_when_the_old_one_fails_too_the_hardware_is_named(app: Path, run: Run, release: Release) -> None:
    run(SLOT, "install", release("1.0", selftest=3))
    assert "mend the hardware first" in run(SLOT, "install", release("1.1", selftest=3)).stderr


@pytest.mark.parametrize("broken", ["does not start", "no wheel", "two wheels", "no lock", "no folder"])
def test_what_cannot_be_installed_changes_nothing(app: Path, run: Run, release: Release, broken: str) -> None:
    run(SLOT, "install", release("1.0"))
    folder = release("1.1", start=1 if broken == "does not start" else 0)
    if broken == "no wheel":
        next(folder.glob("*.whl")).unlink()
    if broken == "two wheels":
        (folder / "retrograph-9-py3-none-any.whl").touch()
    if broken == "no lock":
        (folder / "requirements-device.lock").unlink()
    ran = run(SLOT, "install", folder / "nowhere" if broken == "no folder" else folder)
    assert ran.returncode in (1, 2)
    assert ran.stderr.count("\n") == 1
    assert version_in_use(app) == "1.0"
    assert "slot a: 1.0, in use" in run(SLOT, "status").stdout


def test_packages_are_proven_by_hash_and_taken_from_the_folder_when_it_has_them(
    app: Path, run: Run, release: Release
) -> None:
    folder = release("1.0")
    run(SLOT, "install", folder)
    (folder / "wheels").mkdir()
    run(SLOT, "install", folder)
    online, offline = ((app / slot / "bin/pip-calls").read_text() for slot in "ab")
    assert "--require-hashes" in online
    assert "--no-index" not in online
    assert f"--no-index --find-links {folder}/wheels" in offline


def test_pip_unpacks_on_the_data_partition_and_leaves_nothing_there(app: Path, run: Run, release: Release) -> None:
    """A Zero 2 W's /tmp lies in memory, and is smaller than the packages."""
    assert run(SLOT, "install", release("1.0")).returncode == 0
    calls = (app / "a/bin/pip-calls").read_text()
    assert "--no-cache-dir" in calls
    assert calls.endswith(f" TMPDIR={app}/scratch\n")
    assert not (app / "scratch").exists()
    (app / "scratch").mkdir()
    (app / "scratch/of-a-power-cut").touch()
    assert run(SLOT, "install", release("1.1", start=1)).returncode == 1
    assert not (app / "scratch").exists()


def test_an_interrupted_filling_is_no_slot_to_go_back_to(app: Path, run: Run, release: Release) -> None:
    run(SLOT, "install", release("1.0"))
    (app / "b/bin").mkdir(parents=True)
    ran = run(SLOT, "rollback")
    assert ran.returncode == 3
    assert "slot b holds no whole version" in ran.stderr
    assert version_in_use(app) == "1.0"


def test_by_hand_back_and_forth(app: Path, run: Run, release: Release) -> None:
    run(SLOT, "install", release("1.0"))
    run(SLOT, "install", release("1.1"))
    for version in ("1.0", "1.1"):
        assert run(SLOT, "rollback").returncode == 0
        assert version_in_use(app) == version


@pytest.mark.parametrize("command", [("install",), ("rollback",), ("trial",)])
def test_one_at_a_time_swaps_slots(app: Path, run: Run, release: Release, command: tuple[str]) -> None:
    run(SLOT, "install", release("1.0"))
    run(SLOT, "install", release("1.1"))
    put_on_trial(app)
    arguments = (release("1.2"),) if command == ("install",) else ()
    with (app / "lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        ran = run(SLOT, *command, *arguments)
    assert (ran.returncode, ran.stderr) == (1, "retrograph: another update is under way: wait for it\n")
    assert version_in_use(app) == "1.1"
    assert (app / "trial").exists()


@pytest.fixture
def status(tmp_path: Path) -> Callable[[str], dict[str, str]]:
    """The environment in which the service manager knows this status of an instrument."""

    def make(text: str) -> dict[str, str]:
        systemctl = tmp_path / "bin/systemctl"
        systemctl.parent.mkdir()
        systemctl.write_text(f"#!/bin/bash\n[ \"${{*: -1}}\" = retroscan.service ] && echo '{text}'\n")
        systemctl.chmod(0o755)
        return {"PATH": f"{systemctl.parent}:{os.environ['PATH']}"}

    return make


def test_after_a_power_cut_an_update_proves_itself_at_boot(
    app: Path, run: Run, release: Release, status: Callable[[str], dict[str, str]]
) -> None:
    run(SLOT, "install", release("1.0"))
    run(SLOT, "install", release("1.1"))
    put_on_trial(app)
    assert run(SLOT, "trial").returncode == 0
    assert version_in_use(app) == "1.1"
    assert run(SLOT, "confirm", "retroscan.service", **status("ready: room for 9 scans")).returncode == 0
    assert not (app / "trial").exists()


def test_one_that_starts_out_of_order_is_not_confirmed(
    app: Path, run: Run, release: Release, status: Callable[[str], dict[str, str]]
) -> None:
    run(SLOT, "install", release("1.0"))
    run(SLOT, "install", release("1.1"))
    put_on_trial(app)
    ran = run(SLOT, "confirm", "retroscan.service", **status("out of order: no chip answers at 0x15"))
    assert (ran.returncode, (app / "trial").exists()) == (0, True)
    assert "version 1.1 is not confirmed: out of order: no chip answers" in ran.stderr


def test_after_a_power_cut_one_that_fails_goes_back(app: Path, run: Run, release: Release) -> None:
    run(SLOT, "install", release("1.0"))
    run(SLOT, "install", release("1.1", selftest=3), "--skip-selftest")
    put_on_trial(app)
    ran = run(SLOT, "trial")
    assert "version 1.1 fails its self-test at boot: back to version 1.0 in slot a" in ran.stderr
    assert version_in_use(app) == "1.0"
    assert not (app / "trial").exists()


def test_one_that_never_becomes_ready_goes_back_at_its_fourth_start(app: Path, run: Run, release: Release) -> None:
    run(SLOT, "install", release("1.0"))
    run(SLOT, "install", release("1.1"))
    put_on_trial(app)
    for _ in range(3):
        run(SLOT, "starting")
        assert version_in_use(app) == "1.1"
    assert "was started 3 times and never became ready: back to version 1.0" in run(SLOT, "starting").stderr
    assert version_in_use(app) == "1.0"
    assert "slot b: nothing" in run(SLOT, "status").stdout


def test_a_confirmed_one_stays_however_often_it_starts(app: Path, run: Run, release: Release) -> None:
    run(SLOT, "install", release("1.0"))
    run(SLOT, "install", release("1.1"))
    for _ in range(9):
        run(SLOT, "starting")
    assert version_in_use(app) == "1.1"


@pytest.mark.parametrize("command", [("trial",), ("starting",), ("confirm", "retroscan.service")])
def test_a_power_cut_before_the_swap_costs_the_proven_version_nothing(
    app: Path, run: Run, release: Release, command: tuple[str, ...]
) -> None:
    """The trial's file stands, the link does not lead to the update yet; the self-test fails for want of a part."""
    run(SLOT, "install", release("1.0", selftest=3))
    run(SLOT, "install", release("1.1"), "--skip-selftest")
    run(SLOT, "rollback")
    (app / "trial").write_text("a 9\n")
    ran = run(SLOT, *command)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert version_in_use(app) == "1.0"
    assert "not confirmed" not in run(SLOT, "status").stdout
    assert not (app / "trial").exists()


def test_by_hand_to_the_other_one_though_an_update_never_swapped(app: Path, run: Run, release: Release) -> None:
    run(SLOT, "install", release("1.0"))
    run(SLOT, "install", release("1.1"))
    (app / "trial").write_text("b 0\n")
    assert run(SLOT, "rollback").returncode == 0
    assert version_in_use(app) == "1.0"


def test_an_update_waits_until_the_last_one_is_confirmed(app: Path, run: Run, release: Release) -> None:
    """It would be filled into the slot of the one version that is proven."""
    run(SLOT, "install", release("1.0"))
    run(SLOT, "install", release("1.1"))
    put_on_trial(app)
    ran = run(SLOT, "install", release("1.2"))
    assert (ran.returncode, ran.stderr.count("\n")) == (1, 1)
    assert "version 1.1 is not confirmed yet: start the instrument" in ran.stderr
    assert "slot a: 1.0" in run(SLOT, "status").stdout
    assert run(SLOT, "rollback").returncode == 0
    assert run(SLOT, "install", release("1.2")).returncode == 0
    assert "slot a: 1.0\n" in run(SLOT, "status").stdout
    assert version_in_use(app) == "1.2"


def test_an_update_that_never_swapped_is_filled_again(app: Path, run: Run, release: Release) -> None:
    run(SLOT, "install", release("1.0"))
    run(SLOT, "install", release("1.1"))
    run(SLOT, "rollback")
    (app / "trial").write_text("a 0\n")
    assert run(SLOT, "install", release("1.2")).returncode == 0
    assert (version_in_use(app), (app / "trial").exists()) == ("1.2", False)


def test_a_power_cut_while_going_back_is_gone_on_with(app: Path, run: Run, release: Release) -> None:
    """The mark of the failed version is removed, the link still leads to it."""
    run(SLOT, "install", release("1.0"))
    run(SLOT, "install", release("1.1"))
    put_on_trial(app)
    (app / "b/ready").unlink()
    assert "back to version 1.0 in slot a" in run(SLOT, "trial").stderr
    assert version_in_use(app) == "1.0"


@pytest.mark.parametrize("arguments", [[], ["install"], ["install", ".", "--force"], ["confirm"], ["frob"]])
def test_usage(app: Path, run: Run, arguments: list[str]) -> None:
    ran = run(SLOT, *arguments)
    assert (ran.returncode, ran.stderr.startswith("usage: retrograph-slot")) == (2, True)


@pytest.mark.parametrize("function", [SELF_TEST, INSTRUMENT])
def test_the_virtual_boards_broken_releases_break_a_function_that_there_is(function: str) -> None:
    text = (ROOT / ENTRY).read_text(encoding="utf-8")
    broken = spoiled(text, function, "    return 3\n")
    (found,) = (one for one in ast.parse(broken).body if isinstance(one, ast.FunctionDef) and one.name == function)
    assert isinstance(found.body[0], ast.Return)
    assert broken.count("\n") == text.count("\n") + 1

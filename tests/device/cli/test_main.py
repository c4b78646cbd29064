"""`retroscan` from its command line: what it says, and with which code it ends."""

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from limits import running

import device.cli.guide
import device.cli.instrument_commands
from device.bundles.calibration import CalibrationBundle
from device.cli.guide import demo_folder_name
from device.cli.main import OLD_COMMANDS, app, chosen_board, main
from device.instrument.demo_faults import DemoFaults
from device.instrument.instrument import Instrument
from device.pairing import HostCard, leave_host_card, read_device_card
from device.store.store import BundleStore
from hal.board_profile import load_board_profile
from hal.clock import VirtualClock
from hal.errors import BoardProfileError
from hal.hardware import Hardware


def refusal(capsys: pytest.CaptureFixture[str], arguments: list[str], code: int) -> str:
    assert main(arguments) == code
    error = capsys.readouterr().err
    assert error.startswith("retroscan: ")
    assert error.count("\n") == 1
    return error


def test_scanning_before_calibrating_says_what_to_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = str(tmp_path / "store")
    assert "retroscan calibrate" in refusal(capsys, ["--board", "twin", "--store", store, "scan"], 2)
    assert list(tmp_path.iterdir()) == []


def test_an_object_that_the_twin_lacks_is_refused_before_anybody_is_asked_to_press(
    calibrated_root: Path, tmp_path: Path, small_board: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(calibrated_root, tmp_path / "store")
    arguments = ["--board", str(small_board), "--store", str(tmp_path / "store"), "scan", "--object", "nosuch"]
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert "the twin has no object 'nosuch'" in said.err
    assert said.out == ""


def test_a_damaged_active_calibration_is_repaired_as_its_message_says(
    calibrated_root: Path, tmp_path: Path, small_board: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = tmp_path / "store"
    shutil.copytree(calibrated_root, store)
    (store / "active.json").write_text("{")
    retroscan = ["--board", str(small_board), "--store", str(store)]
    assert "`retroscan calibrations use ID`" in refusal(capsys, [*retroscan, "scan"], 2)
    (store / "active.json").unlink()
    (store / "active.json").mkdir()
    assert "remove it, then" in refusal(capsys, [*retroscan, "scan"], 2)
    (store / "active.json").rmdir()
    (calibration,) = (store / "calibrations").iterdir()
    assert main([*retroscan, "calibrations", "use", calibration.name]) == 0
    assert main([*retroscan, "scan", "--object", "coin"]) == 0


def test_an_empty_name_is_no_store(capsys: pytest.CaptureFixture[str]) -> None:
    assert "an empty name is not a folder" in refusal(capsys, ["--board", "twin", "--store", "", "calibrate"], 2)


def test_an_unknown_board_lists_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    error = refusal(capsys, ["--board", "moon", "lights-off"], 2)
    assert "twin" in error
    assert "twin-distant" in error


def test_the_twin_is_never_taken_unasked(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RETROSCAN_BOARD", raising=False)
    assert "give --board NAME" in refusal(capsys, ["scan"], 2)


@pytest.mark.parametrize("port", ["0", "65536", "-1", "ssh"])
def test_a_port_is_one_of_those_there_are(port: str, capsys: pytest.CaptureFixture[str]) -> None:
    error = refusal(capsys, ["--board", "twin", "pair", "--port", port], 2)
    assert "is not a port: give a number from 1 to 65535" in error


@pytest.mark.parametrize("radius", ["0", "-3", "nan", "ball"])
def test_a_ball_needs_a_radius(radius: str, capsys: pytest.CaptureFixture[str]) -> None:
    error = refusal(capsys, ["--board", "twin", "calibrate", "--ball-radius-mm", radius], 2)
    assert "is not a length between 0 and 1000 mm" in error


def test_a_command_that_does_not_exist_names_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert "did you mean 'selftest'?" in refusal(capsys, ["--board", "twin", "selftset"], 2)
    assert "`retroscan --help` lists them" in refusal(capsys, ["sacn"], 2)


@pytest.mark.parametrize(("old", "new"), [(old, " ".join(new.words)) for old, new in OLD_COMMANDS.items()])
def test_an_old_command_still_works_and_names_the_new_one(
    old: str, new: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # "run" would wait for the button: a missing board ends it.
    board = "moon" if old == "watch" else "twin"
    code = main(["--board", board, "--store", str(tmp_path / "store"), old])
    warning = capsys.readouterr().err.splitlines()[0]
    assert code == (2 if old == "watch" else 0)
    assert warning == f"retroscan: `{old}` is now `{new}`; the old name will be removed in the next release"
    assert main(["--help"]) == 0
    assert f"│ {old} " not in capsys.readouterr().out


@pytest.mark.parametrize("option", ["--auto-exposure", "--balance"])
def test_auto_exposure_keeps_its_old_name_unlisted(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    _, given, _ = app.parse_args(["calibrate", option], exit_on_error=False, print_error=False)
    assert given.kwargs == {option.removeprefix("--").replace("-", "_"): True}
    assert main(["calibrate", "--help"]) == 0
    assert "--balance" not in capsys.readouterr().out


def test_a_store_that_cannot_be_made_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("in the way")
    store = str(tmp_path / "file" / "store")
    assert store in refusal(capsys, ["--board", "twin", "--store", store, "calibrate"], 2)


def test_lights_off_is_quiet(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--board", "twin", "lights-off"]) == 0
    assert capsys.readouterr().out == ""


def test_a_memory_card_authorizes_workstations(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    card, key = tmp_path / "card", "ssh-ed25519 " + "A" * 68
    card.mkdir()
    (tmp_path / "host_key.pub").write_text(f"{key} root@device\n")
    leave_host_card(card, HostCard(name="bench", public_key=key))
    store = ["--board", "twin", "--store", str(tmp_path / "store")]
    arguments = ["pair", "--card", str(card), "--host-key", str(tmp_path / "host_key.pub")]
    for _ in range(2):
        assert main([*store, *arguments]) == 0
    assert (tmp_path / "store-pairing" / "authorized_keys").read_text() == f"restrict {key} bench\n"
    device = read_device_card(card)
    assert device is not None
    assert (device.host_key, device.user, device.port) == (key, "retrosync", 22)
    assert "install openssh-server" in refusal(capsys, [*store, "pair", "--host-key", str(tmp_path / "none")], 2)


def test_pushed_calibrations_are_imported_and_activated(
    tmp_path: Path, publish_calibration: Callable[[BundleStore], CalibrationBundle], capsys: pytest.CaptureFixture[str]
) -> None:
    bundle = publish_calibration(BundleStore(tmp_path / "other", VirtualClock()))
    arguments = ["--board", "twin", "--store", str(tmp_path / "store"), "calibrations", "import-inbox"]
    assert main(arguments) == 0
    shutil.copytree(bundle.directory, tmp_path / "store" / "inbox" / bundle.calibration_id)
    (tmp_path / "store" / "inbox" / "empty").mkdir()
    assert main([*arguments, "--activate"]) == 2
    said = capsys.readouterr().out
    assert f"Calibration {bundle.calibration_id} is active." in said
    assert "empty: " in said


def test_the_selftest_walks_the_twin(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--board", "twin", "selftest", "--push"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0].split()[0] for line in lines] == ["ok"] * 10
    assert lines[0].startswith("ok       power: ")


def test_the_selftest_of_a_board_that_is_not_there_blames_its_parts(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--board", "zero2w-imx708", "selftest"]) == 3
    printed = capsys.readouterr().out
    assert "failed   light driver: the light driver's enable on line 23" in printed
    assert "failed   camera: " in printed
    assert "skipped  light green: not tested because the light driver failed" in printed


SIGNALS = [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT]


@pytest.mark.parametrize(("number", "again"), [*((number, False) for number in SIGNALS), (signal.SIGTERM, True)])
def test_a_program_that_is_ended_while_it_is_lit_ends_dark(number: signal.Signals, again: bool, tmp_path: Path) -> None:
    arguments = ["--board", "twin", "--store", str(tmp_path / "store"), "calibrate", "--auto-exposure"]
    with running(
        [sys.executable, Path(__file__).parent / "lit_program.py", *arguments],
        cwd=Path(__file__).parents[3],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)} | ({"SLOW_BUS": "1"} if again else {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as program:
        assert program.stdout is not None
        assert program.stderr is not None
        said = []
        while said[-1:] != ["lit"]:
            line = program.stdout.readline()
            assert line, program.stderr.read()
            said.append(line.strip())
        program.send_signal(number)
        for line in program.stdout:
            said.append(line.strip())
            if again:
                program.send_signal(number)
        complaint = program.stderr.read()
    assert [word for word in said if word in {"lit", "dark"}][-1] == "dark"
    assert program.returncode == 130
    assert complaint == "retroscan: stopped\n"


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_ends_through_every_exit(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ended: list[str] = []

    class Dark:
        def __enter__(self) -> "Dark":
            return self

        def __exit__(self, *exc: object) -> None:
            ended.append("dark")

        def off(self) -> None:
            os.kill(os.getpid(), number)

    class Board:
        lights = Dark()

    monkeypatch.setattr(device.cli.instrument_commands, "open_hardware", lambda _profile: Board())
    assert main(["--board", "twin", "lights-off"]) == 130
    assert ended == ["dark"]
    assert "stopped" in capsys.readouterr().err


def test_help_comes_without_the_instrument() -> None:
    program = "import sys; from device.cli.main import main; main(['--help']); print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert {"cv2", "scipy", "tifffile", "device.store.store"}.isdisjoint(said.stdout.split())


def test_the_board_is_named_by_option_environment_or_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, defaults = tmp_path / "board", tmp_path / "retroscan"
    monkeypatch.delenv("RETROSCAN_BOARD", raising=False)
    with pytest.raises(BoardProfileError, match=r"no board is named: give --board NAME"):
        chosen_board(None, file, defaults)
    defaults.write_text("# written by install.sh\nRETROSCAN_BOARD=pi4-imx477\n", encoding="utf-8")
    assert chosen_board(None, file, defaults) == "pi4-imx477"
    file.write_text("zero2w-imx708\n", encoding="utf-8")
    assert chosen_board(None, file, defaults) == "zero2w-imx708"
    monkeypatch.setenv("RETROSCAN_BOARD", "twin")
    assert chosen_board(None, file, defaults) == "twin"
    assert chosen_board("pi5-imx296", file, defaults) == "pi5-imx296"


def test_status_list_and_selftest_answer_in_json_too(
    calibrated_root: Path, tmp_path: Path, small_board: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = tmp_path / "store"
    shutil.copytree(calibrated_root, store)
    retroscan = ["--board", str(small_board), "--store", str(store)]
    assert main([*retroscan, "scan", "--json"]) == 0
    told = capsys.readouterr()
    scanned = json.loads(told.out)
    assert "You may lift." in told.err
    assert scanned["verdict"]["level"] == "good"
    assert main([*retroscan, "list", "--json"]) == 0
    (listed,) = json.loads(capsys.readouterr().out)["scans"]
    assert listed["scan"] == scanned["scan"]
    assert listed["verdict"]["reason"] == scanned["verdict"]["reason"]
    assert main([*retroscan, "status", "--json"]) == 0
    status = json.loads(capsys.readouterr().out)
    assert (status["scans"], status["scans_sent"], status["calibration_fault"]) == (1, 0, "")
    assert status["scans_left"] > 0
    assert main([*retroscan, "gel", "another"]) == 0
    assert main([*retroscan, "status"]) == 0
    said = capsys.readouterr().out
    assert f"{status['calibration']} is of gel {status['gel']}: run" in said
    assert "is active" not in said
    assert main([*retroscan, "gel", status["gel"]]) == 0
    capsys.readouterr()
    assert main([*retroscan, "selftest", "--json"]) == 0
    findings = json.loads(capsys.readouterr().out)
    assert {finding["state"] for finding in findings} == {"ok"}
    assert main([*retroscan, "list"]) == 0
    assert scanned["scan"] in capsys.readouterr().out


def test_labels_that_no_record_takes_are_refused_before_the_press(
    calibrated_root: Path, tmp_path: Path, small_board: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = shutil.copytree(calibrated_root, tmp_path / "store")
    retroscan = ["--board", str(small_board), "--store", str(store)]
    sentence = refusal(capsys, [*retroscan, "scan", "--part", "x" * 4001], 2)
    assert "is too long; accepted is at most 4000 characters" in sentence
    assert main([*retroscan, "scan", "--part", "  ", "--job", " J 1 "]) == 0
    capsys.readouterr()
    assert main([*retroscan, "list", "--json"]) == 0
    labels = json.loads(capsys.readouterr().out)["scans"][0]["annotations"]
    assert (labels["part"], labels["job"]) == (None, "J 1")


def test_the_demonstration_takes_the_options_before_it_and_ends_with_the_screens_code(
    calibrated_root: Path,
    tmp_path: Path,
    small_board: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shown: list[tuple[Path, str]] = []

    def show(instrument: Instrument, hardware: Hardware, folder: Path, faults: DemoFaults) -> int:
        shown.append((folder, hardware.profile.name))
        return 5

    store = shutil.copytree(calibrated_root, tmp_path / "store")
    monkeypatch.setattr(device.cli.guide, "require_terminal", lambda: None)
    monkeypatch.setattr(device.cli.guide, "show_screens", show)
    assert main(["--board", str(small_board), "--store", str(store), "demo"]) == 5
    assert main(["--board", str(small_board), "--store", str(tmp_path), "demo", "--store", str(store)]) == 5
    assert shown == [(store, load_board_profile(str(small_board)).name)] * 2
    assert "is no simulated handheld" in refusal(capsys, ["--board", "pi5-imx296", "demo"], 2)
    assert demo_folder_name("twin") != demo_folder_name("twin-distant")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_the_handhelds_output_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "device", "--board", "twin", "--store", str(tmp_path / "store"), "list"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "retroscan: the output cannot be written (No space left on device): redirect it elsewhere\n"

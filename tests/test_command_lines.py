"""Both command lines: examples that parse, arguments explained, completion, one sentence for what is wrong."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib import import_module
from itertools import pairwise, product
from pathlib import Path

import pytest
from cyclopts import App, CycloptsError
from each_case import each_case
from typed_commands import PROGRAMS, parse, split

from device.cli.main import CALIBRATIONS
from device.cli.main import COMMANDS as OF_THE_HANDHELD
from device.command_line import Command
from host_sync.cli.main import COMMANDS as OF_THE_WORKSTATION

TABLES = (
    ("retroscan", OF_THE_HANDHELD),
    ("retroscan calibrations", CALIBRATIONS),
    ("retrosync", OF_THE_WORKSTATION),
)
LISTED = [(f"{program} {command.name}", command) for program, commands in TABLES for command in commands]
UNLISTED = {f"{program} {command.name}" for program, commands in TABLES for command in commands if not command.listed}
EVERY_NAME = [name for name, _ in LISTED] + ["retroscan calibrations"]
HEAVY = {"numba", "scipy", "matplotlib", "asyncssh", "zeroconf", "numpy", "cv2", "tifffile", "textual"}


def app_of(name: str) -> App:
    program, words = split(name)
    app = PROGRAMS[program][0]
    for word in words:
        app = app[word]
    return app


def test_every_command_is_in_a_table() -> None:
    shown = {
        f"{program} {name}"
        for program, (app, _) in PROGRAMS.items()
        for name in app
        if name[0] != "-" and app[name].show
    }
    assert shown <= set(EVERY_NAME)


def test_a_person_can_remember_the_commands() -> None:
    shown = [name for app, _ in PROGRAMS.values() for name in app if name[0] != "-" and app[name].show]
    assert len(shown) <= 34


@each_case(EVERY_NAME)
def test_help_ends_with_one_block_of_examples(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    program, words = split(name)
    assert PROGRAMS[program][1]([*words, "--help"]) == 0
    told = capsys.readouterr().out
    assert told.count("Examples:\n") == 1
    lines = told.rpartition("Examples:\n")[2].strip("\n").split("\n")
    assert lines
    assert all(line.startswith(("  retroscan", "  retrosync")) for line in lines)
    assert any(name in re.sub(r" --board twin", "", line) or name == "retroscan tui" for line in lines)


@each_case([line for _, command in LISTED for line in command.examples], CycloptsError)
def test_every_example_parses(line: str) -> None:
    parse(line)


def test_a_wrong_example_does_not_parse() -> None:
    for wrong in (
        "retroscan scan --nope",
        "retrosync measure -k 3",
        "retrosync nope",
        "retroscan focus --frames 0",
        "retroscan list --no-json",
        "retrosync list --no-json",
    ):
        with pytest.raises(CycloptsError):
            parse(wrong)


@each_case(EVERY_NAME)
def test_every_argument_is_explained(name: str) -> None:
    arguments = app_of(name).assemble_argument_collection(parse_docstring=True)
    assert not [argument.name for argument in arguments if argument.show and not argument.parameter.help]


@each_case([command for _, command in LISTED], name=lambda command: command.function)
def test_the_table_says_what_the_docstring_says(command: Command) -> None:
    module, _, function = command.function.partition(":")
    docstring = getattr(import_module(module), function).__doc__
    assert command.summary == " ".join(docstring.split("\n\n")[0].split())


@pytest.mark.parametrize("module", ["device.cli.main", "host_sync.cli.main"])
@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_and_version_load_nothing_heavy(module: str, option: str) -> None:
    program = f"import sys; from {module} import main; main([{option!r}]); print(*sys.modules)"
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert HEAVY.isdisjoint(told.splitlines()[-1].split())


@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_installed_for_every_command(
    program: str, shell: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    place = tmp_path / "completion"
    assert PROGRAMS[program][1](["--install-completion", "--shell", shell, "--output", str(place)]) == 0
    text = place.read_text(encoding="utf-8")
    listed = [name for name in EVERY_NAME if name not in UNLISTED]
    names = [name.partition(" ")[2] for name in listed if name.startswith(program) and name.count(" ") == 1]
    assert not [name for name in names if name not in text]
    assert "balance" not in text


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_wrong_argument_is_one_sentence(program: str, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["list", "--nope"], ["nope"], ["list", "surplus"]):
        assert PROGRAMS[program][1](words) == 2
        told = capsys.readouterr()
        assert told.err.startswith(f"{program}: ")
        assert told.err.count("\n") == 1
        assert told.out == ""


READS_A_FILE = {
    "a board profile": "retroscan --board FILE.toml status",
    "a frame set": "retrosync reconstruct FILE.toml --out results",
    "a frame set to calibrate": "retrosync calibrate FILE.toml --out gel.calibration",
    "a frame set for figures": "retrosync paper-figures FILE.toml --out pictures",
    "a recipe": "retrosync measure results/coin --recipe FILE.toml",
    "a recipe of the watch": "retrosync reconstruct --watch --library . --recipe FILE.toml",
    "a report's template": "retrosync report results/coin --template FILE.toml --out report",
    "a table": "retrosync gage-rr --table FILE.toml",
}


NO_TEXT = (b"\x89PNG\r\n\x1a\n\0\0", 'name = "x"'.encode("utf-16"))


@each_case(list(product(READS_A_FILE, NO_TEXT)))
def test_a_file_that_is_not_text_is_one_sentence(
    case: tuple[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name, data = case
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("host_sync.cli.console.LINES_EVERY_S", 1e6)  # no step is written, however long it takes
    (tmp_path / "FILE.toml").write_bytes(data)
    program, words = split(READS_A_FILE[name])
    assert PROGRAMS[program][1](words) == 2
    told = capsys.readouterr()
    if "--table" in words and b"PNG" not in data:  # spreadsheets write tables in UTF-16, too
        assert told.err == (
            "retrosync: FILE.toml: has no column part, operator, value: correct its line of names, with commas, "
            "semicolons or tabs between them\n"
        )
        return
    assert re.fullmatch(rf"{program}: FILE\.toml: is not [^\n]*text[^\n]*\n", told.err)
    assert "codec" not in told.err
    assert [path.name for path in tmp_path.iterdir()] == ["FILE.toml"]


def rows_of_panels(page: str) -> list[str]:
    """The rows inside the frames of a help page."""
    return [line[2:-2] for line in page.split("\n") if line.startswith("│ ")]


@each_case(list(product([*EVERY_NAME, "retroscan", "retrosync"], (80, 120))))
def test_texts_of_help_fill_their_lines(
    case: tuple[str, int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name, columns = case
    monkeypatch.setenv("COLUMNS", str(columns))
    program, words = split(name)
    assert PROGRAMS[program][1]([*words, "--help"]) == 0
    page = capsys.readouterr().out
    assert max(map(len, page.split("\n"))) <= columns or "Examples" in page
    rows = rows_of_panels(page)
    assert rows
    for row, following in pairwise(rows):
        indent = len(following) - len(following.lstrip())
        if indent >= 8 and row.strip() and not following[:indent].strip():
            first_word = following.split()[0]
            assert len(row.rstrip()) + 1 + len(first_word) > len(row), f"{row!r} has room for {first_word!r}"


@each_case(EVERY_NAME)
def test_usage_names_every_argument(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    program, words = split(name)
    assert PROGRAMS[program][1]([*words, "--help"]) == 0
    usage = capsys.readouterr().out.split("\n")[0]
    assert usage.startswith("Usage: ")
    assert "ARGS" not in usage
    for argument in app_of(name).assemble_argument_collection():
        if argument.show and argument.field_info.kind != argument.field_info.KEYWORD_ONLY:
            assert argument.name.lstrip("-").upper() in usage


@each_case(EVERY_NAME)
def test_only_a_flag_that_is_on_has_an_option_to_switch_it_off(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    program, words = split(name)
    assert PROGRAMS[program][1]([*words, "--help"]) == 0
    shown = set(re.findall(r"--no-[a-z0-9-]+", capsys.readouterr().out.partition("Examples:")[0]))
    on = {one.name for one in app_of(name).assemble_argument_collection() if one.field_info.default is True}
    assert shown == {f"--no-{option.removeprefix('--')}" for option in on}


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        (
            "retrosync push-calibration",
            "retrosync: SOURCE is missing: `retrosync push-calibration --help` explains it\n",
        ),
        ("retrosync compare one", "retrosync: SECOND is missing: `retrosync compare --help` explains it\n"),
        (
            "retroscan calibrations use",
            "retroscan: CALIBRATION_ID is missing: `retroscan calibrations use --help` explains it\n",
        ),
    ],
)
def test_a_missing_argument_is_named(line: str, sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    program, words = split(line)
    assert PROGRAMS[program][1](words) == 2
    assert capsys.readouterr().err == sentence


def test_both_programs_print_json_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scans").mkdir()
    for line in (
        f"retroscan --board twin --store {tmp_path} list --json",
        f"retrosync list --library {tmp_path} --json",
    ):
        program, words = split(line)
        assert PROGRAMS[program][1](words) == 0
        told = capsys.readouterr().out
        assert isinstance(json.loads(told), dict)
        assert told.count("\n") == 1
        assert ": " not in told

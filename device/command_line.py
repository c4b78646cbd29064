"""Common part of both command lines: commands with examples, help, completion, JSON, sentences on wrong arguments.

A command is named by "module:function" and imported when it is called or its help is shown.
"""

from __future__ import annotations

import codecs
import json
import ntpath
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from importlib.metadata import version
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

from cyclopts import App, CycloptsError, MissingArgumentError, Parameter, UnknownCommandError

if TYPE_CHECKING:
    from cyclopts.help import HelpPanel

BAD_ARGUMENTS: Final = 2
LONGEST_PLAIN: Final = 150
"""A longer path of Windows is marked as such: with what is written below it, it may exceed 260 characters."""


class Command(NamedTuple):
    """A command of a program.

    function : "module:function"
    summary : the first sentence of the function's docstring
    examples : whole lines as a person types them
    listed : False for a command that `--help` of the program does not list
    """

    name: str
    function: str
    summary: str
    examples: tuple[str, ...]
    listed: bool = True


class NewWords(NamedTuple):
    """Words of this release for a command of the previous one.

    words : what replaces the command's name
    options : new names of its options
    form : the new form, for a command whose arguments have another order: it is named and not run
    """

    words: tuple[str, ...]
    options: Mapping[str, str] = {}
    form: str | None = None


def in_new_words(words: Sequence[str], old: Mapping[str, NewWords]) -> tuple[list[str], str | None]:
    """Return the words of this release, and the sentence that names them; None for a command that is not old.

    Raises
    ------
    OldCommand
        Its arguments have another order now.
    """
    new = old.get(words[0]) if words else None
    if new is None:
        return list(words), None
    name = " ".join(new.words)
    if new.form is not None:
        raise OldCommand(msg=f"`{words[0]}` is now `{new.form}`")
    rest = [new.options.get(word, word) for word in words[1:]]
    return [*new.words, *rest], f"`{words[0]}` is now `{name}`; the old name will be removed in the next release"


class OldCommand(CycloptsError):
    """A command of the previous release whose arguments have another order now: type the new form."""


def make_app(name: str, purpose: str, exit_codes: str) -> App:
    """Return a program without commands, which knows `--version` and `--install-completion`.

    A flag that is on by default names the option that switches it off; others have none.
    """
    app = App(
        name=name,
        version=lambda: f"retrograph {version('retrograph')}",
        help=purpose,
        help_epilogue=exit_codes,
        help_format="plaintext",
        default_parameter=Parameter(negative=(), show_default=_shown_default),
        suppress_keyboard_interrupt=False,
    )
    app.help_formatter = HelpFormatter(app)
    words = "Install completion for bash, zsh or fish; takes effect in a new shell."
    app.register_install_completion_command(help=words)
    return app


def add_commands(app: App, commands: Iterable[Command]) -> None:
    """Add a table of commands; help ends with their examples."""
    for command in commands:
        app.command(
            command.function,
            name=command.name,
            help=command.summary,
            help_epilogue=examples_text(command.examples),
            show=command.listed,
        )


def _shown_default(value: object) -> str | None:
    """Return the default as help shows it; None for those that go without saying: nothing, off, and an empty list."""
    if value is None or value is False or value == ():
        return None
    return "on" if value is True else str(value)


class HelpFormatter:
    """Help pages of cyclopts whose texts fill the line, and whose usage names the arguments.

    A docstring's line ends are not the terminal's, so they become spaces; `[ARGS...]` becomes such as `[SCANS...]`.
    Console, its options and texts are those of rich, which cyclopts hands over.
    """

    def __init__(self, app: App) -> None:
        self._app = app

    def __call__(self, console: Any, options: Any, panel: HelpPanel) -> None:
        """Print a panel of commands, arguments or options."""
        from cyclopts.help.formatters import DefaultFormatter  # here and below: only help needs it

        for entry in panel.entries:
            text = getattr(entry.description, "primary_renderable", None)
            if text is not None:
                entry.description.primary_renderable = type(text)(" ".join(text.plain.split()))
        DefaultFormatter()(console, options, panel)

    def render_usage(self, console: Any, options: Any, usage: Any) -> None:
        """Print the usage, a text of rich or a string."""
        from cyclopts.help.formatters import DefaultFormatter

        words = str(usage).split()
        if words[-1] in ("[ARGS]", "[ARGS...]"):
            words[-1:] = self._optional_arguments(words[1:])
            usage = type(usage)(" ".join(words) + "\n")
        DefaultFormatter().render_usage(console, options, usage)

    def _optional_arguments(self, words: Sequence[str]) -> list[str]:
        """Optional arguments of the command that the words begin with."""
        app = self._app
        for word in words:
            if word.startswith(("-", "[")) or word not in app:
                break
            app = app[word]
        found = []
        for argument in app.assemble_argument_collection():
            kind = argument.field_info.kind
            if argument.show and not argument.required and kind != kind.KEYWORD_ONLY:
                found.append(f"[{argument.name.lstrip('-').upper()}{'...' if kind == kind.VAR_POSITIONAL else ''}]")
        return found


_PLAIN: Final = {
    "±": "+/-",
    "µ": "u",
    "μ": "u",
    "°": " deg",
    "²": "2",
    "³": "3",
    "×": "x",
    "–": "-",
    "…": "...",
    "σ": "s",
}


def write_any_sign() -> None:
    """Let standard output and error take every sign, and each line at once, in a pipe too.

    An encoding that lacks a sign writes it in plain letters. Without a language set, and in older terminals and
    services, that encoding is ASCII.
    """

    def plain(error: UnicodeError) -> tuple[str, int]:
        assert isinstance(error, UnicodeEncodeError)  # noqa: S101 - registered for encoding alone
        lost = error.object[error.start : error.end]
        return "".join(_PLAIN.get(one) or ascii(one)[1:-1] for one in lost), error.end

    codecs.register_error("plain", plain)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="plain", line_buffering=True)


def refused_by_system(error: OSError) -> str:
    """Return a sentence for what the system refused and no part put into words: a file by its name, else the output.

    An output that is refused goes nowhere from now on: the interpreter's last flush must not fail either.
    """
    if error.filename is None:
        discard_output()
        return f"the output cannot be written ({error.strerror or error}): redirect it elsewhere"
    mend = "let this user read and write it, or name another place"
    return f"{os.fsdecode(error.filename)}: cannot be used ({error.strerror}): {mend}"


def discard_output() -> None:
    """Send what is still to be printed nowhere: the reader of the output has gone, or its disk is full."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_json(document: object) -> None:
    """Print a document to standard output as one line of JSON; paths and times become texts.

    Signs beyond ASCII are escaped: every encoding holds them so.
    """
    import msgspec

    text = msgspec.json.encode(document, enc_hook=str).decode()
    sys.stdout.write((text if text.isascii() else json.dumps(json.loads(text), separators=(",", ":"))) + "\n")
    sys.stdout.flush()


def examples_text(examples: Sequence[str]) -> str:
    """Return the block of examples at the end of a command's help."""
    return "\n".join(["Examples:", *(f"  {line}" for line in examples)]) if examples else ""


def sentence(error: CycloptsError, app: App) -> str:
    """Return what is wrong with the arguments, as one line."""
    if isinstance(error, UnknownCommandError) and error.unused_tokens:
        return unknown_command(error.unused_tokens[0], app)  # its own words would import every command
    if isinstance(error, MissingArgumentError) and error.argument is not None and error.argument.index is not None:
        command = " ".join((app.name[0], *(error.command_chain or ())))
        return f"{error.argument.name.lstrip('-').upper()} is missing: `{command} --help` explains it"
    return " ".join(str(error).split())


def unknown_command(word: str, app: App) -> str:
    """Return the sentence on a command that does not exist."""
    (near,) = get_close_matches(word, [name for name in app if not name.startswith("-")], 1) or ("",)
    meant = f"did you mean {near!r}? " if near else ""
    return f"there is no command {word!r}: {meant}`{app.name[0]} --help` lists them"


def _folder(_: Any, tokens: Sequence[Any]) -> Path:
    text = tokens[0].value
    if not text:
        raise ValueError("an empty name is not a folder")
    return Path(long_path(text)) if os.name == "nt" else Path(text)


def long_path(text: str) -> str:
    """Return a path of Windows as its functions take it, marked where it is long."""
    path = ntpath.abspath(text)
    if len(path) < LONGEST_PLAIN or path.startswith("\\\\?\\"):
        return text
    return f"\\\\?\\UNC\\{path[2:]}" if path.startswith("\\\\") else f"\\\\?\\{path}"


Folder = Annotated[Path, Parameter(converter=_folder)]
"""A named folder; an empty name is refused, because it would mean the current folder."""

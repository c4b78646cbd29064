"""What both command lines share: a table of commands with examples, completion, what is wrong with arguments.

A command is named by "module:function" and imported when it is called or its help is shown.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

from cyclopts import App, CycloptsError, Parameter, UnknownCommandError

BAD_ARGUMENTS: Final = 2


class Command(NamedTuple):
    """A command of a program.

    function : "module:function"
    summary : the first sentence of the function's docstring; empty for a name that is not listed
    examples : whole lines as a person types them
    """

    name: str
    function: str
    summary: str = ""
    examples: tuple[str, ...] = ()


def make_app(name: str, purpose: str, exit_codes: str) -> App:
    """A program without commands, which knows `--version` and `--install-completion`."""
    app = App(
        name=name,
        version=lambda: f"retrograph {version('retrograph')}",
        help=purpose,
        help_epilogue=exit_codes,
        help_format="plaintext",
        default_parameter=Parameter(negative_iterable=()),
        suppress_keyboard_interrupt=False,
    )
    words = "Install completion for bash, zsh or fish; takes effect in a new shell."
    app.register_install_completion_command(help=words)
    return app


def add_commands(app: App, commands: Iterable[Command]) -> None:
    """Add a table of commands; help ends with their examples."""
    for command in commands:
        app.command(
            command.function,
            name=command.name,
            help=command.summary or None,
            help_epilogue=examples_text(command.examples) or None,
            show=bool(command.summary),
        )


def examples_text(examples: Sequence[str]) -> str:
    """The block of examples at the end of a command's help."""
    return "\n".join(["Examples:", *(f"  {line}" for line in examples)]) if examples else ""


def sentence(error: CycloptsError, app: App) -> str:
    """What is wrong with the arguments, as one line."""
    if isinstance(error, UnknownCommandError) and error.unused_tokens:
        return unknown_command(error.unused_tokens[0], app)  # its own words would import every command
    return " ".join(str(error).split())


def unknown_command(word: str, app: App) -> str:
    """The sentence on a command that does not exist."""
    (near,) = get_close_matches(word, [name for name in app if not name.startswith("-")], 1) or ("",)
    meant = f"did you mean {near!r}? " if near else ""
    return f"there is no command {word!r}: {meant}`{app.name[0]} --help` lists them"


def _folder(_: Any, tokens: Sequence[Any]) -> Path:
    text = tokens[0].value
    if not text:
        raise ValueError("an empty name is not a folder")
    return Path(text)


Folder = Annotated[Path, Parameter(converter=_folder)]
"""A named folder; an empty name is refused, because it would mean the current folder."""

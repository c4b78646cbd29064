"""`retrosync alike`: the surfaces of a library that look most like one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from device.command_line import Folder, print_json
from host_sync.cli.console import DONE, PARTLY, print_error, print_line, status_spinner
from host_sync.library.library import Library, default_library
from host_sync.results.files import RECORD_FILE
from host_sync.text import some_of


def alike_command(
    scan: str,
    /,
    *,
    library: Folder | None = None,
    count: Annotated[int, Parameter(name=("--count", "-n"), validator=Number(gte=1))] = 5,
    json: bool = False,
) -> int:
    """Find the surfaces of a library that look most like one; shifted and turned presses of it too.

    Exit code 1 says that scans could not be compared, as they have no results or those cannot be read.

    Parameters
    ----------
    scan
        Scan of the library by id, label's name or part; or a folder that reconstruct wrote.
    library
        Folder of the library; ~/Retrograph by default.
    count
        Number of surfaces to list.
    json
        Print them, and what could not be compared, as JSON.
    """
    held = Library(library or default_library())
    held.require()
    folder = Path(scan)
    if not (folder / RECORD_FILE).is_file():
        folder = held.newest_result(held.named(scan))
    with status_spinner() as tell:
        from host_sync.likeness.search import alike

        answer = alike(folder, held.root, count, tell)
    failed = [f"not compared: {name}: {reason}" for name, reason in answer.unreadable]
    if answer.without_results:
        names = some_of(answer.without_results)
        failed.append(f"not compared, without results: {names}: run retrosync reconstruct --library {held.root}")
    for words in failed:
        print_error(words, PARTLY)
    if json:
        print_json(answer)
        return PARTLY if failed else DONE
    for one in answer.found:
        print_line(f"{one.distance:7.2f}  {one.scan}  {one.folder}")
    print_line(f"{answer.compared} surfaces compared; the less the number in front, the more alike")
    for name, reason in answer.left_out:
        print_line(f"not compared: {name}: {reason}")
    return PARTLY if failed else DONE

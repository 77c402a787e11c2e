"""`drivegate replay incidents`: what was kept of faults, emergency stops and a person's marks."""

from pathlib import Path
from typing import Annotated

import typer

from gateway.cli.output import complain, console, print_json
from replay.compare.verify import EXIT_NOT_REPLAYABLE
from replay.sessions.incidents import Listed, listed


def incidents(
    paths: Annotated[list[Path], typer.Argument(metavar="PATH...", help="Directory of sessions, or .rrd files.")],
    json: Annotated[bool, typer.Option("--json", help="Machine-readable list.")] = False,
) -> None:
    """List the incidents in a directory of sessions: when, which robot, why, and the verdict of then.

    `drivegate replay info FILE` tells more of one, `verify FILE` runs it again. Exit 0; 2: there are none, or one of
    the files cannot be read.

    --json: `incidents`, a list of file, robot, began (UTC), code, text, causes (how many), verdict, problem (why
    nothing is known).
    """
    found = list(listed(paths))
    if json:
        print_json({"incidents": [one.as_json() for one in found]})
    else:
        _show(found)
    for one in found:
        if one.problem is not None:
            complain(one.problem)
    if not found:
        complain(f"{', '.join(map(str, paths))}: no incidents")
    if not found or any(one.problem is not None for one in found):
        raise typer.Exit(EXIT_NOT_REPLAYABLE)


def _show(found: list[Listed]) -> None:
    for one in found:
        if one.problem is None:
            more = f" (and {one.causes - 1} more)" if one.causes > 1 else ""
            line = f"{one.began}  {one.robot}  {one.verdict or 'not judged':<14}  {one.code}: {one.text}{more}"
            console.print(f"{line}\n  {one.file}", highlight=False, markup=False, soft_wrap=True)

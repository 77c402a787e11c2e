"""`drivegate replay info`, `export`, `import`: what a session is, and the way to other tools and back."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from gateway.cli.output import complain, console, print_json
from gateway.config import ConfigError
from replay.compare.verify import EXIT_INCOMPLETE, EXIT_NOT_REPLAYABLE, verify
from replay.sessions.reader import SessionError, open_session
from replay.sessions.summary import Stay, Summary, summary

SHOWN = 20  # lines of one list

SessionPath = Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")]
Json = Annotated[bool, typer.Option("--json", help="Machine-readable report.")]


def info(
    session: SessionPath,
    run: Annotated[
        bool, typer.Option("--verify", help="Run it through the core as well, and add the verdict.")
    ] = False,
    json: Json = False,
) -> None:
    """Tell what a session is: robot, when and how long, software, modes, faults, gaps, and whether it is complete.

    Nothing is run again, but with --verify, which adds the verdict and ends with its exit code. Exit 0: complete;
    2: not a session, or one without cycles; 3: incomplete.
    """
    try:
        found = summary(open_session(session))
        verdict = verify(open_session(session)) if run else None
    except (SessionError, ConfigError, OSError) as error:
        if json:
            print_json({"problem": str(error)})
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    if json:
        print_json(found.as_json() | ({} if verdict is None else {"verdict": verdict.as_json()}))
    else:
        _show(found)
        if verdict is not None:
            from gateway.cli.replay import show  # noqa: PLC0415  # which registers the commands of this module

            show(verdict)
    raise typer.Exit(_code(found) if verdict is None else verdict.exit_code)


def _code(found: Summary) -> int:
    if not found.cycles:
        return EXIT_NOT_REPLAYABLE
    return 0 if found.complete else EXIT_INCOMPLETE


def _show(found: Summary) -> None:
    table = Table("what", "value", title=f"{found.session}")
    moved = f", moved by {found.plant}" if found.plant else ""
    table.add_row("robot", f"{found.robot} ({found.config_origin}{moved})")
    if found.imported is not None:
        table.add_row("imported from", found.imported)
    table.add_row("began", found.began or "nothing was recorded")
    if found.first_cycle is not None:
        table.add_row(
            "length", f"{found.seconds:.3f} s, {found.cycles} cycles: {found.first_cycle} to {found.last_cycle}"
        )
    table.add_row("frames", f"{found.frames_received} received, {found.frames_sent} sent")
    size = sum(segment.bytes for segment in found.segments)
    table.add_row("segments", f"{len(found.segments)}, {size} bytes, schema {found.schema}")
    table.add_row("software", ", ".join(f"{name} {version}" for name, version in found.versions.items()))
    table.add_row("commit", found.commit or "not told")
    table.add_row("host", found.host)
    for title, lines in _lists(found):
        table.add_row(title, "\n".join(_first(lines)) or "none")
    table.add_row("complete", "yes" if found.complete else "no: " + "\n".join(_first(found.problems)))
    console.print(table, highlight=False, markup=False)


def _lists(found: Summary) -> list[tuple[str, list[str]]]:
    faults = [
        f"{fault.t:.3f} s {fault.code}{f' ({fault.times} times)' if fault.times > 1 else ''}: {fault.text}"
        for fault in found.faults
    ]
    gaps = [f"cycles {gap.first_cycle} to {gap.last_cycle}: {gap.reason}" for gap in found.gaps]
    return [("modes", list(map(_stay, found.modes))), ("faults", faults), ("gaps", gaps)]


def _stay(stay: Stay) -> str:
    return f"{stay.t:.3f} s {stay.mode} for {stay.seconds:.3f} s"


def _first(lines: Sequence[str]) -> list[str]:
    more = [f"and {len(lines) - SHOWN} more"] if len(lines) > SHOWN else []
    return [*lines[:SHOWN], *more]


COMMANDS = {"info": info}

"""`drivegate replay repair`: what to do with the files of a session that was cut or damaged."""

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

from gateway.cli.output import complain, console, errors, in_words, print_json
from gateway.recording.disk import segments
from replay.compare.verify import EXIT_NOT_REPLAYABLE
from replay.sessions.reader import SessionError
from replay.sessions.repair import Repaired, RepairedSegment, repaired


def repair(
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file. It is not changed.")],
    out: Annotated[
        Path | None, typer.Option(help="New folder. Default: beside the session, its name with -repaired.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable report.")] = False,
) -> None:
    """Write every whole message of a cut or damaged session to a new folder, which every reader of Rerun files opens.

    What is lost stays lost: `replay verify` says of the copy what it says of the session, which it reads in the same
    way. Exit 0: done, or the session is complete and nothing is written. Exit 2: no session, or the folder is there.

    --json: session, out (null: nothing was written), segments (name, whole, messages kept, dropped: from byte to byte,
    problem: why nothing of it could be kept), cycles, gaps (first_cycle, last_cycle, reason), problem (as of verify).
    """
    try:
        done = _with_progress(session, out)
    except (SessionError, OSError) as error:
        if json:
            print_json({"session": str(session), "out": None, "problem": in_words(error)})
        complain(in_words(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    if json:
        print_json(done.as_json())
    else:
        _show(done)


def _with_progress(session: Path, out: Path | None) -> Repaired:
    columns = (TextColumn("repairing"), BarColumn(), DownloadColumn(), TimeRemainingColumn())
    files = segments(session) if session.is_dir() else [session]
    size = sum(file.stat().st_size for file in files if file.exists())
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task = progress.add_task("repair", total=size)
        return repaired(session, out, lambda done: progress.advance(task, done))


def _show(done: Repaired) -> None:
    if done.out is None:
        console.print(f"[green]complete[/]: {done.cycles} cycles; nothing is written", highlight=False)
        return
    console.print(f"[green]repaired[/]: {done.cycles} cycles in {done.out}", highlight=False, soft_wrap=True)
    for segment in done.segments:
        console.print(f"  {segment.name}: {_in_words(segment)}", highlight=False, soft_wrap=True)
    if done.problem is not None:
        console.print(f"  what stays lost: {done.problem}", highlight=False, soft_wrap=True)


def _in_words(segment: RepairedSegment) -> str:
    if segment.problem is not None:
        return f"left out: {segment.problem}"
    if segment.kept is None:
        return "copied, nothing is wrong with it"
    messages, dropped = segment.kept
    if not dropped:
        return f"{messages} messages kept, none dropped; it was not closed"
    places = ", ".join(f"{begin} to {end}" for begin, end in dropped)
    total = sum(end - begin for begin, end in dropped)
    return f"{messages} messages kept; dropped {total} bytes that are no whole message: {places}"

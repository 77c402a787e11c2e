"""`drivegate replay report`: a session on one page that a person can send around."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from gateway.cli.output import complain, console, errors, print_json
from gateway.cli.replay_verify import verify_with_progress
from gateway.config import ConfigError
from replay.compare.fleet import Judged
from replay.compare.verify import EXIT_INCOMPLETE, EXIT_NOT_REPLAYABLE, Verdict, not_replayable
from replay.sessions.reader import Session, SessionError, open_session
from replay.sessions.summary import Summary, summary


def register(group: typer.Typer) -> None:
    """The command of this file."""
    group.command()(report)


def report(
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The page.")] = Path("report.html"),
    json: Annotated[bool, typer.Option("--json", help="Machine-readable: what was written.")] = False,
) -> None:
    """Write one page about a session: verdict, path, modes and faults, wheel speeds, slip, latency, versions.

    The page needs nothing but itself, no network and no other file. Of a long drive it draws the least and the greatest
    value of each stretch, and says so. Exit 0: written, 2: not written, 3: written, and the recording is incomplete.

    --json: report (the file), bytes, verdict (as `drivegate replay verify` names it), complete, cycles, seconds.
    """
    try:
        opened = open_session(session)
        verdict = _verified(opened)
        told = summary(opened.again())
        judged = Judged(str(session), told.robot, verdict, 0.0, None)
        text = _page(opened, told, judged)
    except SessionError as error:
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    size = _write(out, text, opened)
    if json:
        found = {"report": str(out), "bytes": size, "verdict": judged.word, "complete": told.complete}
        print_json(found | {"cycles": told.cycles, "seconds": told.seconds})
    else:
        console.print(f"{out}: {judged.word}, {told.seconds:g} s, {size} bytes", highlight=False, markup=False)
    raise typer.Exit(0 if told.complete else EXIT_INCOMPLETE)


def _verified(session: Session) -> Verdict:
    """A robot file that is refused is a verdict as well."""
    try:
        return verify_with_progress(session)
    except ConfigError as error:
        return not_replayable(str(error))


def _page(session: Session, told: Summary, judged: Judged) -> str:
    """Raises SessionError."""
    from replay.report.gather import drive, timing  # noqa: PLC0415  # only here, to keep the other commands fast
    from replay.report.page import page  # noqa: PLC0415

    try:
        with _progress(told.cycles) as progress:
            driven = drive(session.again(), told, progress)
    except ConfigError:  # the verdict says so
        driven = None
    return page(told, judged, driven, timing(session.again()))


@contextmanager
def _progress(cycles: int) -> Iterator[Callable[[int], None]]:
    """A bar on a terminal, nothing elsewhere."""
    columns = (TextColumn("drawing"), BarColumn(), TextColumn("{task.completed:.0f} cycles"), TimeRemainingColumn())
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task = progress.add_task("draw", total=cycles)
        yield lambda more: progress.advance(task, more)


def _write(out: Path, text: str, session: Session) -> int:
    """Bytes written."""
    if out.resolve() in {segment.resolve() for segment in session.segments}:
        complain(f"--out {out}: is of the session itself")
        raise typer.Exit(EXIT_NOT_REPLAYABLE)
    data = text.encode("utf-8", errors="replace")
    try:
        out.write_bytes(data)
    except OSError as error:
        complain(f"{out}: cannot be written: {error.strerror}")
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    return len(data)

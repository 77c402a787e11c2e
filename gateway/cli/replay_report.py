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
from replay.compare.differences import differences
from replay.compare.fleet import Judged
from replay.compare.verify import EXIT_DIFFERENT, EXIT_INCOMPLETE, EXIT_NOT_REPLAYABLE, not_replayable
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
    """Write one page about a session: verdict, path, modes, commands, events, wheel speeds, slip, latency, versions.

    The page needs nothing but itself: no network, no script, no other file. Of a long drive it shows the least and the
    greatest value of each stretch, and says so. A session that is incomplete, that differs or that cannot be verified
    has a page that says it. Exit 0: written, 2: not written, 3: written, and the recording is incomplete.

    --json: report (the file), bytes, verdict (as `drivegate replay verify` names it), exit_code (its own), complete,
    cycles, seconds; problem instead of them where nothing was written.
    """
    try:
        opened = open_session(session)
        _check(out, opened)
        told = summary(opened.again())
        judged = _judged(opened, told, str(session))
        size = _write(out, _page(opened, told, judged))
    except (SessionError, OSError) as error:
        problem = f"{out}: cannot be written: {error.strerror}" if isinstance(error, OSError) else str(error)
        if json:
            print_json({"problem": problem})
        complain(problem)
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    if json:
        found = {"report": str(out), "bytes": size, "verdict": judged.word, "exit_code": judged.verdict.exit_code}
        print_json(found | {"complete": told.complete, "cycles": told.cycles, "seconds": told.seconds})
    else:
        console.print(f"{out}: {judged.word}, {told.seconds:g} s, {size} bytes", highlight=False, markup=False)
    raise typer.Exit(0 if told.complete else EXIT_INCOMPLETE)


def _check(out: Path, session: Session) -> None:
    """Before an hour is spent. Raises SessionError."""
    if out.resolve() in {segment.resolve() for segment in session.segments}:
        raise SessionError(f"--out {out}: is of the session itself")
    if out.is_dir() or not out.absolute().parent.is_dir():
        raise SessionError(f"--out {out}: cannot be written: give a file in a directory that exists")


def _judged(session: Session, told: Summary, path: str) -> Judged:
    """A robot file that is refused is a verdict as well."""
    found = None
    try:
        verdict = verify_with_progress(session)
        if verdict.exit_code == EXIT_DIFFERENT:
            found = differences(session.again())
    except ConfigError as error:
        verdict = not_replayable(str(error))
    return Judged(path, told.robot, verdict, 0.0, found)


def _page(session: Session, told: Summary, judged: Judged) -> str:
    from replay.report.gather import drive  # noqa: PLC0415  # only here, to keep the other commands fast
    from replay.report.page import page  # noqa: PLC0415
    from replay.report.timing import timing  # noqa: PLC0415

    with _progress(told.cycles) as tell:
        driven = drive(session.again(), told, tell)
    return page(told, judged, driven, timing(session.again()))


@contextmanager
def _progress(cycles: int) -> Iterator[Callable[[int], None]]:
    """A bar on a terminal, nothing elsewhere."""
    columns = (TextColumn("drawing"), BarColumn(), TextColumn("{task.completed:.0f} cycles"), TimeRemainingColumn())
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task = progress.add_task("draw", total=cycles)
        yield lambda more: progress.advance(task, more)


def _write(out: Path, text: str) -> int:
    """Bytes written. Raises OSError."""
    data = text.encode("utf-8", errors="replace")
    out.write_bytes(data)
    return len(data)

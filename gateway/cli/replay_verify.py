"""`drivegate replay verify`: would the same software do the same again? Of one session, or of folders full of them."""

import os
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from gateway.cli.output import complain, console, errors, print_json
from replay.compare.cluster import ClusterError, cluster
from replay.compare.differences import EXPLAINED, Differences, differences
from replay.compare.fleet import Judged, Tally, all_judged
from replay.compare.junit import JUnit
from replay.compare.side_by_side import processes
from replay.compare.verify import EXIT_DIFFERENT, EXIT_INCOMPLETE, EXIT_NOT_REPLAYABLE, Verdict, not_replayable
from replay.compare.verify import verify as run_verify
from replay.sessions.folders import sessions
from replay.sessions.reader import Session, SessionError, open_session
from replay.sessions.remote import Place, local, place

WORTH_PROCESSES = 4_000_000  # bytes of a session; less is compared before processes have started
COLOURS = {"identical": "green", "different": "red", "incomplete": "yellow", "not replayable": "yellow"}


def verify(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    session: Annotated[
        list[str],
        typer.Argument(
            metavar="PATH...",
            help="Session folder, .rrd file, or folder with sessions in it; also a URL such as s3://bucket/robots.",
        ),
    ],
    jobs: Annotated[
        int | None, typer.Option(min=1, max=256, help="Processes side by side. Default: one per processor.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All differences with --json, not only the first.")] = False,
    junit: Annotated[Path | None, typer.Option(help="Write the verdicts to this file as JUnit XML.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="A Dask cluster instead of processes here, e.g. tcp://10.0.0.5:8786.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable verdict.")] = False,
) -> None:
    """Run the recorded inputs through the same core: would it do the same again?

    Exit 0: identical, and the recording is provably complete. Exit 1: different, complete or not. Exit 2: it cannot be
    replayed at all (no session, no cycles, no beginning, a robot file that is refused). Exit 3: identical as far as it
    goes, but the recording is incomplete: cycles lost or cut out, a segment unclosed, missing or damaged, the end
    missing, or the beginning deleted by recording.disk_budget or min_free. Behind what is missing the comparison goes
    on from the next snapshot of the core, of which the recording has one every five seconds.

    --json: identical (true with exit 0 only), complete, cycles and frames compared, unseen (cycles that could not be),
    realtime_ratio, first_difference (cycle, motor, field, recorded, replayed, or null), problem (what is missing, or
    null), refused (why a snapshot was of no use, or null), exit_code, software_change (what computes the outputs and is
    not what it was, or null), first_unproven (the first cycle that is missing or, by the digest chain, not as it was
    recorded, or null). With --all also differences: cycles, different (how many of them), episodes (first_cycle,
    last_cycle, cause, why, groups by motor and field), or null.

    Several paths, or a folder with sessions in it: a line for each session, a summary, and the worst exit code, by
    1, 2, 3, 0. --json is then one document: sessions (each as above with path, robot, seconds and differences) and
    summary. So it is with --scheduler as well, whose workers need DriveGate and the sessions under the same paths.

    A URL with a scheme (s3://, gs://, https://, sftp://, file://, ...) is read through fsspec: whoever compares a
    session fetches it, and deletes it again before the next one, so each process has one on its disk (in TMPDIR).
    """
    places = list(map(place, session))
    found = sessions(places)
    if found == places and len(found) == 1 and scheduler is None:
        raise typer.Exit(_one(found[0], jobs, junit, every=every, json=json))
    try:
        with _pool(scheduler, min(jobs or len(os.sched_getaffinity(0)), len(found))) as pool:
            exit_code = _many(list(map(_absolute, found)) if scheduler else found, pool, junit, json=json)
    except ClusterError as error:
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    raise typer.Exit(exit_code)


def _absolute(where: Place) -> Place:
    return where.absolute() if isinstance(where, Path) else where


def _pool(scheduler: str | None, wanted: int) -> AbstractContextManager[Executor | None]:
    if scheduler is not None:
        return cluster(scheduler)
    return processes(wanted) if wanted > 1 else nullcontext()


def _one(where: Place, jobs: int | None, junit: Path | None, *, every: bool, json: bool) -> int:
    """One session, whose cycles processes share; its exit code."""
    found, robot = None, None
    try:
        with local(where) as path:
            session = open_session(path)
            robot = session.header.robot
            verdict = verify_with_progress(session, jobs)
            if verdict.exit_code == EXIT_DIFFERENT and (every or junit is not None or not json):
                found = differences(session.again())
    except (SessionError, ValueError) as error:
        verdict = not_replayable(str(error))
        complain(str(error))
        if not json:
            _write(junit, Judged(str(where), robot, verdict, 0.0, None))
            return EXIT_NOT_REPLAYABLE
    _write(junit, Judged(str(where), robot, verdict, 0.0, found))
    if json:
        more = {"differences": None if found is None else found.as_json()} if every else {}
        print_json(verdict.as_json() | more)
    else:
        show(verdict)
        if found is not None:
            _show_differences(found)
    return verdict.exit_code


def _many(places: Sequence[Place], pool: Executor | None, junit: Path | None, *, json: bool) -> int:
    """A line for each; the worst exit code."""
    tally, report, told = Tally(), JUnit(), []
    columns = (TextColumn("verifying"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task = progress.add_task("verify", total=len(places))
        for one in all_judged(places, pool):
            progress.advance(task)
            tally.add(one)
            if junit is not None:
                report.add(one)
            if json:
                told.append(one.as_json())
            else:
                console.print(_line(one), highlight=False, soft_wrap=True)
    _write_report(junit, report)
    if json:
        print_json({"sessions": told, "summary": tally.as_json()})
    else:
        console.print(escape(str(tally)), highlight=False, soft_wrap=True)
    return tally.exit_code


def _line(one: Judged) -> str:
    """Verdict, session, cycles, duration, and the first difference or what is missing."""
    colour, verdict = COLOURS[one.word], one.verdict
    covered = f"{verdict.cycles} cycles, {verdict.seconds:.1f} s"
    reason = "" if one.reason is None else f": {one.reason}"
    return f"[{colour}]{one.word:14}[/]  {escape(f'{one.path}  {covered}{reason}')}"


def _write(path: Path | None, one: Judged) -> None:
    report = JUnit()
    report.add(one)
    _write_report(path, report)


def _write_report(path: Path | None, report: JUnit) -> None:
    if path is None:
        return
    try:
        report.write(path)
    except OSError as error:
        complain(f"{path}: cannot be written: {error.strerror}")
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None


def _show_differences(found: Differences) -> None:
    """All of them, grouped, and what has caused them."""
    table = Table("motor", "field", "cycles", "first", "last", "largest", title=f"{found.different} cycles differ")
    for group in found.groups:
        largest = "" if group.largest is None else f"{group.largest:g}"
        table.add_row(
            group.motor or "", group.field, *map(str, (group.cycles, group.first_cycle, group.last_cycle)), largest
        )
    console.print(table)
    for cause, why in found.causes.items():
        console.print(f"  cause: {cause.value}: {escape(why)}", highlight=False)
    console.print(f"  {EXPLAINED}", highlight=False)


def verify_with_progress(session: Session, jobs: int | None = None) -> Verdict:
    """Verify, side by side where it is worth it, with a progress bar on a terminal."""
    columns = (TextColumn("verifying"), BarColumn(), TextColumn("{task.completed:.0f} cycles"), TimeRemainingColumn())
    watched = errors.is_terminal
    with (
        _side_by_side(session, jobs) as pool,
        Progress(*columns, console=errors, disable=not watched, transient=True) as progress,
    ):
        task = progress.add_task("verify", total=session.cycle_count if watched else None)
        return run_verify(session, lambda done: progress.advance(task, done), pool=pool)


def _side_by_side(session: Session, jobs: int | None) -> AbstractContextManager[Executor | None]:
    """As many processes as wanted; by default as there are processors, and none for a short session."""
    size = sum(segment.stat().st_size for segment in session.segments if segment.exists())
    wanted = jobs or (len(os.sched_getaffinity(0)) if size >= WORTH_PROCESSES else 1)
    return processes(wanted) if wanted > 1 else nullcontext()


def show(verdict: Verdict) -> None:
    """The verdict in words."""
    covered = f"{verdict.cycles} cycles, {verdict.frames} frames sent, {verdict.realtime_ratio:.0f} x real time"
    difference = verdict.first_difference
    if difference is not None:
        subject = f" of motor {difference.motor}" if difference.motor else ""
        console.print(f"[red]different[/] in cycle {difference.cycle}: {difference.field}{subject}")
        console.print(f"  recorded {difference.recorded}\n  replayed {difference.replayed}", highlight=False)
        if verdict.software_change is not None:
            console.print(f"  the software is another one: {verdict.software_change}", highlight=False)
    elif verdict.identical:
        console.print(f"[green]identical[/]: {covered}")
    elif verdict.exit_code == EXIT_INCOMPLETE:
        compared = f"identical as far as it goes ({covered})" if verdict.cycles else "nothing could be compared"
        console.print(f"[yellow]incomplete[/]: {compared}", highlight=False)
    else:
        console.print("[yellow]not replayable[/]: nothing could be compared")
    if verdict.problem is not None:
        console.print(f"  the recording: {verdict.problem}", highlight=False)
    if verdict.first_unproven is not None:
        console.print(f"  proven are the cycles in front of {verdict.first_unproven}", highlight=False)
    if verdict.unseen:
        console.print(f"  not compared: {verdict.unseen} cycles that no snapshot leads to", highlight=False)
    if verdict.refused is not None:
        console.print(f"  a snapshot was of no use: {verdict.refused}", highlight=False)

"""`drivegate replay`: what to do with a recorded session."""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from math import inf
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from gateway.cli import replay_inject, replay_io
from gateway.cli.output import complain, console, errors, print_json
from gateway.cli.replay_files import repair
from gateway.config import ConfigError
from gateway.edges.can_adapter import AdapterError, opened
from gateway.edges.claims import Claims
from gateway.edges.zenoh_session import LinkError
from replay.compare.likeness import Comparison
from replay.compare.retrace import columns, frames, rows
from replay.compare.side_by_side import processes
from replay.compare.verify import EXIT_INCOMPLETE, EXIT_NOT_REPLAYABLE, Verdict, not_replayable
from replay.compare.verify import verify as run_verify
from replay.drive.player import Direction, Due, Played, is_alive, recorded, recorded_buses
from replay.drive.player import play as play_frames
from replay.drive.redrive import RedriveError, redrive
from replay.sessions.reader import Session, SessionError, open_session

VIRTUAL_CHANNELS = ("vcan", "vxcan")
WORTH_PROCESSES = 4_000_000  # bytes of a session; less is compared before processes have started

replay = typer.Typer(help="Re-run recorded sessions.", no_args_is_help=True, rich_markup_mode="markdown")


@replay.callback()
def _group() -> None:
    """Re-run recorded sessions."""


replay_inject.register(replay)
replay_io.register(replay)
replay.command()(repair)


@replay.command()
def verify(
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    jobs: Annotated[
        int | None, typer.Option(min=1, max=256, help="Processes side by side. Default: one per processor.")
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
    recorded, or null).
    """
    try:
        verdict = verify_with_progress(open_session(session), jobs)
    except (SessionError, ValueError) as error:
        if json:
            print_json(not_replayable(str(error)).as_json())
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    if json:
        print_json(verdict.as_json())
    else:
        show(verdict)
    raise typer.Exit(verdict.exit_code)


@replay.command()
def play(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    channel: Annotated[str, typer.Option(help="Where to play, e.g. vcan0.")],
    interface: Annotated[str, typer.Option(help="python-can interface.")] = "socketcan",
    only: Annotated[
        Direction | None, typer.Option(help="Only what the motors said (rx) or what the gateway commanded (tx).")
    ] = None,
    speed: Annotated[float, typer.Option(min=0.01, max=100.0, help="Times as fast as recorded.")] = 1.0,
    bus: Annotated[str | None, typer.Option(help="Which recorded bus, if there are several.")] = None,
    live: Annotated[bool, typer.Option("--live", help="The bus may be alive: MOTORS ON IT WILL MOVE.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable report.")] = False,
) -> None:
    """Put the recorded frames on a bus, with their recorded timing.

    Recorded commands move motors as they did then, without any of the checks of a running gateway. So a bus on which
    anybody talks is refused, and so are commands on an interface that is not vcan or vxcan, unless --live is given.
    Exit 0 if every frame was sent, 1 if not, 2 if nothing was played, 3 if every frame was sent of a recording that is
    incomplete.
    """
    try:
        opened = open_session(session)
        chosen = _chosen(opened, bus, only)
        played = _played(chosen, interface, channel, speed, live=live)
    except (SessionError, AdapterError, OSError) as error:
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    if json:
        print_json(played.as_json() | {"complete": opened.complete})
    else:
        _show_played(played, channel)
    raise typer.Exit(1 if played.not_sent else _exit_of(opened))


def _exit_of(session: Session) -> int:
    """After a success; says what is missing from the recording."""
    if session.problem is None:
        return 0
    complain(f"{session.path}: incomplete: {session.problem}")
    return EXIT_INCOMPLETE


def _chosen(session: Session, bus: str | None, only: Direction | None) -> list[Due]:
    """The frames to play. Raises SessionError."""
    buses = recorded_buses(session)
    if bus is None and len(buses) == 1:
        return recorded(session, buses[0], only)
    if bus not in buses:
        raise SessionError(f"{session.path}: choose a bus with --bus: {', '.join(buses) or 'none is recorded'}")
    return recorded(session, bus, only)


def _played(frames: Sequence[Due], interface: str, channel: str, speed: float, *, live: bool) -> Played:
    """Plays them where that is harmless or wanted. Raises SessionError, AdapterError, OSError, InUseError."""
    commanded = {due.frame.id for due in frames if due.frame.received_ns is None}
    if commanded and interface == "socketcan" and not channel.startswith(VIRTUAL_CHANNELS) and not live:
        raise SessionError(f"{channel} may lead to motors, and commands would move them: --only rx, or --live")
    claims = Claims(interface, channel, commanded)
    try:
        fd = any(due.frame.fd for due in frames)
        with opened(interface=interface, channel=channel, fd=fd) as target:
            if not live and is_alive(target):
                raise SessionError(f"somebody talks on {channel}: if it is to be so, say --live")
            return play_frames(frames, target, speed=speed)
    finally:
        claims.release()


def _show_played(played: Played, channel: str) -> None:
    timing = f"error of the times: median {played.median_error_us:g} us, 99 % {played.p99_error_us:g} us"
    console.print(f"{played.frames} frames on {channel} in {played.seconds:g} s; {timing}", highlight=False)
    if played.not_frames:
        console.print(f"[yellow]left out[/] {played.not_frames}: no data frame has such an id", highlight=False)
    if played.not_sent:
        console.print(f"[red]not sent[/] {played.not_sent}: {played.problem}", highlight=False)


@replay.command()
def run(
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    channel: Annotated[str, typer.Option(help="A virtual CAN interface, e.g. vcan0.")],
    out: Annotated[Path, typer.Option(help="Directory for the session of the new drive.")] = Path("sessions"),
    tick: Annotated[int, typer.Option(min=1, max=20, help="As of `drivegate sim`.")] = 1,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable comparison.")] = False,
) -> None:
    """Give the recorded commands again, to a live service with the simulated robot on this bus, and compare the drives.

    Alike is: the ends within 0.05 m + 2 % of the path and 0.05 rad, the paths within 0.10 m + 2 %, each wheel's speed
    within 3 % of its top speed (rms), and the same sequence of modes. Exit 0 alike, 1 different, 2 not possible,
    3 alike as far as the recording goes, which is incomplete.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        opened = open_session(session)
        found = redrive(opened, channel=channel, out=out, tick_ms=tick)
    except (SessionError, RedriveError, ConfigError, LinkError, OSError) as error:
        if json:
            print_json({"similar": False, "problem": str(error)})
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    if json:
        print_json(found.as_json() | {"complete": opened.complete})
    else:
        _show_comparison(found)
    raise typer.Exit(1 if found.reasons else _exit_of(opened))


def _show_comparison(found: Comparison) -> None:
    table = Table("what", "difference", title=f"{found.session}, {found.path_m:.2f} m")
    table.add_row("pose at the end", f"{found.end_m:.3f} m, {found.end_rad:.3f} rad")
    table.add_row("largest deviation", f"{found.largest_m:.3f} m")
    table.add_row("wheel speeds, rms", f"{found.wheels_rms:.1%} of the top speed")
    table.add_row("modes", " ".join(found.modes_redriven))
    console.print(table)
    for reason in found.reasons:
        console.print(f"[red]different[/] {reason}", highlight=False)
    if not found.reasons:
        console.print("[green]alike[/]")


From = Annotated[float, typer.Option("--from", help="s since the first recorded cycle.")]
To = Annotated[float, typer.Option("--to", help="s since the first recorded cycle.")]


@replay.command()
def trace(
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    begin: From = 0.0,
    end: To = inf,
) -> None:
    """Print setpoints, measured motion, pose and motors of every cycle as CSV, computed again from the recorded inputs.

    SI, at the output; empty where something is unknown or released. Exit 0, 2 if there is nothing, 3 if the recording
    is incomplete: behind what is missing it goes on from the next snapshot of the core.
    """
    with _told(session) as opened:
        typer.echo(",".join(columns(opened)))
        for row in rows(opened):
            if begin <= float(row[1] or 0.0) <= end:
                typer.echo(",".join("" if cell is None else str(cell) for cell in row))


@replay.command()
def can(
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    begin: From = 0.0,
    end: To = inf,
) -> None:
    """Print every recorded CAN frame in words: time, rx or tx, motor, message and fields, and the frame itself.

    Exit 0, 2 if there is nothing, 3 if the recording is incomplete.
    """
    with _told(session) as opened:
        for told in frames(opened):
            if begin <= told.t <= end:
                typer.echo(f"{told.t:.6f} {'tx' if told.sent else 'rx'} {told.words}")


@contextmanager
def _told(path: Path) -> Iterator[Session]:
    """An opened session to tell of, and the exit code of having told."""
    try:
        opened = open_session(path)
        yield opened
    except (SessionError, ConfigError) as error:
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    code = _exit_of(opened)
    raise typer.Exit(code if opened.cycle_count else EXIT_NOT_REPLAYABLE)


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

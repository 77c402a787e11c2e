"""`drivegate replay`: what to do with a recorded session."""

import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from math import inf
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from gateway.cli import replay_bisect, replay_identify, replay_inject, replay_io, replay_report
from gateway.cli.output import complain, console, print_json
from gateway.cli.replay_files import repair
from gateway.cli.replay_incidents import incidents
from gateway.cli.replay_verify import verify
from gateway.cli.replay_whatif import whatif
from gateway.config import ConfigError
from gateway.edges.can_adapter import AdapterError, opened
from gateway.edges.claims import Claims
from gateway.edges.zenoh_session import LinkError
from gateway.recording.recorder import RecorderError
from replay.compare.likeness import Comparison
from replay.compare.retrace import columns, frames, rows
from replay.compare.verify import EXIT_INCOMPLETE, EXIT_NOT_REPLAYABLE
from replay.drive.player import Direction, Due, Played, is_alive, recorded, recorded_buses
from replay.drive.player import play as play_frames
from replay.drive.recorded_drive import RedriveError
from replay.drive.redrive import redrive
from replay.sessions.reader import Session, SessionError, open_session
from replay.sessions.remote import local, place

VIRTUAL_CHANNELS = ("vcan", "vxcan")

replay = typer.Typer(help="Re-run recorded sessions.", no_args_is_help=True, rich_markup_mode="markdown")


@replay.callback()
def _group() -> None:
    """Re-run recorded sessions."""


replay_bisect.register(replay)
replay_identify.register(replay)
replay_inject.register(replay)
replay_io.register(replay)
replay_report.register(replay)
replay.command()(incidents)
replay.command()(repair)
replay.command()(verify)
replay.command()(whatif)


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


def _exit_of(session: Session, name: str | None = None) -> int:
    """After a success; says what is missing from the recording, which goes by this name or its path."""
    if session.problem is None:
        return 0
    complain(f"{name or session.path}: incomplete: {session.problem}")
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
def run(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    channel: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[BUS=]VCAN",
            help="A virtual CAN interface, e.g. vcan0; of several buses one for each: front=vcan0.",
        ),
    ] = None,
    speed: Annotated[
        str | None,
        typer.Option(metavar="1|max", help="1: real time, on --channel. max: virtual time, without a bus."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Directory for the session of the new drive.")] = Path("sessions"),
    tick: Annotated[int | None, typer.Option(min=1, max=20, help="As of `drivegate sim`, with --channel.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable comparison.")] = False,
) -> None:
    """Give the recorded commands again, to the simulated robot, and compare the drives.

    With --channel to a live service on virtual CAN interfaces, in real time: kernel, network and threads have no other.
    With --speed max to the engine of a service, in virtual time and as fast as this computer can: nothing of sockets,
    of Zenoh or of lateness is in that.

    Alike is: the ends within 0.05 m + 2 % of the path and 0.05 rad, the paths within 0.10 m + 2 %, each wheel's speed
    within 3 % of its top speed (rms), and the same sequence of modes. Exit 0 alike, 1 different, 2 not possible,
    3 alike as far as the recording goes, which is incomplete.
    """
    try:
        virtual = _is_virtual(channel or (), speed, tick)
        out.mkdir(parents=True, exist_ok=True)
        opened = open_session(session)
        found, times = (
            _redriven_virtually(opened, out)
            if virtual
            else (
                redrive(opened, channels=channel or (), out=out, tick_ms=tick or 1),
                1.0,
            )
        )
    except (SessionError, RedriveError, RecorderError, ConfigError, LinkError, OSError) as error:
        if json:
            print_json({"similar": False, "problem": str(error)})
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    if json:
        print_json(found.as_json() | {"complete": opened.complete, "realtime_ratio": round(times, 1)})
    else:
        _show_comparison(found)
        if virtual:
            console.print(f"in virtual time, {times:.1f} x real time", highlight=False)
    raise typer.Exit(1 if found.reasons else _exit_of(opened))


def _is_virtual(channels: Sequence[str], speed: str | None, tick: int | None) -> bool:
    """Whether in virtual time. Raises RedriveError for what does not go together."""
    if channels and speed not in {None, "1"}:
        raise RedriveError(
            f"--speed {speed}: a live service on a CAN interface keeps real time, as do kernel and network; "
            "leave out --speed, or leave out --channel and say --speed max"
        )
    if channels:
        return False
    if speed != "max":
        told = "" if speed is None else f"--speed {speed}: "
        raise RedriveError(
            f"{told}say on which virtual CAN interface to drive in real time (--channel vcan0, of several buses one "
            "for each), or --speed max to drive in virtual time, as fast as it goes, without a bus"
        )
    if tick is not None:
        raise RedriveError("--tick belongs to --channel: in virtual time nothing waits for a tick")
    return True


def _redriven_virtually(session: Session, out: Path) -> tuple[Comparison, float]:
    """The comparison, and how many times faster than real time the drive was."""
    # Only now: it records, and Rerun costs half a second.
    redrive_virtually = import_module("replay.drive.redrive_virtual").redrive_virtually
    wall_ns, begin = time.clock_gettime_ns(time.CLOCK_REALTIME), time.perf_counter()
    found = redrive_virtually(session, out=out, started_wall_ns=wall_ns)
    return found.comparison, found.seconds / (time.perf_counter() - begin)


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
    session: replay_io.SessionPlace,
    begin: From = 0.0,
    end: To = inf,
) -> None:
    """Print setpoints, measured motion, pose and motors of every cycle as CSV, computed again from the recorded inputs.

    SI, at the output; empty where something is unknown or released. Exit 0, 2 if there is nothing in that time, 3 if
    the recording is incomplete: behind what is missing it goes on from the next snapshot of the core.
    """
    with _told(session) as opened:
        typer.echo(",".join(columns(opened)))
        wanted = (row for row in rows(opened) if begin <= float(row[1] or 0.0) <= end)
        lines = (",".join("" if cell is None else str(cell) for cell in row) for row in wanted)
        _print(lines, f"{session}: no cycle from {begin:g} s to {end:g} s")


def _print(lines: Iterable[str], nothing: str) -> None:
    """Raises SessionError where there are none."""
    printed = False
    for line in lines:
        typer.echo(line)
        printed = True
    if not printed:
        raise SessionError(nothing)


@replay.command()
def can(
    session: replay_io.SessionPlace,
    begin: From = 0.0,
    end: To = inf,
) -> None:
    """Print every recorded CAN frame in words: time, rx or tx, motor, message and fields, and the frame itself.

    Exit 0, 2 if there is nothing in that time, 3 if the recording is incomplete.
    """
    with _told(session) as opened:
        wanted = (told for told in frames(opened) if begin <= told.t <= end)
        lines = (f"{told.t:.6f} {'tx' if told.sent else 'rx'} {told.words}" for told in wanted)
        _print(lines, f"{session}: no frame from {begin:g} s to {end:g} s")


@contextmanager
def _told(session: str) -> Iterator[Session]:
    """An opened session to tell of, and the exit code of having told."""
    try:
        with local(place(session)) as path:
            opened = open_session(path)
            yield opened
            code = _exit_of(opened, session) if opened.cycle_count else EXIT_NOT_REPLAYABLE
    except (SessionError, ConfigError) as error:
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    raise typer.Exit(code)

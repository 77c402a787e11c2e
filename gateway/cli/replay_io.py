"""`drivegate replay info`, `export`, `import`, `cut`, `merge`, `diff`: sessions as files."""

import os
from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer
from rich.table import Table

from gateway import robot_files
from gateway.cli.output import complain, console, in_words, print_json
from gateway.cli.replay_verify import show
from gateway.config import ConfigError, load
from gateway.recording.failures import WriterDeadError
from gateway.recording.recorder import RecorderError
from replay.compare.difference import Difference, difference
from replay.compare.verify import EXIT_INCOMPLETE, EXIT_NOT_REPLAYABLE, verify
from replay.logs.export import Format, format_of
from replay.logs.export import export as write_log
from replay.logs.logged import LogError
from replay.sessions.reader import SessionError, open_session
from replay.sessions.remote import local, place
from replay.sessions.summary import Stay, Summary, summary, utc

if TYPE_CHECKING:
    from replay.drive.pieces import Piece
    from replay.logs.intake import Imported

SHOWN = 20  # lines of one list

SessionPlace = Annotated[str, typer.Argument(metavar="SESSION", help="Session folder, or one .rrd file; or its URL.")]
SessionPath = Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")]
Json = Annotated[bool, typer.Option("--json", help="Machine-readable report.")]


def info(
    session: SessionPlace,
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
        with local(place(session)) as path:
            found = summary(open_session(path))
            verdict = verify(open_session(path)) if run else None
    except (SessionError, ConfigError, OSError) as error:
        _refuse(error, json=json)
    if json:
        print_json(found.as_json() | ({} if verdict is None else {"verdict": verdict.as_json()}))
    else:
        _show(found)
        if verdict is not None:
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
    if found.cut_from is not None:
        table.add_row("a piece of", found.cut_from)
    for title, lines in _incident(found):
        table.add_row(title, "\n".join(_first(lines)) or "none")
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


def _incident(found: Summary) -> list[tuple[str, list[str]]]:
    incident = found.incident
    if incident is None:
        return []
    told = [f"{utc(cause.wall_ns)} {cause.code}: {cause.text}" for cause in incident.causes]
    more = [f"and {incident.more} more"] if incident.more else []
    buses = [
        f"{bus.name}: {bus.state or 'nothing told'}{f' ({bus.text})' if bus.text else ''}" for bus in incident.buses
    ]
    judged = incident.judgement
    verdict = [] if judged is None else [judged.verdict + (f": {judged.difference}" if judged.difference else "")]
    return [("kept for", [*told, *more]), ("buses then", buses), ("verdict then", verdict)]


def _lists(found: Summary) -> list[tuple[str, list[str]]]:
    faults = [
        f"{fault.t:.3f} s {fault.code}{f' ({fault.times} times)' if fault.times > 1 else ''}: {fault.text}"
        for fault in found.faults
    ]
    gaps = [f"cycles {gap.first_cycle} to {gap.last_cycle}: {gap.reason}" for gap in found.gaps]
    modes = "modes" if found.imported is None else "modes of a core that only listened"
    return [(modes, list(map(_stay, found.modes))), ("faults", faults), ("gaps", gaps)]


def _stay(stay: Stay) -> str:
    return f"{stay.t:.3f} s {stay.mode} for {stay.seconds:.3f} s"


def _first(lines: Sequence[str]) -> list[str]:
    more = [f"and {len(lines) - SHOWN} more"] if len(lines) > SHOWN else []
    return [*lines[:SHOWN], *more]


def export(
    session: SessionPlace,
    file: Annotated[Path, typer.Argument(help="What to write; its suffix says as what.")],
    kind: Annotated[Format | None, typer.Option("--format", help="Instead of what the suffix says.")] = None,
    json: Json = False,
) -> None:
    """Write the frames of a session as a log for other tools, or its channels as a table.

    By suffix: .log as `candump -L -x` writes it (times to the us), .asc, .blf and .mf4 (ns since a date in UTC; a bus
    is a number, in the order of the robot file; MF4 needs drivegate[mf4]), .mcap with can_msgs/msg/Frame for ROS 2 (ns;
    a topic for each bus and direction), .parquet with a row per cycle (ns; the columns of `drivegate replay trace`). A
    received frame has the time at which it came, a sent one that of its cycle. Exit 0; 2: nothing was written; 3: all
    there is was written, of a recording that is incomplete.
    """
    try:
        with local(place(session)) as path:
            found = open_session(path)
            written = write_log(found, file, kind or format_of(file))
            problem = found.problem
    except (SessionError, ConfigError, LogError, OSError) as error:
        _refuse(error, json=json)
    if json:
        print_json(written._asdict() | {"complete": problem is None})
    else:
        what = f"{written.rows} cycles" if kind is Format.PARQUET or written.rows else f"{written.frames} frames"
        channels = ", ".join(f"{bus} is channel {channel}" for bus, channel in written.channels.items())
        console.print(f"{file}: {what} as {written.format}{f'; {channels}' if channels else ''}", highlight=False)
    if problem is not None:
        complain(f"{session}: incomplete: {problem}")
        raise typer.Exit(EXIT_INCOMPLETE)


def import_(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    file: Annotated[Path, typer.Argument(help="Log of CAN frames.")],
    robot: Annotated[str, typer.Argument(help="Robot file, or the name of an installed or bundled one.")],
    maps: Annotated[
        list[str] | None, typer.Option("--map", help="CHANNEL=BUS: of the log, of the robot. Again for each channel.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Directory for the session.")] = Path("sessions"),
    interval: Annotated[
        float | None, typer.Option(min=1e-6, max=1e3, help="s from frame to frame, where the log tells no times.")
    ] = None,
    json: Json = False,
) -> None:
    """Make a session of a log of CAN frames, by the drivers of a robot.

    Read are candump in each of its styles, ASC, BLF, MF4 (with drivegate[mf4]), TRC, SavvyCAN's CSV, and MCAP with
    can_msgs/msg/Frame, also gzipped; which of them it is tells the file and not its name. Without --map it is told
    which channels there are. Cycles are those of the robot file. A frame that a driver takes as the word of a
    controller was received, as one that nobody knows; one that is a command was sent. What led to the commands no log
    tells: `replay can`, `trace`, `info`, `export` and `play` work on such a session, and `verify` and `run` say that
    they cannot.
    Exit 0; 2: nothing was imported; 3: imported, but something in the log became no frame, and it is said what.
    """
    from replay.logs.intake import import_log  # noqa: PLC0415  # with Rerun, which no other command here needs

    try:
        config, text = load(path := robot_files.find(robot))
        found = import_log(
            file,
            config,
            text,
            str(path),
            directory=out,
            buses=_buses(maps or []),
            interval_ns=None if interval is None else round(interval * 1e9),
        )
    except (ConfigError, LogError, RecorderError, WriterDeadError, OSError) as error:
        _refuse(error, json=json)
    account = found.account
    if json:
        left_out = {what: one._asdict() for what, one in account.left_out.items()}
        told = found._asdict() | {"session": str(found.session), "format": account.style, "clock": account.clock.value}
        del told["account"]
        print_json(told | {"lines": account.lines, "left_out": left_out})
    else:
        _show_imported(found)
    raise typer.Exit(EXIT_INCOMPLETE if account.left_out else 0)


def _buses(maps: Sequence[str]) -> dict[str, str]:
    """Raises LogError."""
    found: dict[str, str] = {}
    for text in maps:
        channel, equals, bus = text.rpartition("=")
        if not equals or not channel or not bus:
            raise LogError(f"--map {text}: expected CHANNEL=BUS")
        found[channel] = bus
    return found


def _show_imported(found: "Imported") -> None:
    account = found.account
    table = Table("what", "value", title=str(found.session))
    table.add_row("format", account.style)
    table.add_row("times", account.clock.value)
    table.add_row("began", "not told" if found.began_ns is None else utc(found.began_ns))
    table.add_row("frames", f"{found.received} received, {found.sent} sent, in {found.cycles} cycles")
    if found.pauses:
        table.add_row("pauses of more than 10 s", str(found.pauses))
    if found.backwards:
        table.add_row("times that go backwards", f"{found.backwards}, kept")
    for what, one in account.left_out.items():
        table.add_row(f"left out: {what}", f"{one.times}, first at {one.place}{f': {one.text}' if one.text else ''}")
    console.print(table, highlight=False, markup=False)


def cut(
    session: SessionPath,
    begin: Annotated[float, typer.Option("--from", help="s since the first recorded cycle.")] = 0.0,
    end: Annotated[float, typer.Option("--to", help="s since the first recorded cycle.")] = inf,
    out: Annotated[Path, typer.Option(help="Directory for the piece.")] = Path("pieces"),
    json: Json = False,
) -> None:
    """Make a session of a piece of one, which verifies on its own.

    It begins with the snapshot of the core at or in front of --from, of which there is one every five seconds, or with
    cycle 0. Nothing may be missing in it. Exit 0; 2: nothing was written.
    """
    from replay.drive import pieces  # noqa: PLC0415  # with Rerun

    try:
        piece = pieces.cut(open_session(session), out, begin=begin, end=end)
    except (SessionError, ConfigError, RecorderError, WriterDeadError, OSError) as error:
        _refuse(error, json=json)
    _tell_piece(piece, json=json)


def merge(
    sessions: Annotated[list[Path], typer.Argument(help="Pieces of one session: folders, or .rrd files.")],
    out: Annotated[Path, typer.Option(help="Directory for the session.")] = Path("pieces"),
    json: Json = False,
) -> None:
    """Put pieces of one session together again, in the order of their cycles; they may overlap, but nothing be missing.

    Exit 0; 2: nothing was written.
    """
    from replay.drive import pieces  # noqa: PLC0415  # with Rerun

    try:
        piece = pieces.merge([open_session(session) for session in sessions], out)
    except (SessionError, ConfigError, RecorderError, WriterDeadError, OSError) as error:
        _refuse(error, json=json)
    _tell_piece(piece, json=json)


def _tell_piece(piece: "Piece", *, json: bool) -> None:
    if json:
        print_json(piece._asdict() | {"session": str(piece.session)})
    else:
        which = f"cycles {piece.first_cycle} to {piece.last_cycle}, {piece.begin:.3f} s to {piece.end:.3f} s"
        console.print(f"{piece.session}: {which}", highlight=False)


def diff(
    first: Annotated[str, typer.Argument(help="Session of a drive.")],
    second: Annotated[str, typer.Argument(help="Session of another drive of the same course.")],
    json: Json = False,
) -> None:
    """Hold two drives of one course against each other: paths, wheel speeds, modes, and what of the robot was another.

    Both are counted from their first command, and what is alike is what `replay run` calls so. Aside is how far the
    second was from the line of the first, whenever it was there. Exit 0: alike; 1: different; 2: they cannot be
    compared; 3: alike as far as the recordings go, of which one is incomplete.
    """
    try:
        with local(place(first)) as one, local(place(second)) as other:
            sessions = open_session(one), open_session(other)
            found = difference(*sessions)
            complete = all(session.complete for session in sessions)
    except (SessionError, ConfigError, ValueError, OSError) as error:
        _refuse(error, json=json)
    if json:
        print_json(found.as_json() | {"complete": complete})
    else:
        _show_difference(found)
    if found.likeness.reasons:
        raise typer.Exit(1)
    raise typer.Exit(0 if complete else EXIT_INCOMPLETE)


def _show_difference(found: Difference) -> None:
    like = found.likeness
    table = Table("what", "difference", title=f"{found.seconds:.2f} s, {like.path_m:.2f} m")
    table.add_row("at the end", f"{like.end_m:.3f} m, {like.end_rad:.3f} rad")
    table.add_row("at the same time", f"at most {like.largest_m:.3f} m, at {found.largest_t:.2f} s")
    table.add_row("aside", f"at most {found.aside_m:.3f} m, rms {found.aside_rms_m:.3f} m")
    for wheel in found.wheels:
        told = "never both measured"
        if wheel.rms is not None:
            told = f"rms {wheel.rms:.3f} rad/s, at most {wheel.largest:.3f} rad/s at {wheel.largest_t:.2f} s"
        table.add_row(f"speed of {wheel.motor}", told)
    table.add_row("modes", f"{' '.join(like.modes_recorded)}\n{' '.join(like.modes_redriven)}")
    table.add_row("another one", "\n".join(found.others) or "nothing")
    console.print(table, highlight=False, markup=False)
    for reason in like.reasons:
        console.print(f"[red]different[/] {reason}", highlight=False)
    if not like.reasons:
        console.print("[green]alike[/]")


def _refuse(error: Exception, *, json: bool) -> NoReturn:
    if json:
        print_json({"problem": in_words(error)})
    complain(in_words(error))
    if isinstance(error, WriterDeadError):
        os._exit(EXIT_NOT_REPLAYABLE)  # what is left of the writer would block every other way out
    raise typer.Exit(EXIT_NOT_REPLAYABLE) from None


def register(group: typer.Typer) -> None:
    """The commands of this module, in a group."""
    group.command()(info)
    group.command()(export)
    group.command("import")(import_)
    group.command()(cut)
    group.command()(merge)
    group.command()(diff)

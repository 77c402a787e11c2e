"""`drivegate replay inject` and `campaign`: recorded drives once more, in a simulated world that breaks."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from gateway.cli.output import complain, console, errors, print_json
from gateway.config import ConfigError
from replay.compare.verify import EXIT_NOT_REPLAYABLE
from replay.drive.moment import Moment
from replay.drive.scenario import Watch
from replay.drive.script import Script, in_words, read_script, script_of
from replay.inject.campaign import Campaign, campaign
from replay.inject.injection import Injected, Recorded, inject, recorded
from replay.inject.kept import keep
from replay.sessions.folders import sessions
from replay.sessions.reader import SessionError, open_session
from replay.sessions.remote import local, place

EXIT_BROKEN = 1
PROGRESS_CYCLES = 250


def register(group: typer.Typer) -> None:
    """The commands of this file."""
    group.command(name="inject")(inject_faults)
    group.command(name="campaign")(random_campaign)


def inject_faults(
    session: Annotated[Path, typer.Argument(help="Session folder, or one .rrd file.")],
    script: Annotated[
        Path | None, typer.Argument(help="What happens: a TOML file with [[at]] as in a scenario.")
    ] = None,
    *,
    fault: Annotated[
        list[str] | None,
        typer.Option(help="KIND@SECONDS[+LASTING][:NAME][=VALUE]: power_off@5:front_left, silence@2:teleop, estop@4."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, max=2**32 - 1, help="Of what is left to chance.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Record the new drive into this directory.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Give the recorded commands once more to a simulated robot on which something breaks; watch the laws of motion.

    In virtual time, by the core as it is here; times count from the first recorded cycle. What sensors told over Zenoh
    is not given again. Exit 0: no law was broken, 1: one was, 2: the session cannot be replayed, 78: a bad script.

    --json: as of `drivegate scenario`, laws_broken (violations by law) and broken (the first of each, in words).
    """
    wanted = _script(script, fault or [], seed)
    try:
        drive = recorded(open_session(session))
    except SessionError as error:
        complain(str(error))
        raise typer.Exit(EXIT_NOT_REPLAYABLE) from None
    recording = None
    if out is not None:
        # Only now: Rerun costs half a second, and a drive without a session has no use for it.
        started = time.clock_gettime_ns(time.CLOCK_REALTIME)
        recording = import_module("replay.drive.recording").SessionRecording(
            drive.config, drive.text, drive.name, directory=out, started_wall_ns=started, plant=drive.plant
        )
    with _progress(drive.seconds) as watch:
        try:
            found = inject(drive, wanted, watch=watch, recording=recording)
        finally:
            if recording is not None:
                recording.close()
    if json:
        print_json(found.as_json() | {"session": None if recording is None else str(recording.session)})
    else:
        _show(found)
        if recording is not None:
            console.print(f"session {recording.session}", highlight=False)
    raise typer.Exit(EXIT_BROKEN if found.broken else 0)


def random_campaign(
    paths: Annotated[list[str], typer.Argument(help="Session folders, or folders of them; or URLs of such.")],
    *,
    cycles: Annotated[int, typer.Option(min=1, help="At least so many cycles in all.")] = 1_000_000,
    seed: Annotated[int, typer.Option(min=0, help="Number of the first drive.")] = 0,
    out: Annotated[Path, typer.Option(help="Where a violation is written to, as a test.")] = Path("violations"),
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Break things at random in recorded drives until a law of motion is broken; write the shortest way to it.

    Exit 0: none was, in so many cycles. 1: one was; its folder has robot file, script and a test. 2: no session.

    --json: drives, cycles, violations (by law), found (law, seed, cycles, violation, entries, seconds, tries; or null).
    """
    drives = _drives(paths)
    columns = (TextColumn("driving"), BarColumn(), TextColumn("{task.completed:.0f} cycles"), TimeRemainingColumn())
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task = progress.add_task("drive", total=cycles)
        found = campaign(drives, cycles=cycles, seed=seed, told=lambda more: progress.advance(task, more))
    folder = None if found.found is None else keep(found.found, out)
    if json:
        print_json(found.as_json() | {"test": None if folder is None else str(folder)})
    else:
        _show_campaign(found, folder)
    raise typer.Exit(0 if folder is None else EXIT_BROKEN)


def _script(path: Path | None, faults: list[str], seed: int) -> Script:
    """File and command line together. Raises ConfigError."""
    said = script_of([in_words(words) for words in faults], seed)
    if path is None:
        return said
    read = read_script(path)
    return read.model_copy(update={"at": [*read.at, *said.at], "seed": seed or read.seed})


def _drives(paths: list[str]) -> list[Recorded]:
    """Of all sessions that can be driven again; the others are told."""
    drives = []
    for one in sessions(map(place, paths)):
        try:
            with local(one) as path:
                drives.append(recorded(open_session(path)))
        except (SessionError, ConfigError) as error:
            complain(str(error))
    if not drives:
        complain(f"{', '.join(map(str, paths))}: there is no session to drive again")
        raise typer.Exit(EXIT_NOT_REPLAYABLE)
    return drives


@contextmanager
def _progress(seconds: float) -> Iterator[Watch]:
    """A bar on a terminal, nothing elsewhere."""
    columns = (TextColumn("driving"), BarColumn(), TextColumn("{task.completed:.0f} s"), TimeRemainingColumn())
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task = progress.add_task("drive", total=seconds)

        def watch(moment: Moment) -> None:
            if moment.inputs.cycle % PROGRESS_CYCLES == 0:
                progress.update(task, completed=moment.t)

        yield watch


def _show(found: Injected) -> None:
    result = found.result
    table = Table("t", "what", title=f"{result.robot}, {result.seconds:g} s, {result.cycles} cycles")
    for t, event in result.events:
        table.add_row(f"{t:.3f}", f"{event.code}: {event.text}")
    console.print(table)
    console.print(f"{result.true_distance:.3f} m, at most {result.max_true_speed:.3f} m/s", highlight=False)
    for words in found.broken:
        console.print(f"[red]broken[/] {words}", highlight=False)
    if not found.broken:
        console.print("[green]no law of motion was broken[/]")


def _show_campaign(found: Campaign, folder: Path | None) -> None:
    console.print(f"{found.drives} drives, {found.cycles} cycles", highlight=False)
    if found.found is None:
        console.print("[green]no law of motion was broken[/]")
        return
    shrunk = found.found.shrunk
    console.print(f"[red]broken[/] {found.found.law}: {shrunk.words}", highlight=False)
    console.print(
        f"drive {found.found.seed}, shortened to {len(shrunk.scenario.at)} entries and {shrunk.scenario.seconds:.2f} s "
        f"in {shrunk.tries} drives: {folder}",
        highlight=False,
    )

"""`drivegate scenario`: a drive in virtual time from a file, with what is to happen in it and what it must show."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from typing import Annotated, TextIO

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from gateway.cli.output import complain, console, errors, print_json
from gateway.config import ConfigError, load
from gateway.core.examination import examine
from replay.drive.moment import Moment
from replay.drive.scenario import Result, Watch, run_scenario
from replay.drive.scenario_file import check_names, find_robot, load_scenario
from replay.drive.trace import TraceWriter
from replay.sim.plants.contract import PlantName

EXIT_BROKEN = 1
PROGRESS_CYCLES = 250


def scenario(
    file: Annotated[Path, typer.Argument(help="Scenario file.")],
    *,
    robot: Annotated[str | None, typer.Option(help="Robot file or bundled name instead of the scenario's.")] = None,
    plant: Annotated[PlantName | None, typer.Option(help="By what the robot moves instead of the scenario's.")] = None,
    trace: Annotated[Path | None, typer.Option(help="Write a row per cycle to this CSV file.")] = None,
    out: Annotated[Path | None, typer.Option(help="Record a session into this directory.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Drive a simulated robot in virtual time through what a file says. Exit 0 as expected, 1 not, 78 a bad file."""
    wanted = load_scenario(file)
    if plant is not None:
        wanted = wanted.model_copy(update={"plant": plant})
    path = find_robot(wanted, file.parent, robot)
    config, text = load(path)
    examine(config, str(path))
    check_names(wanted, config, str(file))
    recording = None
    with ExitStack() as stack:
        watching: list[Watch] = [stack.enter_context(_progress(wanted.seconds))]
        if trace is not None:
            watching.append(TraceWriter(stack.enter_context(_opened(trace)), config.robot.motor_names()).write)
        if out is not None:
            # Only now: Rerun costs half a second, and a drive without a session has no use for it.
            recording = import_module("replay.drive.recording").SessionRecording(
                config,
                text,
                str(path),
                directory=out,
                started_wall_ns=time.clock_gettime_ns(time.CLOCK_REALTIME),
                plant=wanted.plant,
            )
            stack.callback(recording.close)
        result = run_scenario(wanted, config, watch=_all(watching), recording=recording)
    session = None if recording is None else recording.session
    if json:
        print_json(result.as_json(session))
    else:
        _show(result, session)
    for text in result.broken:
        complain(text)
    raise typer.Exit(EXIT_BROKEN if result.broken else 0)


def _all(watching: list[Watch]) -> Watch:
    def watch(moment: Moment) -> None:
        for one in watching:
            one(moment)

    return watch


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


def _opened(path: Path) -> TextIO:
    try:
        return path.open("w", encoding="utf-8", newline="")
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be written: {error.strerror}"]) from None


def _show(result: Result, session: Path | None) -> None:
    table = Table("t", "what", title=f"{result.robot}, {result.seconds:g} s, {result.cycles} cycles")
    for t, event in result.events:
        table.add_row(f"{t:.3f}", f"{event.code}: {event.text}")
    console.print(table)
    console.print(f"{result.true_distance:.3f} m, at most {result.max_true_speed:.3f} m/s", highlight=False)
    if session is not None:
        console.print(f"session {session}", highlight=False)

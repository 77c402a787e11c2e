"""`drivegate path`: drive along the path that a file describes, as a commander like any other."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path as File
from typing import Annotated

import typer
from rich.progress import BarColumn, Progress, TextColumn

from gateway.cli.operate import EXIT_REFUSED, Connect, RobotName, open_client
from gateway.cli.output import EXIT_CONFIG, complain, console, errors, print_json
from gateway.commander import INTERRUPTED, PathResult, config_of, drive_path
from gateway.config import ConfigError, RobotConfig, load, read
from gateway.paths import path_file
from gateway.paths.drive import check, demands_of
from gateway.paths.follower import Order
from gateway.paths.path import Path

EXIT_INTERRUPTED = 130  # as of a shell after Ctrl-C


def path(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    file: Annotated[File, typer.Argument(help="Path file.")],
    name: RobotName,
    source: Annotated[str, typer.Option(help="Command source as named in the robot file.")] = "autonomy",
    speed: Annotated[float, typer.Option(min=0.01, max=5.0, help="Along the path, m/s.")] = 0.3,
    checked: Annotated[
        bool, typer.Option("--check", help="Only check the path; a robot file given as NAME needs no running robot.")
    ] = False,
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Drive along a path from its start to its end, in the frame of the odometry. Exit 78 if the path cannot be driven.

    Exit 1 if it was not driven to its end, with the reason.
    """
    try:
        wanted = path_file.parse(read(file), str(file))
        if checked:
            _check(wanted, _config(name, connect), str(file), speed, json=json)
            return
        with open_client(name, connect, zero_on_exit=True) as client, _progress(wanted.length) as watch:
            result = drive_path(client, wanted, str(file), source=source, speed=speed, watch=watch)
    except ConfigError as error:
        if json:
            print_json({"ok": False, "problems": list(error.problems)})
        complain(str(error))
        raise typer.Exit(EXIT_CONFIG) from None
    _tell(name, result, json=json)


def _config(name: str, connect: str | None) -> RobotConfig:
    if name.endswith(".toml"):
        return load(File(name))[0]
    with open_client(name, connect) as client:
        return config_of(client)


def _check(wanted: Path, config: RobotConfig, origin: str, speed: float, *, json: bool) -> None:
    demands = demands_of(config)
    check(demands.problems(wanted, speed), origin)
    wanted = demands.fitted(wanted)
    radius, seconds = wanted.smallest_radius, demands.seconds(wanted, speed)
    if json:
        print_json({"ok": True, "length": wanted.length, "smallest_radius": radius, "seconds": seconds})
        return
    tightest = "straight" if radius is None else f"smallest radius {radius:.3f} m"
    console.print(f"{wanted.length:.3f} m, {tightest}, {seconds:.1f} s at {speed:g} m/s", highlight=False)


def _tell(name: str, result: PathResult, *, json: bool) -> None:
    """What became of the drive; leaves the command with exit 0 when the end was reached."""
    if json:
        mode = None if result.mode is None else result.mode.value
        print_json({"ok": result.reason is None} | result._asdict() | {"mode": mode})
    else:
        end = "" if result.end_deviation is None else f", {result.end_deviation:.3f} m from the end"
        console.print(
            f"path of {result.length:.3f} m: {result.seconds:.1f} s, at most {result.max_deviation:.3f} m beside{end}",
            highlight=False,
        )
    if result.reason is not None:
        complain(f"{name}: {result.reason}")
        raise typer.Exit(EXIT_INTERRUPTED if result.reason == INTERRUPTED else EXIT_REFUSED)


@contextmanager
def _progress(length: float) -> Iterator[Callable[[Order], None]]:
    """A bar on a terminal, nothing elsewhere."""
    columns = (
        TextColumn("driving"),
        BarColumn(),
        TextColumn("{task.completed:.2f} of {task.total:.2f} m, {task.fields[deviation]:+.3f} m beside"),
    )
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task = progress.add_task("drive", total=length, deviation=0.0)
        yield lambda order: progress.update(task, completed=order.way, deviation=order.deviation)

"""`drivegate check`: what follows from a robot file, without touching any bus."""

from collections.abc import Mapping
from importlib import import_module
from math import degrees
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.table import Table

from gateway import robot_files
from gateway.chassis import AnyRobot
from gateway.cli.output import EXIT_CONFIG, complain, console, in_words, note, print_json
from gateway.cli.polar import polar
from gateway.config import ConfigError, RobotConfig, read
from gateway.core.examination import LOAD_WARNING, Examination, Push, Pushes, examined
from gateway.kinematics.contract import GeometryError
from gateway.setup.prepare_odrive import unproven
from gateway.setup.words import UNSEEN, positive_ways

EXIT_NOT_WRITTEN: Final = 1
PICTURES: Final = (".svg", ".png")


def check(
    file: Annotated[str, typer.Argument(help="Robot file, or the name of an installed or bundled one.")],
    json: Annotated[bool, typer.Option("--json", help="Machine-readable report.")] = False,
    picture: Annotated[
        Path | None,
        typer.Option(help="Draws the robot from above, with what each motor does: OUT.svg or OUT.png.", metavar="OUT"),
    ] = None,
) -> None:
    """Validate a robot file and print what follows from it. Exit 78 if it must not be driven with.

    What is refused is told all at once, with what can be said of the robot all the same.
    """
    if picture is not None and picture.suffix.lower() not in PICTURES:
        raise typer.BadParameter(f"{picture}: must end in {' or '.join(PICTURES)}", param_hint="--picture")
    try:
        found = robot_files.locate(file)
        origin = str(found.path)
        told = examined(read(found.path), origin)
    except ConfigError as error:
        _refuse(error, None, json=json)
        raise typer.Exit(EXIT_CONFIG) from None
    report = None if told.report is None or told.config is None else _warned(told.report, told.config, found.path)
    drawn = picture is None or _draw(told.parts.robot, picture)
    if told.problems or report is None or told.config is None:
        _refuse(ConfigError(origin, told.problems), report, json=json)
        raise typer.Exit(EXIT_CONFIG)
    ways = positive_ways(told.config.robot)
    if json:
        print_json({"file": origin, "place": found.place.value, "valid": True, "positive": ways} | _document(report))
    else:
        if found.place is not robot_files.Place.GIVEN:
            console.print(f"robot file {found.words}", markup=False, highlight=False, soft_wrap=True)
        _show(report)
        _show_ways(ways, file)
    if not drawn:
        raise typer.Exit(EXIT_NOT_WRITTEN)


def _warned(report: Examination, config: RobotConfig, path: Path) -> Examination:
    """With what is not proven of its controllers, and where the robot is called other than its file."""
    unlike = robot_files.unlike(path, report.robot)
    more = (*unproven(config), *([] if unlike is None else [unlike]))
    return report._replace(warnings=(*report.warnings, *more))


def _refuse(error: ConfigError, report: Examination | None, *, json: bool) -> None:
    """What is wrong, behind what can be said of the robot all the same."""
    if json:
        document = {} if report is None else _document(report)
        print_json({"valid": False, "file": error.origin, "problems": list(error.problems)} | document)
        return
    if report is not None:
        _show(report)
    complain(str(error))


def _draw(robot: AnyRobot | None, path: Path) -> bool:
    """Whether there is a picture now; else it is said why not."""
    if robot is None:
        complain("no picture: what is wrong is in [robot]")
        return False
    try:
        import_module("gateway.cli.picture").draw(robot, path)  # nobody else needs it
    except GeometryError:  # which is told as a problem of the file
        complain("no picture: these wheels cannot drive the robot, so there is no wheel matrix to draw")
        return False
    except OSError as error:
        complain(f"no picture: {in_words(error)}")
        return False
    note(f"{path}: the robot from above, and what each motor does when it turns positively")
    return True


def _document(report: Examination) -> dict[str, object]:
    return {
        **report._asdict(),
        "top_speeds": dict(zip(report.axes, report.top_speeds, strict=True)),
        "reachable": dict(zip(report.axes, report.reachable, strict=True)),
        "loop_limits": [limit._asdict() for limit in report.loop_limits],
        "grip": None if report.grip is None else report.grip._asdict(),
        "buses": [bus._asdict() for bus in report.buses],
        "sensors": [sensor._asdict() for sensor in report.sensors],
        "effective_motors": None if report.effective_motors is None else _pushes_document(report.effective_motors),
    }


def _pushes_document(pushes: Pushes) -> dict[str, object]:
    without = {name: push._asdict() for name, push in pushes.without.items()}
    return pushes._asdict() | {"every": pushes.every._asdict(), "without": without}


def _show(report: Examination) -> None:
    table = Table("what", "value", title=f"{report.robot} ({report.kind}, {report.motors} motors)")
    table.add_row("wheel matrix", f"rank {report.rank}, condition {report.condition:.3g}")
    for axis, possible, used in zip(report.axes, report.top_speeds, report.reachable, strict=True):
        unit = "rad/s" if axis == "wz" else "m/s"
        table.add_row(f"top speed {axis}", f"{used:.3g} {unit} (motors alone: {possible:.3g})")
    stop = f"at most {report.stopping_time_s:.2f} s and {report.stopping_distance_m:.2f} m"
    table.add_row("stop from top speed", stop)
    if report.grip is not None:
        friction, share, seconds, metres = report.grip
        table.add_row("the same, commanded", f"at most {seconds:.2f} s and {metres:.2f} m at friction {friction:g}")
        table.add_row("launch", f"{share:.0%} of limits.acceleration at least; no more than floor and motors bear")
    if report.turning_share < 1.0:
        held = f"held back to {report.turning_share:.0%}: faster turning would exceed limits.acceleration"
        table.add_row("all top speeds at once", held)
    table.add_row("torque at limits.acceleration", f"{report.torque_share:.0%} of the most strained motor")
    for bus in report.buses:
        style = "yellow" if bus.load > LOAD_WARNING else "green"
        text = f"[{style}]{bus.load:.1%}[/] worst case at {report.rate_hz:g} Hz, {bus.frames_per_second:.0f} frames/s"
        table.add_row(f"load of {bus.bus}", text)
    for sensor in report.sensors:
        table.add_row(f"sensor {sensor.name}", f"{sensor.kind} by {sensor.by}")
    for limit in report.loop_limits:
        table.add_row(limit.name, f"stable at top speed: {limit.needed}")
    console.print(table)
    if report.effective_motors is not None:
        _show_pushes(report.effective_motors)
    for warning in report.warnings:
        console.print(f"[yellow]warning[/] {warning}", highlight=False)


def _show_ways(ways: Mapping[str, str], file: str) -> None:
    """What nothing but the robot itself can prove right."""
    table = Table("motor", "turned positively", title="signs")
    for motor, way in ways.items():
        table.add_row(motor, way)
    console.print(table)
    console.print(UNSEEN.format(file=file), markup=False, highlight=False)


def _show_pushes(pushes: Pushes) -> None:
    """How hard it can push itself in each direction, drawn from above with forward up, and without each motor."""
    words = f"effective motors: push along the ground without turning, in motors of {pushes.force:.3g} N; forward is up"
    console.print(words, highlight=False)
    for line in polar(pushes.directions, pushes.motors):
        console.print(f"  {line}", markup=False, highlight=False)
    table = Table("motors", "forward", "45 deg left", "sideways", "least")
    table.add_row("all", *_push_cells(pushes.every))
    for name, push in pushes.without.items():
        table.add_row(f"without {name}", *_push_cells(push))
    console.print(table)


def _push_cells(push: Push) -> list[str]:
    least = f"{push.least:.2f} at {degrees(push.least_direction):.0f} deg"
    return [f"{push.forward:.2f}", f"{push.diagonal:.2f}", f"{push.sideways:.2f}", least]

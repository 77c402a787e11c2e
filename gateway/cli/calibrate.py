"""`drivegate calibrate`: measure what the robot file has to know, with the robot itself."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import date
from pathlib import Path
from typing import Annotated, NamedTuple

import tomlkit
import typer
from rich.progress import Progress, SpinnerColumn, TextColumn
from rich.table import Table
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable

from gateway.calibration import CalibrationError, Driver, Found, Launch, Plans, find
from gateway.chassis.omni import OmniRobot
from gateway.cli.operate import EXIT_REFUSED, Connect, open_client
from gateway.cli.output import complain, console, errors, print_json
from gateway.cli.rewriting import RewriteError, drafted
from gateway.client import Client
from gateway.commander import config_of
from gateway.config import ConfigError, RobotConfig, load, parse
from gateway.control.launch import LEAST_FRICTION

ANSWER = "yes"

calibrate = typer.Typer(no_args_is_help=True, help="Measure what the robot file has to know, with the robot itself.")


class WheelGrip(NamedTuple):
    """At rest: N on a wheel, N m with which it slips, and V of its motor that give them (None: of no winding known)."""

    motor: str
    load: float
    torque: float
    voltage: float | None


@calibrate.command()
def slip(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    file: Annotated[Path, typer.Argument(help="Robot file of the running robot, with [robot.grip]; it is changed.")],
    surface: Annotated[str, typer.Option(help="What it stands on, e.g. 'oak floor'; goes into the robot file.")],
    rounds: Annotated[int, typer.Option(min=1, max=20, help="How often to find it, along each axis.")] = 3,
    source: Annotated[str, typer.Option(help="Command source as named in the robot file.")] = "teleop",
    connect: Connect = None,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Launch the robot harder each time until its wheels slip; write the friction of the floor into the robot file.

    It asks a person on a terminal before it moves, and does not run without.
    """
    config, _ = load(file)
    try:
        plans = Plans(config)
        surface = words_of(surface)
        rehearse(file, surface)
        with open_client(str(file), connect, zero_on_exit=True) as client:
            _same_robot(client, config, file)
            _ask(config.robot.name, plans.furthest())
            found = _find(plans, client, source, rounds)
        friction, note = summary(found, surface, date.today())  # noqa: DTZ011  # of the person who stands there
        write(file, friction, note)
    except (CalibrationError, KeyboardInterrupt) as error:
        reason = "interrupted" if isinstance(error, KeyboardInterrupt) else str(error)
        if json:
            print_json({"ok": False, "reason": reason})
        complain(f"{config.robot.name}: {reason}; {file} is as it was")
        raise typer.Exit(EXIT_REFUSED) from None
    wheels = wheels_of(config, friction)
    if json:
        rows = [{"axis": one.axis.value, "friction": one.friction, "taken_for": one.taken_for} for one in found]
        rest = {"friction": friction, "rounds": rows, "wheels": [wheel._asdict() for wheel in wheels]}
        print_json({"ok": True, "file": str(file)} | rest)
        return
    console.print(_table(wheels))
    console.print(f"{file}: robot.grip.friction = {friction} ({note}); it counts from the next start on")


def _same_robot(client: Client, config: RobotConfig, file: Path) -> None:
    if config_of(client) != config:
        raise CalibrationError(
            f"the running robot was started with another robot file than {file} is now: start it anew"
        )


def _ask(name: str, furthest: float) -> None:
    """Only a person lets it move. Raises CalibrationError for any other answer than yes."""
    if sys.stdin is None or not sys.stdin.isatty():  # None: it was closed
        raise CalibrationError("a person has to let it move: run it on a terminal")
    errors.print(
        f"{name} will launch forward, back, left and right, each way up to {furthest:.1f} m from where it stands, "
        "harder each time until its wheels slip. Clear the floor, and keep the emergency stop at hand.",
        highlight=False,
    )
    errors.print(f"Type {ANSWER} to let it move: ", end="")
    if sys.stdin.readline().strip() != ANSWER:
        raise CalibrationError("nobody let it move")


def _find(plans: Plans, client: Client, source: str, rounds: int) -> list[Found]:
    """All rounds; what is going on is shown on a terminal."""
    drive = Driver(client, source, plans.given)
    columns = (SpinnerColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=errors, disable=not errors.is_terminal, transient=True) as progress:
        task = progress.add_task("", total=None)

        def launched(launch: Launch) -> float:
            progress.update(task, description=f"{launch.axis.value}: friction {launch.friction:.2f}")
            return drive(launch)

        def told(one: Found) -> None:
            progress.print(f"{one.axis.value}: {one.friction:.3f}, slipped when taken for {one.taken_for:.3f}")

        try:
            return find(plans, launched, rounds, told)
        finally:
            drive.put_back()


def words_of(surface: str) -> str:
    """What the robot stands on, in one line. Raises CalibrationError for what no comment can say."""
    words = " ".join(surface.split())
    if not words or not words.isprintable():
        raise CalibrationError(f"surface = {surface!r}: must say, in printable letters, what the robot stands on")
    return words


def summary(found: Sequence[Found], surface: str, day: date) -> tuple[float, str]:
    """The friction to go by, the least that was found, rounded down; and where, when and how sure it is.

    Raises CalibrationError for less than a robot file can say.
    """
    values = [one.friction for one in found]
    least, most = min(values), max(values)
    if least < LEAST_FRICTION:
        raise CalibrationError(f"the floor gives a friction of {least:.3f}, and less than {LEAST_FRICTION:g} is none")
    note = f"{surface}, {day.isoformat()}: {least:.3f} to {most:.3f} in {len(values)} rounds"
    return int(least * 100.0) / 100.0, note


def rehearse(file: Path, surface: str) -> None:
    """Everything of `write` but the last step, before the robot moves for it. Raises CalibrationError."""
    with _draft(file, LEAST_FRICTION, surface):
        pass


def write(file: Path, friction: float, note: str) -> None:
    """Puts it into the robot file, everything else as it was; whole or not at all. Raises CalibrationError."""
    try:
        with _draft(file, friction, note) as draft:
            draft.replace(file.resolve())
    except CalibrationError as error:
        raise CalibrationError(f"friction = {friction} ({note}) was found, but {error}") from None


@contextmanager
def _draft(file: Path, friction: float, note: str) -> Iterator[Path]:
    """The changed robot file, beside it and with its rights; gone at the end unless it was moved."""
    try:
        with drafted(file, _changed(file.resolve(), friction, note)) as draft:
            yield draft
    except RewriteError as error:
        raise CalibrationError(str(error)) from None
    except OSError as error:
        raise CalibrationError(f"{file} cannot be written: {error.strerror}") from None


def _changed(file: Path, friction: float, note: str) -> str:
    """The text of the robot file with this friction; its line ends are kept. Raises CalibrationError, OSError."""
    try:
        document = tomlkit.parse(file.read_bytes().decode())
        robot = document["robot"]
        grip = robot["grip"]
        grip["friction"] = friction
        # Within an inline table a comment would swallow the rest: it goes behind the whole.
        lines = [one for one in (robot, grip) if isinstance(one, InlineTable)] or [grip["friction"]]
        lines[0].comment(note)
        text = tomlkit.dumps(document)
        parse(text, str(file))
    except (ConfigError, TOMLKitError, UnicodeDecodeError) as error:
        raise CalibrationError(f"robot.grip.friction cannot be changed in it: {error}") from None
    return text


def wheels_of(config: RobotConfig, friction: float) -> list[WheelGrip]:
    """What that means for each wheel at rest: the torque, and the V0 of a launch where its motor has a winding."""
    robot = config.robot
    if not isinstance(robot, OmniRobot):
        return []
    motors = {motor.name: motor for motor in config.motor}
    found = []
    for wheel, pressed in zip(robot.wheel, robot.ground().resting, strict=True):
        motor, torque = motors[wheel.motor], friction * pressed * wheel.radius
        shaft, winding = torque / abs(motor.gear_ratio), motor.winding
        voltage = None if winding is None else shaft * winding.resistance / winding.back_emf
        found.append(WheelGrip(wheel.motor, pressed, torque, voltage))
    return found


def _table(wheels: Sequence[WheelGrip]) -> Table:
    table = Table("wheel", "load, N", "slips at, N m", "V0, V")
    for motor, pressed, torque, voltage in wheels:
        table.add_row(motor, f"{pressed:.1f}", f"{torque:.2f}", "" if voltage is None else f"{voltage:.2f}")
    return table

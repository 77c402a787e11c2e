"""`drivegate setup jog`: one motor turns a little."""

from typing import Annotated

import typer

from gateway import robot_files
from gateway.cli.asking import NotAllowedError, Yes, allow
from gateway.cli.output import console, print_json
from gateway.cli.refusing import EXIT_REFUSED, refuse
from gateway.config import Bus, ConfigError, Motor, RobotConfig, load
from gateway.edges.can_adapter import AdapterError
from gateway.edges.can_bus import CanBuses
from gateway.edges.claims import refuse_where_commanded
from gateway.edges.listening import Place, refuse_where_absent
from gateway.edges.signals import EndRequest
from gateway.edges.turning import turn
from gateway.setup.jog import PERIOD_NS, USUAL_SECONDS, USUAL_SPEED, Ending, Jog, JogError, Outcome
from gateway.setup.words import positive_ways


def jog(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    file: Annotated[str, typer.Argument(help="Robot file, or the name of an installed or bundled one.")],
    motor: Annotated[str, typer.Argument(help="Its name in the robot file.")],
    speed: Annotated[float, typer.Option(help="Rad/s at the output, up to 1; below 0: backwards.")] = USUAL_SPEED,
    seconds: Annotated[float, typer.Option(help="For how long, up to 5.")] = USUAL_SECONDS,
    yes: Yes = False,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Turn one motor a little, wheels off the ground. It asks first, and ends by itself when anything is not right."""
    config, _ = load(robot_files.find(file))
    try:
        procedure = Jog(config, motor, speed=speed, seconds=seconds)
        look_for_bus(config, procedure.bus)
        way = positive_ways(config.robot)[motor] if speed > 0.0 else "the other way round"
        allow(
            f"{warning(config, motor)} {motor} will turn {abs(speed * seconds):.2f} rad: {way}.", "to turn it", yes=yes
        )
        outcome = run(config, procedure)
    except (JogError, NotAllowedError, AdapterError, KeyboardInterrupt) as error:
        refuse(error, json=json)
    if json:
        print_json(outcome._asdict() | {"ok": outcome.well, "ending": outcome.ending.value})
    else:
        console.print(words(outcome), markup=False, highlight=False)
    if not outcome.well:
        raise typer.Exit(EXIT_REFUSED)


def run(config: RobotConfig, procedure: Jog) -> Outcome:
    """Turn it, with the bus to itself. Raises InUseError."""
    place = bus_of(config, procedure.bus)
    refuse_where_commanded(place.interface, place.channel)
    alone = config.model_copy(update={"bus": [place]})
    buses, ending = CanBuses(alone), EndRequest()
    try:
        with ending.heeded():
            turn(buses, procedure, ending, period_ns=min(round(1e9 / config.loop.rate), PERIOD_NS))
    finally:
        buses.close()
    if procedure.outcome is None:
        raise ConfigError("setup", ["the jog has no outcome"])
    if ending.by is not None and procedure.outcome.ending is Ending.TURNED:  # asked when it had turned already
        return procedure.outcome._replace(ending=Ending.ASKED, reason=ending.by)
    return procedure.outcome


def look_for_bus(config: RobotConfig, name: str) -> None:
    """Raises AdapterError where it is not there: before a person is asked for a yes."""
    bus = bus_of(config, name)
    refuse_where_absent(Place(bus.interface, bus.channel))


def bus_of(config: RobotConfig, name: str) -> Bus:
    """The bus of this name."""
    return next(bus for bus in config.bus if bus.name == name)


def warning(config: RobotConfig, *names: str) -> str:
    """What a person has to see to before these motors turn."""
    text = (
        "Lift the robot so that no wheel touches the ground, keep hands and cables away, and the power switch at hand."
    )
    holding = [motor for motor in config.motor if motor.name in names and motor.watchdog is None]
    return f"{text} {_holds(holding)}" if holding else text


def _holds(motors: list[Motor]) -> str:
    names = ", ".join(motor.name for motor in motors)
    return f"Without a command timeout ({names}) a controller may hold its last command when cable or program fails."


def words(outcome: Outcome) -> str:
    """For a person."""
    moved = "" if outcome.moved is None else f", {outcome.moved:.2f} rad by its encoder"
    reason = f": {outcome.reason}" if outcome.reason else ""
    held = "" if outcome.released else "; it did not confirm that it is released: cut its power"
    return f"{outcome.motor}: {outcome.ending.value}{moved}{reason}{held}"

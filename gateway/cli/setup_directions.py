"""`drivegate setup directions`: which controller drives which wheel, and which way; the robot file is corrected."""

from typing import Annotated

import typer

from gateway.cli.asking import NotAllowedError, Yes, allow, ask
from gateway.cli.correcting import OwnFile, correct
from gateway.cli.output import complain, errors, print_json
from gateway.cli.refusing import EXIT_REFUSED, refuse
from gateway.cli.rewriting import RewriteError, drafted
from gateway.cli.setup_jog import run, warning, words
from gateway.config import Bus, RobotConfig, load
from gateway.edges.can_adapter import AdapterError
from gateway.edges.claims import refuse_where_commanded
from gateway.edges.listening import Place, listen
from gateway.setup.by_hand import HandWatch, Turned
from gateway.setup.census import Census
from gateway.setup.correction import CorrectionError
from gateway.setup.directions import Device, Directions, FindingError, Trial, says
from gateway.setup.jog import USUAL_SECONDS, USUAL_SPEED, Ending, Jog, JogError
from gateway.setup.words import positive_ways

LISTEN_S = 1.5
HAND_S = 120.0


class DirectionsError(RuntimeError):
    """Why the robot file was not changed."""


def directions(  # noqa: PLR0917  # a command line: each parameter is an option with a name
    file: OwnFile,
    by_hand: Annotated[bool, typer.Option("--by-hand", help="Nothing is energised: you turn each wheel.")] = False,
    speed: Annotated[float, typer.Option(help="Rad/s at the output, up to 1.")] = USUAL_SPEED,
    seconds: Annotated[float, typer.Option(help="For how long each wheel turns, up to 5.")] = USUAL_SECONDS,
    yes: Yes = False,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Find which controller drives which wheel, and which way round; correct ids and directions of the robot file.

    Every controller that answers turns a little, and you say what you saw; or you turn each wheel by hand. What is
    changed is shown, and written only after a yes; a copy of the file is kept.
    """
    config, text = load(file)
    try:
        with drafted(file, text):
            pass  # so that nobody watches wheels for nothing
        found = [
            _by_hand(config, bus) if by_hand else _turning(config, bus, speed=speed, seconds=seconds, yes=yes)
            for bus in config.bus
            if any(motor.bus == bus.name for motor in config.motor)
        ]
        changes = [change for one in found for change in one.changes()]
        missing = [name for one in found for name in one.missing]
        kept = correct(file, text, changes, yes=yes)
    except (
        *(DirectionsError, FindingError, CorrectionError, RewriteError, JogError, NotAllowedError, AdapterError),
        KeyboardInterrupt,
    ) as error:
        refuse(error, json=json, unchanged=file)
    if json:
        rows = [change._asdict() for change in changes]
        print_json({"ok": not missing, "changes": rows, "missing": missing, "kept": kept and str(kept)})
    for name in missing:
        complain(f"motor {name}: not found")
    if missing:
        raise typer.Exit(EXIT_REFUSED)


def _turning(config: RobotConfig, bus: Bus, *, speed: float, seconds: float, yes: bool) -> Directions:
    """Every controller turns a little. Raises DirectionsError."""
    if not speed > 0.0:
        raise DirectionsError(f"speed = {speed:g}: must be above 0: it is asked what turned forward")
    refuse_where_commanded(bus.interface, bus.channel)
    found = _heard(config, bus)
    ways = positive_ways(config.robot)
    names = ", ".join(device.name for device in found.devices)
    what = f"{warning(config, *found.names)} One after the other will turn {speed * seconds:.2f} rad: {names}."
    allow(what, "to turn them", yes=yes)
    for trial in found.trials():
        if _turned(trial, speed=speed, seconds=seconds):
            _asked(found, trial, ways)
    return found


def _heard(config: RobotConfig, bus: Bus) -> Directions:
    """Who answers, by listening. Raises DirectionsError where it is nobody, or two of one id."""
    census = Census()
    place = Place(bus.interface, bus.channel, bus.bitrate)
    listen(place, LISTEN_S, lambda frame: census.take([frame]))
    # Whatever their ids are, they are of the kinds that the robot file says.
    kinds = {(motor.driver, motor.variant) for motor in config.motor if motor.bus == bus.name}
    report = census.report(LISTEN_S, {(driver, kind, at) for driver, kind in kinds for at in census.heard(driver)})
    if report.conflicts:
        raise DirectionsError(f"{bus.name}: {'; '.join(report.conflicts)}")
    found = Directions(config, bus.name, report.found)
    if not found.devices:
        raise DirectionsError(f"{bus.name}: no controller of these motors answers; try `drivegate setup scan`")
    return found


def _turned(trial: Trial, *, speed: float, seconds: float) -> bool:
    """Whether it turned, or might have; one that ran away is the end. Raises DirectionsError."""
    errors.print(f"{trial.device.name} turns now.", highlight=False)
    outcome = run(trial.config, Jog(trial.config, trial.motor, speed=speed, seconds=seconds))
    if outcome.ending in (Ending.RUNAWAY, Ending.ASKED) or not outcome.released:
        raise DirectionsError(f"{trial.device.name}: {words(outcome)}")
    if outcome.ending is not Ending.TURNED:
        complain(f"{trial.device.name}: {words(outcome)}")
    return outcome.ending is Ending.TURNED


def _asked(found: Directions, trial: Trial, ways: dict[str, str]) -> None:
    """Until the answer can be."""
    guess = trial.motor if trial.motor in found.missing else ""
    meant = f"f: {guess}, and {ways[guess]}; b: {guess}, the other way round; " if guess else ""
    others = ", ".join(name for name in found.missing if name != guess)
    another = f"a wheel ({others}) and f or b; " if others else ""
    question = f"What turned? {meant}{another}n: nothing"
    for name in found.missing:
        errors.print(f"  {name} f: {ways[name]}", highlight=False, markup=False)
    while True:
        try:
            answer = says(ask(question), trial, found.names)
            if answer is None:
                found.nothing_turned(trial.device)
                return
            motor, forward = answer
            sign = next(one.direction for one in trial.config.motor if one.name == trial.motor)
            found.note(trial.device, motor, sign if forward else -sign)
        except FindingError as error:
            complain(str(error))
        else:
            return


def _by_hand(config: RobotConfig, bus: Bus) -> Directions:
    """You turn each wheel."""
    refuse_where_commanded(bus.interface, bus.channel)
    found, ways = _heard(config, bus), positive_ways(config.robot)
    motors = [motor for motor in config.motors_in_order() if motor.bus == bus.name]
    watch = HandWatch({(motor.driver, motor.variant) for motor in motors})
    for motor in motors:
        watch.begin(motor.gear_ratio)
        while motor.name in found.missing:
            errors.print(f"Turn {motor.name} by hand, a third of a turn, so that {ways[motor.name]}.", highlight=False)
            turned = _watched(watch, bus)
            _noted(found, motor.name, turned)
            watch.begin(motor.gear_ratio)
    return found


def _watched(watch: HandWatch, bus: Bus) -> Turned:
    """Raises DirectionsError where nobody turns anything."""
    place = Place(bus.interface, bus.channel, bus.bitrate)
    listen(place, HAND_S, lambda frame: watch.take([frame]), going_on=lambda: watch.turned() is None)
    turned = watch.turned()
    if turned is None:
        raise DirectionsError(f"{bus.name}: no encoder told a turn within {HAND_S:g} s")
    return turned


def _noted(found: Directions, motor: str, turned: Turned) -> None:
    if turned.others:
        complain(f"{', '.join(turned.others)} moved too: lift the wheels, and turn one alone")
        return
    try:
        found.note(Device(turned.driver, turned.variants, turned.id), motor, 1 if turned.way > 0.0 else -1)
    except FindingError as error:
        complain(str(error))
    else:
        errors.print(f"{motor}: {turned.driver} id {turned.id}", highlight=False)

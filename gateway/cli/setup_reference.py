"""`drivegate setup reference`: where a steered joint has its zero, and which way its encoder counts."""

from typing import Annotated

import typer

from gateway.cli.asking import NotAllowedError, Yes, ask
from gateway.cli.correcting import OwnFile, correct
from gateway.cli.output import console, errors, print_json
from gateway.cli.refusing import refuse
from gateway.cli.rewriting import RewriteError, drafted
from gateway.cli.setup_jog import bus_of, look_for_bus
from gateway.config import Motor, RobotConfig, load
from gateway.edges.can_adapter import AdapterError
from gateway.edges.claims import refuse_where_commanded
from gateway.edges.listening import Place, listen
from gateway.setup.by_hand import HandWatch
from gateway.setup.correction import Change, CorrectionError
from gateway.setup.reference import JointWatch, UnreferencedError, referenced, steered
from gateway.setup.words import positive_ways, zero_way
from gateway.types import SensorKind

LOOK_S = 1.0
HAND_S = 120.0
NOT_BY_HAND = "n"


def reference(
    file: OwnFile,
    yes: Yes = False,
    json: Annotated[bool, typer.Option("--json", help="Machine-readable result.")] = False,
) -> None:
    """Put each steered joint to its zero, and turn it by hand: its zero and direction go into the robot file.

    Nothing is energised. What is changed is shown, and written only after a yes; a copy of the file is kept. A joint
    whose encoder is not absolute has no zero that would last: it is told what is to be done at each start instead.
    """
    config, text = load(file)
    joints = steered(config)
    absolute = [motor for motor in joints if motor.encoder == "absolute"]
    for line in _words(config, joints):
        (errors if json else console).print(line, highlight=False, markup=False)
    try:
        with drafted(file, text):
            pass  # so that nobody turns joints for nothing
        for bus in dict.fromkeys(motor.bus for motor in absolute):
            look_for_bus(config, bus)
            refuse_where_commanded(bus_of(config, bus).interface, bus_of(config, bus).channel)
        changes = [change for motor in absolute for change in _put(config, motor)]
        kept = correct(file, text, changes, yes=yes) if absolute else None
    except (
        *(UnreferencedError, CorrectionError, RewriteError, NotAllowedError, AdapterError),
        KeyboardInterrupt,
    ) as error:
        refuse(error, json=json, unchanged=file)
    if absolute:
        errors.print("Cut the power of these joints once, and run this again: a zero that changes is no absolute one.")
    if json:
        rows = [change._asdict() for change in changes]
        encoders = {motor.name: motor.encoder for motor in joints}
        print_json({"ok": True, "joints": encoders, "changes": rows, "kept": kept and str(kept)})


def _words(config: RobotConfig, joints: tuple[Motor, ...]) -> list[str]:
    """Of what has no zero in the robot file, what is to be done instead."""
    lines = [
        f"{motor.name}: its encoder is incremental, and no zero of it lasts: after each start bring it to a known "
        f"angle and say `drivegate reference {config.robot.name} --motor {motor.name}`"
        for motor in joints
        if motor.encoder == "incremental"
    ]
    lines += [
        f"{sensor.name}: what it tells counts from where the preset of the sensor itself says, not the robot file"
        for sensor in config.sensor
        if sensor.kind is SensorKind.RANGE
    ]
    return lines if joints else [*lines, f"{config.robot.name} has no steered joint"]


def _put(config: RobotConfig, motor: Motor) -> list[Change]:
    """Raises UnreferencedError, NotAllowedError."""
    ask(f"{motor.name}: release it, turn it so that {zero_way(config, motor.name)}, hold it, and press Enter.")
    watch = JointWatch(config, motor)
    place = _place(config, motor)
    listen(place, LOOK_S, lambda frame: watch.take(frame._replace(bus=motor.bus)))
    stands = watch.stands()
    errors.print(f"{motor.name}: stands at {stands:.4f} rad by the robot file", highlight=False)
    return referenced(motor, stands, _turned(config, motor))


def _turned(config: RobotConfig, motor: Motor) -> float | None:
    """Rad at its shaft while it was turned positively; None: it cannot be turned by hand."""
    way = positive_ways(config.robot)[motor.name]
    skip = f"or {NOT_BY_HAND}: it cannot be turned by hand, and its direction stays"
    if ask(f"{motor.name}: press Enter, then turn it half a turn at most, so that {way}; {skip}.") == NOT_BY_HAND:
        return None
    watch = HandWatch({(motor.driver, motor.variant)})
    watch.begin(motor.gear_ratio)
    place = _place(config, motor)
    listen(place, HAND_S, lambda frame: watch.take([frame]), going_on=lambda: watch.turned() is None)
    turned = watch.turned()
    if turned is None:
        raise UnreferencedError(f"{motor.name}: no encoder told a turn of 0.5 rad within {HAND_S:g} s")
    if turned.others or turned.id != motor.id:
        others = ", ".join(turned.others) or f"{turned.driver} id {turned.id}"
        raise UnreferencedError(f"{motor.name}: {others} moved too, or alone: turn it alone; is its id right?")
    return turned.way


def _place(config: RobotConfig, motor: Motor) -> Place:
    bus = bus_of(config, motor.bus)
    return Place(bus.interface, bus.channel, bus.bitrate)

"""What can go wrong in the simulated world, one row per kind: what it concerns, its value, how it begins and ends.

Whatever names no motor or bus concerns all of them. A fault with `seconds` ends by itself; so does its end, `clear`.
"""

from collections.abc import Callable, Sequence
from enum import Enum
from math import inf
from typing import NamedTuple

from gateway.config import RobotConfig
from replay.sim.bus import SimulatedBus
from replay.sim.plants import plant_of
from replay.sim.sensors.sender import Sender

TWIN_ANGLE = 1.0  # rad at the output by which a twin's shaft stands elsewhere, unless told


class FaultKind(Enum):
    """Everything that the simulated world knows to break, and to mend."""

    POWER_OFF = "power_off"
    POWER_ON = "power_on"
    POWER_CYCLE = "power_cycle"
    CABLE_OUT = "cable_out"
    CABLE_IN = "cable_in"
    ENCODER_FROZEN = "encoder_frozen"
    ENCODER_JUMP = "encoder_jump"
    TORQUE_LOST = "torque_lost"
    TORQUE_INVERTED = "torque_inverted"
    BRAKE_WEAK = "brake_weak"
    ID_TWIN = "id_twin"
    BUS_DOWN = "bus_down"
    BUS_UP = "bus_up"
    FRAMES_LOST = "frames_lost"
    FRAMES_DELAYED = "frames_delayed"
    FRAMES_DOUBLED = "frames_doubled"
    PUSH = "push"
    SLOPE = "slope"
    IMPACT = "impact"
    FRICTION = "friction"
    MASS = "mass"
    SENSOR_SILENT = "sensor_silent"
    SENSOR_FROZEN = "sensor_frozen"
    SENSOR_STUCK = "sensor_stuck"
    SENSOR_JUMP = "sensor_jump"
    LOOP_PAUSE = "loop_pause"
    CLEAR = "clear"


class Target(Enum):
    """What a kind concerns."""

    MOTOR = "motor"
    WHEEL = "wheel"  # a motor that drives a wheel
    BUS = "bus"
    SENSOR = "sensor"  # one on a bus
    WORLD = "world"
    CASTER = "caster"  # of a plant that has one
    LOOP = "loop"


class Range(NamedTuple):
    """What a value may be."""

    low: float
    high: float
    words: str


class Broken(NamedTuple):
    """One thing to break or to mend: the motor, bus or sensor, how much, and a number that makes chance repeatable.

    `lasting`: its end is planned.
    """

    world: SimulatedBus
    name: str
    value: float = 0.0
    seed: int = 0
    lasting: bool = False


Change = Callable[[Broken], object]


class Rule(NamedTuple):
    """One row. `timed`: it cannot go without `seconds`; `default`: where no value is given."""

    target: Target
    begin: Change
    end: Change | None = None
    value: Range | None = None
    default: float | None = None
    timed: bool = False


def _power_off(broken: Broken) -> None:
    broken.world.robot.devices[broken.name].power_off()


def _power_on(broken: Broken) -> None:
    broken.world.robot.devices[broken.name].power_on()


def _power_cycle(broken: Broken) -> None:
    _power_off(broken)
    if not broken.lasting:
        _power_on(broken)


def _unplug(broken: Broken) -> None:
    broken.world.robot.devices[broken.name].unplug()


def _plug(broken: Broken) -> None:
    broken.world.robot.devices[broken.name].plug()


def _freeze(broken: Broken) -> None:
    broken.world.robot.devices[broken.name].freeze_encoder(True)


def _thaw(broken: Broken) -> None:
    broken.world.robot.devices[broken.name].freeze_encoder(False)


def _jump(broken: Broken) -> None:
    broken.world.robot.shift_encoder(broken.name, broken.value)


def _jump_back(broken: Broken) -> None:
    broken.world.robot.shift_encoder(broken.name, -broken.value)


def _gain(gain: float) -> Change:
    def change(broken: Broken) -> None:
        broken.world.robot.drivetrain(broken.name).gain = gain

    return change


def _weaken(broken: Broken) -> None:
    broken.world.robot.drivetrain(broken.name).braking = broken.value


def _strengthen(broken: Broken) -> None:
    broken.world.robot.drivetrain(broken.name).braking = 1.0


def _twin(broken: Broken) -> None:
    broken.world.add_twin(broken.name, broken.value)


def _no_twin(broken: Broken) -> None:
    broken.world.remove_twin(broken.name)


def _down(broken: Broken) -> None:
    broken.world.fail(broken.name)


def _up(broken: Broken) -> None:
    broken.world.restore(broken.name)


def _lose(broken: Broken) -> None:
    broken.world.drop(broken.name, received=broken.value, sent=broken.value, seed=broken.seed)


def _lose_none(broken: Broken) -> None:
    broken.world.drop(broken.name)


def _delay(broken: Broken) -> None:
    broken.world.delay(broken.name, broken.value)


def _delay_none(broken: Broken) -> None:
    broken.world.delay(broken.name, 0.0)


def _double(broken: Broken) -> None:
    broken.world.double(broken.name, broken.value, seed=broken.seed)


def _double_none(broken: Broken) -> None:
    broken.world.double(broken.name, 0.0)


def _push(broken: Broken) -> None:
    broken.world.robot.set_push(broken.value)


def _push_none(broken: Broken) -> None:
    broken.world.robot.set_push(0.0)


def _hit(broken: Broken) -> None:
    broken.world.robot.set_impact(broken.value)


def _let_go(broken: Broken) -> None:
    broken.world.robot.set_impact(0.0)


def _tilt(broken: Broken) -> None:
    broken.world.robot.set_slope(broken.value)


def _level(broken: Broken) -> None:
    broken.world.robot.set_slope(0.0)


def _ground(broken: Broken) -> None:
    broken.world.robot.set_friction(broken.name, broken.value)


def _good_ground(broken: Broken) -> None:
    broken.world.robot.set_friction(broken.name, inf)


def _load(broken: Broken) -> None:
    broken.world.robot.set_mass(broken.value)


def _unload(broken: Broken) -> None:
    broken.world.robot.set_mass(None)


def _sensor(change: Callable[[Sender], object]) -> Change:
    def changed(broken: Broken) -> None:
        change(broken.world.robot.sensors[broken.name])

    return changed


def _shift(broken: Broken) -> None:
    broken.world.robot.shift_sensor(broken.name, broken.value)


def _shift_back(broken: Broken) -> None:
    broken.world.robot.shift_sensor(broken.name, -broken.value)


def _nothing(_: Broken) -> None:
    """The world has no part in it: the loop does it."""


def _mend(broken: Broken) -> None:
    """Everything of one motor; with power and cable, so last what boots it."""
    device = broken.world.robot.devices[broken.name]
    broken.world.robot.mend(broken.name)
    broken.world.remove_twin(broken.name)
    device.plug()
    if not device.acknowledges:
        device.power_on()


_FRACTION = Range(0.0, 1.0, "a fraction, 0 to 1")

RULES: dict[FaultKind, Rule] = {
    FaultKind.POWER_OFF: Rule(Target.MOTOR, _power_off, _power_on),
    FaultKind.POWER_ON: Rule(Target.MOTOR, _power_on),
    FaultKind.POWER_CYCLE: Rule(Target.MOTOR, _power_cycle, _power_on),
    FaultKind.CABLE_OUT: Rule(Target.MOTOR, _unplug, _plug),
    FaultKind.CABLE_IN: Rule(Target.MOTOR, _plug),
    FaultKind.ENCODER_FROZEN: Rule(Target.MOTOR, _freeze, _thaw),
    FaultKind.ENCODER_JUMP: Rule(Target.MOTOR, _jump, _jump_back, Range(-1e3, 1e3, "rad at the output, -1000 to 1000")),
    FaultKind.TORQUE_LOST: Rule(Target.MOTOR, _gain(0.0), _gain(1.0)),
    FaultKind.TORQUE_INVERTED: Rule(Target.MOTOR, _gain(-1.0), _gain(1.0)),
    FaultKind.BRAKE_WEAK: Rule(
        Target.MOTOR, _weaken, _strengthen, Range(0.0, 1.0, "a factor on torque against the motion, 0 to 1")
    ),
    FaultKind.ID_TWIN: Rule(
        Target.MOTOR, _twin, _no_twin, Range(-1e3, 1e3, "rad at the output, -1000 to 1000"), default=TWIN_ANGLE
    ),
    FaultKind.BUS_DOWN: Rule(Target.BUS, _down, _up),
    FaultKind.BUS_UP: Rule(Target.BUS, _up),
    FaultKind.FRAMES_LOST: Rule(Target.BUS, _lose, _lose_none, _FRACTION),
    FaultKind.FRAMES_DELAYED: Rule(Target.BUS, _delay, _delay_none, Range(0.0, 10.0, "s, 0 to 10")),
    FaultKind.FRAMES_DOUBLED: Rule(Target.BUS, _double, _double_none, _FRACTION),
    FaultKind.PUSH: Rule(
        Target.WORLD, _push, _push_none, Range(-1e5, 1e5, "N along world x, -100000 to 100000"), timed=True
    ),
    FaultKind.IMPACT: Rule(
        Target.CASTER,
        _hit,
        _let_go,
        Range(-1e5, 1e5, "N at the caster's joint, to the left of the chassis, -100000 to 100000"),
        timed=True,
    ),
    FaultKind.SLOPE: Rule(Target.WORLD, _tilt, _level, Range(-0.7, 0.7, "rad, rising along world x, -0.7 to 0.7")),
    FaultKind.FRICTION: Rule(Target.WHEEL, _ground, _good_ground, Range(0.0, 10.0, "a friction coefficient, 0 to 10")),
    FaultKind.MASS: Rule(Target.WORLD, _load, _unload, Range(0.1, 5000.0, "kg in total, 0.1 to 5000")),
    FaultKind.SENSOR_SILENT: Rule(Target.SENSOR, _sensor(Sender.unplug), _sensor(Sender.plug)),
    FaultKind.SENSOR_FROZEN: Rule(
        Target.SENSOR, _sensor(lambda one: one.hang(True)), _sensor(lambda one: one.hang(False))
    ),
    FaultKind.SENSOR_STUCK: Rule(
        Target.SENSOR, _sensor(lambda one: one.stick(True)), _sensor(lambda one: one.stick(False))
    ),
    FaultKind.SENSOR_JUMP: Rule(
        Target.SENSOR, _shift, _shift_back, Range(-10.0, 10.0, "m or rad that it tells too much, -10 to 10")
    ),
    FaultKind.LOOP_PAUSE: Rule(Target.LOOP, _nothing, timed=True),
    FaultKind.CLEAR: Rule(Target.MOTOR, _mend),
}


def begin(
    kind: FaultKind, world: SimulatedBus, names: Sequence[str], value: float | None, *, seed: int, lasting: bool
) -> None:
    """Break it, for each of these motors, buses or sensors."""
    rule = RULES[kind]
    for name in names:
        rule.begin(Broken(world, name, _amount(rule, value), seed, lasting))


def end(kind: FaultKind, world: SimulatedBus, names: Sequence[str], value: float | None) -> None:
    """Its end by itself."""
    rule = RULES[kind]
    for name in names:
        if rule.end is not None:
            rule.end(Broken(world, name, _amount(rule, value)))


def _amount(rule: Rule, value: float | None) -> float:
    return value if value is not None else rule.default or 0.0


def clear_surroundings(world: SimulatedBus, buses: Sequence[str]) -> None:
    """What `clear` undoes besides the motors: buses, sensors and ground."""
    world.robot.mend_sensors()
    for name in buses:
        for change in (_up, _lose_none, _delay_none, _double_none):
            change(Broken(world, name))
    for change in (_push_none, _level, _unload, *((_let_go,) if world.robot.has_caster else ())):
        change(Broken(world, ""))


def concerned(
    kind: FaultKind, config: RobotConfig, *, motor: str | None, bus: str | None, sensor: str | None = None
) -> tuple[str, ...]:
    """Which motors, buses or sensors: the named one, or every one where none is named; a single "" for the rest."""
    match RULES[kind].target:
        case Target.MOTOR:
            return config.robot.motor_names() if motor is None else (motor,)
        case Target.WHEEL:
            return wheels(config) if motor is None else (motor,)
        case Target.BUS:
            return tuple(one.name for one in config.bus) if bus is None else (bus,)
        case Target.SENSOR:
            return sensors(config) if sensor is None else (sensor,)
    return ("",)


def sensors(config: RobotConfig) -> tuple[str, ...]:
    """Those on a bus."""
    return tuple(sensor.name for sensor in config.sensor if sensor.bus is not None)


def wheels(config: RobotConfig) -> tuple[str, ...]:
    """Motors that drive a wheel, in chassis order."""
    names = config.robot.motor_names()
    return tuple(names[joint] for joint in plant_of(config.robot).wheels)

"""From a robot file to the parts of the core: kinematics, drivers, transmissions, speed loops. Pure."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, NamedTuple, TypeVar

from drivers import DRIVERS
from drivers.checks import id_conflicts
from drivers.contract import Capabilities, Driver, IdUse, MotorSpec, ReceiveFilter, Traffic
from drivers.sensors import SENSORS, sensor_problem
from drivers.sensors.contract import SensorDriver, SensorSpec
from gateway.chassis.contract import Chassis, LawParts
from gateway.config import ConfigError, Motor, Parts, RobotConfig, Sensor
from gateway.control.decoupled import Decoupled, Saturation
from gateway.control.drive_law import DriveLaw, SpeedLaw
from gateway.control.grip import GripError
from gateway.control.launch import Pusher
from gateway.control.limits import TwistLimiter
from gateway.control.pendulum import BalanceError
from gateway.control.speed_loop import SpeedLoop
from gateway.control.transmission import Transmission, Winding
from gateway.control.wheel_limits import WheelLimits
from gateway.core.detectors import Limits
from gateway.core.settings import problems_of_file
from gateway.guess import guess
from gateway.kinematics.contract import GeometryError, Kinematics

_Made = TypeVar("_Made")
ORIGIN: Final = "robot file"  # who calls names the file where it knows which


class Group(NamedTuple):
    """One driver with the places of its motors in the chassis order."""

    bus: str
    driver: Driver
    indices: tuple[int, ...]


class Port(NamedTuple):
    """One sensor on a bus with its driver."""

    name: str
    bus: str
    driver: SensorDriver


class Robot(NamedTuple):
    """Everything built from a robot file; per-motor tuples are in chassis order."""

    names: tuple[str, ...]
    kinematics: Kinematics
    groups: tuple[Group, ...]
    transmissions: tuple[Transmission, ...]
    speed_loops: tuple[SpeedLoop | None, ...]
    capabilities: tuple[Capabilities, ...]  # what each joint may be told, with the help of its speed loop
    absolute: tuple[bool, ...]  # whether the encoder knows its angle after a power cut
    limits: tuple[Limits, ...]
    law: DriveLaw
    ports: tuple[Port, ...] = ()

    def receive_filters(self, bus: str) -> list[ReceiveFilter]:
        """At least every frame of this bus that somebody may take."""
        found = [wanted for group in self.groups if group.bus == bus for wanted in group.driver.receive_filters()]
        return found + [wanted for port in self.ports if port.bus == bus for wanted in port.driver.receive_filters()]

    def traffic(self, bus: str, *, loop_rate_hz: float) -> list[Traffic]:
        """Every cyclic frame of this bus."""
        groups = [group.driver.traffic(loop_rate_hz=loop_rate_hz) for group in self.groups if group.bus == bus]
        senders = {port.driver.ids()[0].id: port.driver for port in self.ports if port.bus == bus}  # each once
        return [item for told in (*groups, *[one.traffic() for one in senders.values()]) for item in told]


class Assembled(NamedTuple):
    """`robot`: as far as it can be built, None: not at all. `problems`: why it must not be driven with."""

    robot: Robot | None
    problems: tuple[str, ...]


def build(config: RobotConfig, origin: str = ORIGIN) -> Robot:
    """The parts of the robot. Raises ConfigError naming key, value and range of everything that is wrong."""
    robot, problems = assemble(config)
    if robot is None or problems:
        raise ConfigError(origin, problems)
    return robot


def assemble(config: RobotConfig) -> Assembled:
    """The same to be looked at: a robot that its own drive law refuses has plain wheel speeds in place of that."""
    motors = config.motors_in_order()
    problems = [f"settings: {one}" for one in problems_of_file(config.settings, config.limits.velocity)]
    kinematics = _made(partial(_kinematics, config.robot), problems)
    groups = _made(partial(_groups, config, motors), problems)
    if groups is None:
        return Assembled(None, tuple(problems))
    ports = _made(partial(_ports, config, groups), problems)
    able = _capabilities(groups)
    loops = _made(partial(_speed_loops, motors, able), problems)
    if kinematics is None or loops is None:
        return Assembled(None, tuple(problems))
    joints = tuple(map(_with_loop, able, loops))
    parts = _law_parts(config, kinematics, tuple(map(_pusher, motors, joints, loops)))
    law = _made(partial(_law, config, parts), problems)
    robot = Robot(
        names=tuple(motor.name for motor in motors),
        kinematics=kinematics,
        groups=groups,
        transmissions=tuple(map(_transmission, motors, able)),
        speed_loops=loops,
        capabilities=joints,
        absolute=tuple(motor.encoder == "absolute" for motor in motors),
        limits=tuple(Limits(config.limits.motor_speed[motor.name], motor.max_torque) for motor in motors),
        law=_plain_law(parts) if law is None else law,
        ports=() if ports is None else ports,
    )
    return Assembled(robot, tuple(problems))


def _kinematics(robot: Chassis) -> Kinematics:
    try:
        return robot.kinematics()
    except GeometryError as error:
        raise ConfigError("", [f"robot: {error}"]) from None


def _law(config: RobotConfig, parts: LawParts) -> DriveLaw:
    try:
        law = config.robot.law(parts)
    except GripError as lame:  # mypyc wants one kind of error by one name
        raise ConfigError("", [f"robot.grip: {lame}"]) from None
    except BalanceError as unfit:
        raise ConfigError("", [f"robot.balance: {unfit}"]) from None
    if config.stop.category == 0 and law.posture is None:
        raise ConfigError("", ["stop.category = 0: must be 1 or 2: only a robot that balances is let go at once"])
    return law


def _plain_law(parts: LawParts) -> DriveLaw:
    return SpeedLaw(parts.kinematics, top_speeds=parts.top_speeds, velocity=parts.velocity, period=parts.period)


def _made(make: Callable[[], _Made], problems: list[str]) -> _Made | None:
    """What comes of making it; None where that is refused, and then `problems` have the reasons."""
    try:
        return make()
    except ConfigError as error:
        problems += error.problems
        return None


def problems_of(parts: Parts) -> list[str]:
    """What is wrong with the sound parts of a robot file, each looked at by itself, whatever is wrong beside it."""
    velocity = None if parts.limits is None else parts.limits.velocity
    found = [f"settings: {one}" for one in problems_of_file(parts.settings or {}, velocity)]
    if parts.robot is not None:
        found += _tried(partial(_kinematics, parts.robot))
    rate = None if parts.loop is None else parts.loop.rate
    members: dict[tuple[str, str], list[Motor]] = {}
    for motor in parts.motors.sound:
        found += _no_driver(motor)
        members.setdefault((motor.bus, motor.driver), []).append(motor)
    if rate is not None:
        found += [one for (bus, name), motors in members.items() for one in _of_group(name, bus, motors, rate)]
    for sensor in parts.sensors.sound:
        if sensor.bus is not None:
            found += _tried(partial(_sensor_driver, sensor, sensor.bus))
    return found


def _no_driver(motor: Motor) -> list[str]:
    """What is wrong with the names of driver and variant."""
    if motor.driver not in DRIVERS:
        known = sorted(DRIVERS)
        words = f"unknown; there is {', '.join(known)}{guess(motor.driver, known)}"
        return [f"motor {motor.name}: driver = {motor.driver!r}: {words}"]
    variants = DRIVERS[motor.driver].variants
    if motor.variant in variants:
        return []
    words = f"driver {motor.driver} knows {', '.join(variants)}{guess(motor.variant, variants)}"
    return [f"motor {motor.name}: variant = {motor.variant!r}: {words}"]


def _of_group(name: str, bus: str, motors: Sequence[Motor], rate: float) -> list[str]:
    """What its driver says of each motor alone; of all together only where that is nothing."""
    known = [motor for motor in motors if not _no_driver(motor)]
    alone = [one for motor in known for one in _tried(partial(_driver, name, bus, [_spec(motor, rate)]))]
    if alone or not known:
        return alone
    return _tried(partial(_driver, name, bus, [_spec(motor, rate) for motor in known]))


def _tried(make: Callable[[], object]) -> list[str]:
    """The problems of making something; none where it can be made."""
    problems: list[str] = []
    _made(make, problems)
    return problems


def with_motors(robot: Robot, config: RobotConfig) -> Robot:
    """The same robot with the motors of this file, its drivers new. Raises ConfigError."""
    motors = config.motors_in_order()
    groups = _groups(config, motors)
    able = _capabilities(groups)
    loops = _speed_loops(motors, able)
    return robot._replace(
        groups=groups,
        transmissions=tuple(map(_transmission, motors, able)),
        speed_loops=loops,
        capabilities=tuple(map(_with_loop, able, loops)),
        limits=tuple(Limits(config.limits.motor_speed[motor.name], motor.max_torque) for motor in motors),
    )


def limiter(config: RobotConfig, robot: Robot) -> TwistLimiter:
    """Its setpoint, with the limits of wheels whose geometry no joint angle changes; other wheels are their law's."""
    axes, limits = robot.kinematics.axes, config.limits
    velocity, acceleration, jerk = (of.as_rates(axes) for of in (limits.velocity, limits.acceleration, limits.jerk))
    if robot.kinematics.steered:
        return TwistLimiter(velocity=velocity, acceleration=acceleration, jerk=jerk)
    given = limits.motor_acceleration
    wheels = WheelLimits(
        robot.kinematics.matrix(),
        speeds=tuple(motor.speed for motor in robot.limits),
        accelerations=() if given is None else tuple(given[name] for name in robot.names),
    )
    first = config.robot.saturation
    course = None
    if first is not Saturation.BOTH:
        course = Decoupled(first, velocity=velocity, acceleration=acceleration, jerk=jerk, wheels=wheels)
    return TwistLimiter(
        velocity=velocity,
        acceleration=acceleration,
        jerk=jerk,
        wheels=None if given is None else wheels,
        course=course,
    )


def feedback_delay(config: RobotConfig) -> float:
    """Oldest measurement that a cycle may have to do with, s."""
    return max((1.0 / motor.feedback_rate for motor in config.motor if motor.feedback_rate), default=0.0)


def _law_parts(config: RobotConfig, kinematics: Kinematics, pushers: tuple[Pusher, ...]) -> LawParts:
    names, limits = config.robot.motor_names(), config.limits
    accelerations = limits.motor_acceleration
    return LawParts(
        kinematics=kinematics,
        top_speeds=tuple(limits.motor_speed[name] for name in names),
        accelerations=None if accelerations is None else tuple(accelerations[name] for name in names),
        velocity=limits.velocity.as_rates(kinematics.axes),
        acceleration=limits.acceleration.as_rates(kinematics.axes),
        jerk=limits.jerk.as_rates(kinematics.axes),
        period=1.0 / config.loop.rate,
        delay=feedback_delay(config),
        pushers=pushers,
    )


def _pusher(motor: Motor, joint: Capabilities, loop: SpeedLoop | None) -> Pusher:
    """At the output. A voltage is for a motor whose speed control takes no torque besides."""
    given = motor.winding
    if given is None or not joint.voltage or joint.feed_forward:
        return Pusher(joint.feed_forward, joint.limit, hosted=loop is not None, torque=motor.max_torque)
    winding = Winding(given.resistance, given.back_emf * motor.gear_ratio)
    return Pusher(
        joint.feed_forward,
        joint.limit,
        hosted=loop is not None,
        torque=motor.max_torque,
        winding=winding,
        supply=given.voltage,
    )


def _groups(config: RobotConfig, motors: Sequence[Motor]) -> tuple[Group, ...]:
    members: dict[tuple[str, str], list[int]] = {}
    for index, motor in enumerate(motors):
        members.setdefault((motor.bus, motor.driver), []).append(index)
    rate = config.loop.rate
    groups = tuple(
        Group(bus, _driver(name, bus, [_spec(motors[index], rate) for index in indices]), tuple(indices))
        for (bus, name), indices in members.items()
    )
    conflicts = [
        f"bus {bus.name}: {conflict}"
        for bus in config.bus
        for conflict in id_conflicts([group.driver.ids() for group in groups if group.bus == bus.name])
    ]
    conflicts += [
        f"bus {bus.name}: fd = false: {item.name} is a CAN FD frame"
        for bus in config.bus
        if not bus.fd
        for group in groups
        if group.bus == bus.name
        for item in group.driver.traffic(loop_rate_hz=rate)
        if item.fd
    ]
    if conflicts:
        raise ConfigError(ORIGIN, conflicts)
    return groups


def _ports(config: RobotConfig, groups: Sequence[Group]) -> tuple[Port, ...]:
    """Every sensor on a bus; several drivers of one sensor hear the same frames."""
    ports: list[Port] = []
    users: dict[str, dict[tuple[str, int], Sequence[IdUse]]] = {bus.name: {} for bus in config.bus}
    for sensor in config.sensor:
        if sensor.bus is None or sensor.driver is None or sensor.id is None:
            continue
        port = Port(sensor.name, sensor.bus, _sensor_driver(sensor, sensor.bus))
        ports.append(port)
        users[sensor.bus].setdefault((sensor.driver, sensor.id), port.driver.ids())
    conflicts = _given_twice(config.sensor)
    for bus, found in users.items():
        motors = [group.driver.ids() for group in groups if group.bus == bus]
        conflicts += [f"bus {bus}: {conflict}" for conflict in id_conflicts([*motors, *found.values()])]
    if conflicts:
        raise ConfigError(ORIGIN, conflicts)
    return tuple(ports)


def _given_twice(sensors: Sequence[Sensor]) -> list[str]:
    """What tells several kinds is one sensor for each of them; nothing tells one kind twice."""
    first: dict[tuple[str | None, str | None, int | None, str], str] = {}
    return [
        f"sensor {sensor.name}: id = {sensor.id}: already the id of sensor {first[key]}"
        for sensor in sensors
        if sensor.bus is not None
        and first.setdefault(key := (sensor.bus, sensor.driver, sensor.id, sensor.kind.value), sensor.name)
        != sensor.name
    ]


def _sensor_driver(sensor: Sensor, bus: str) -> SensorDriver:
    """Raises ConfigError naming the sensor."""
    name, kind = str(sensor.driver), sensor.kind.value
    problem = sensor_problem(name, kind)
    if problem is not None:
        raise ConfigError(ORIGIN, [f"sensor {sensor.name}: {problem}"])
    try:
        return SENSORS[name].make(bus, SensorSpec(sensor.name, sensor.id or 0, kind, sensor.rate or 0.0))
    except ValueError as error:
        raise ConfigError(ORIGIN, [str(error)]) from None


def _driver(name: str, bus: str, motors: Sequence[MotorSpec]) -> Driver:
    if name not in DRIVERS:
        problem = f"motor {motors[0].name}: driver = {name!r}: unknown; there is {', '.join(sorted(DRIVERS))}"
        raise ConfigError(ORIGIN, [problem + guess(name, sorted(DRIVERS))])
    try:
        return DRIVERS[name](bus, motors)
    except ValueError as error:
        raise ConfigError(ORIGIN, [str(error)]) from None


def _spec(motor: Motor, command_rate: float) -> MotorSpec:
    """What the driver is told, at the motor shaft; the top speed has room above the limit for the speed controller."""
    gear = Transmission(motor.gear_ratio, 0.0)
    return MotorSpec(
        name=motor.name,
        id=motor.id,
        variant=motor.variant,
        max_speed=gear.motor_speed(motor.max_speed),
        max_torque=gear.motor_torque(motor.max_torque),
        max_current=motor.max_current,
        feedback_rate=motor.feedback_rate,
        command_rate=command_rate,
        watchdog_s=None if motor.watchdog is None else motor.watchdog.timeout,
        options=motor.options,
        supply=None if motor.winding is None else motor.winding.voltage,
    )


def _transmission(motor: Motor, able: Capabilities) -> Transmission:
    """With the windings of a motor that takes nothing but a voltage."""
    given = motor.winding
    alone = able.voltage and not (able.torque or able.velocity)
    winding = Winding(given.resistance, given.back_emf) if given is not None and alone else None
    return Transmission(motor.gear_ratio * motor.direction, motor.zero, winding)


def _speed_loop(motor: Motor) -> SpeedLoop | None:
    gains = motor.speed_loop
    return None if gains is None else SpeedLoop(kp=gains.kp, ki=gains.ki, max_torque=motor.max_torque)


def _speed_loops(motors: Sequence[Motor], able: Sequence[Capabilities]) -> tuple[SpeedLoop | None, ...]:
    """A host-side speed loop exactly where the controller has none of its own."""
    found = [(motor.name, _loop_problem(controller, motor)) for motor, controller in zip(motors, able, strict=True)]
    problems = [f"motor {name}: {problem}" for name, problem in found if problem is not None]
    if problems:
        raise ConfigError(ORIGIN, problems)
    return tuple(map(_speed_loop, motors))


def _loop_problem(able: Capabilities, motor: Motor) -> str | None:
    given = motor.speed_loop is not None
    if able.velocity:
        return "speed_loop has no use: its controller has one of its own" if given else None
    if able.torque:
        return None if given else "speed_loop is missing: its controller takes only torque"
    if able.voltage:
        return _voltage_problem(motor)
    return f"variant = {motor.variant!r}: its controller takes no speed, torque or voltage, so nothing here drives it"


def _voltage_problem(motor: Motor) -> str | None:
    """What is wrong with a motor that takes only a voltage: of its current its controller knows nothing."""
    if motor.speed_loop is None:
        return "speed_loop is missing: its controller takes only a voltage"
    if motor.winding is None:
        return "winding is missing: its controller takes only a voltage, and a torque is made one with its constants"
    most = motor.max_current * motor.winding.back_emf * motor.gear_ratio
    if motor.max_torque > most:
        return (
            f"max_torque = {motor.max_torque:g}: must be at most {most:.3g}: what max_current and winding.back_emf give"
        )
    return None


def _capabilities(groups: Sequence[Group]) -> tuple[Capabilities, ...]:
    """Of the controllers, in chassis order."""
    able = {
        index: controller
        for group in groups
        for index, controller in zip(group.indices, group.driver.capabilities, strict=True)
    }
    return tuple(able[index] for index in sorted(able))


def _with_loop(able: Capabilities, loop: SpeedLoop | None) -> Capabilities:
    """What the joint can that has this controller and this speed loop on the host, which knows torques."""
    if loop is None:
        return able
    return able._replace(velocity=True, torque=True, brake=True, feed_forward=True, limit=True)

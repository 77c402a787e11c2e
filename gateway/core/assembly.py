"""From a robot file to the parts of the core: kinematics, drivers, transmissions, speed loops. Pure."""

from collections.abc import Sequence
from typing import NamedTuple

from drivers import DRIVERS
from drivers.checks import id_conflicts
from drivers.contract import Driver, MotorSpec, Watchdog
from gateway.config import ConfigError, Motor, RobotConfig, WatchdogConfig
from gateway.control.drive_law import DriveLaw, SpeedLaw
from gateway.control.speed_loop import SpeedLoop
from gateway.control.transmission import Transmission
from gateway.core.detectors import Limits
from gateway.core.settings import problems
from gateway.kinematics import KINEMATICS
from gateway.kinematics.contract import GeometryError, Kinematics


class Group(NamedTuple):
    """One driver with the places of its motors in the chassis order."""

    bus: str
    driver: Driver
    indices: tuple[int, ...]


class Robot(NamedTuple):
    """Everything built from a robot file; per-motor tuples are in chassis order."""

    names: tuple[str, ...]
    kinematics: Kinematics
    groups: tuple[Group, ...]
    transmissions: tuple[Transmission, ...]
    speed_loops: tuple[SpeedLoop | None, ...]
    absolute: tuple[bool, ...]  # whether the encoder knows its angle after a power cut
    limits: tuple[Limits, ...]
    law: DriveLaw


def build(config: RobotConfig, origin: str = "robot file") -> Robot:
    """The parts of the robot. Raises ConfigError naming key, value and range."""
    wrong = [f"settings: {problem}" for problem in problems(config.settings)]
    if wrong:
        raise ConfigError(origin, wrong)
    motors = config.motors_in_order()
    try:
        kinematics = KINEMATICS[config.robot.kind](config.robot)
    except GeometryError as error:
        raise ConfigError(origin, [f"robot: {error}"]) from None
    groups = _groups(config, motors, origin)
    loops = _speed_loops(motors, groups, origin)
    return Robot(
        names=tuple(motor.name for motor in motors),
        kinematics=kinematics,
        groups=groups,
        transmissions=tuple(Transmission(motor.gear_ratio * motor.direction, motor.zero) for motor in motors),
        speed_loops=loops,
        absolute=tuple(motor.encoder == "absolute" for motor in motors),
        limits=tuple(Limits(config.limits.motor_speed[motor.name], motor.max_torque) for motor in motors),
        law=SpeedLaw(
            kinematics,
            top_speeds=[config.limits.motor_speed[motor.name] for motor in motors],
            velocity=config.limits.velocity.as_twist(),
            period=1.0 / config.loop.rate,
        ),
    )


def _groups(config: RobotConfig, motors: Sequence[Motor], origin: str) -> tuple[Group, ...]:
    members: dict[tuple[str, str], list[int]] = {}
    for index, motor in enumerate(motors):
        members.setdefault((motor.bus, motor.driver), []).append(index)
    rate = config.loop.rate
    groups = tuple(
        Group(bus, _driver(name, bus, [_spec(motors[index], rate) for index in indices], origin), tuple(indices))
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
        raise ConfigError(origin, conflicts)
    return groups


def _driver(name: str, bus: str, motors: Sequence[MotorSpec], origin: str) -> Driver:
    if name not in DRIVERS:
        problem = f"motor {motors[0].name}: driver = {name!r}: unknown; there is {', '.join(sorted(DRIVERS))}"
        raise ConfigError(origin, [problem])
    try:
        return DRIVERS[name](bus, motors)
    except ValueError as error:
        raise ConfigError(origin, [str(error)]) from None


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
        watchdog=None if motor.watchdog is None else _watchdog(motor.watchdog),
    )


def _watchdog(config: WatchdogConfig) -> Watchdog:
    return Watchdog(
        timeout_s=config.timeout,
        firmware=config.firmware,
        enable_endpoint=config.enable_endpoint,
        timeout_endpoint=config.timeout_endpoint,
    )


def _speed_loop(motor: Motor) -> SpeedLoop | None:
    gains = motor.speed_loop
    return None if gains is None else SpeedLoop(kp=gains.kp, ki=gains.ki, max_torque=motor.max_torque)


def _speed_loops(motors: Sequence[Motor], groups: Sequence[Group], origin: str) -> tuple[SpeedLoop | None, ...]:
    """A host-side speed loop exactly where the controller has none of its own."""
    needed = {index: not group.driver.capabilities.velocity for group in groups for index in group.indices}
    problems = []
    for index, motor in enumerate(motors):
        if needed[index] and motor.speed_loop is None:
            problems.append(f"motor {motor.name}: speed_loop is missing: its controller takes only torque")
        elif not needed[index] and motor.speed_loop is not None:
            problems.append(f"motor {motor.name}: speed_loop has no use: its controller has one of its own")
    if problems:
        raise ConfigError(origin, problems)
    return tuple(map(_speed_loop, motors))

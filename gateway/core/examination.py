"""What follows from a robot file, without touching any bus: geometry, top speeds, stopping, torque, bus load."""

import itertools
from collections.abc import Sequence
from math import fsum, pi, sqrt
from typing import Final, NamedTuple

from drivers.contract import Traffic
from gateway.arithmetic import sin_cos
from gateway.chassis.contract import LoopLimit
from gateway.config import Bus, ConfigError, Limits, Parts, RobotConfig, Sensor, survey
from gateway.control.launch import FRICTION
from gateway.control.limits import stopping_distance, stopping_time, turning_excess
from gateway.core.assembly import Robot, assemble, build, feedback_delay, problems_of
from gateway.kinematics.forces import PushTable, force_coupling
from gateway.kinematics.linear import condition, decompose, diagonal, product, pseudo_inverse, transpose
from gateway.types import Rates

LOAD_WARNING: Final = 0.70
LOAD_REFUSAL: Final = 0.95
STOPPING_REFUSAL_S: Final = 5.0  # a robot that needs longer from top speed is not under control; source: ours
# Of a speed error, that a speed loop may take back in one cycle: beyond 2 the error grows from cycle to cycle, up to 1
# it never changes its sign. Source: ours, half of what is stable.
LOOP_GAIN_REFUSAL: Final = 1.0
_HEADINGS: Final = 72  # joint angles at which the top speed of a steered chassis is looked for; directions of a push


_FD_TRAILER: Final = 13  # CRC delimiter, acknowledgement and its delimiter, end of frame (7), interframe space (3)
_FD_CHECKS: Final = ((16, 17, 6), (64, 21, 7))  # up to so many bytes of data: bits of the CRC, and the fixed stuff bits


class BusLoad(NamedTuple):
    """Worst-case share of the bus time that cyclic frames take."""

    bus: str
    bitrate: int
    load: float
    frames_per_second: float


class Sensing(NamedTuple):
    """One sensor, and how it is heard."""

    name: str
    kind: str
    by: str


class Push(NamedTuple):
    """How hard some of the motors can push without turning, in motors of which none is wasted (Rojas 2005, section 2).

    The direction of the least is in rad from forward to the left; what goes one way goes the other way too.
    """

    forward: float
    diagonal: float  # 45 degrees to the left
    sideways: float
    least: float
    least_direction: float


class Pushes(NamedTuple):
    """The same of all motors in every direction, and of all but one."""

    force: float  # N at the ground of one motor at its max_torque, the strongest
    directions: tuple[float, ...]  # rad from forward to the left
    motors: tuple[float, ...]  # in each of these
    every: Push
    without: dict[str, Push]  # by the motor that is lost


class Gripping(NamedTuple):
    """What floor and motors bear, at the friction of the robot file.

    `share`: of the acceleration limits, in the direction of least, turning included; `stopping_time_s` and
    `stopping_distance_m`: of a stop that is commanded, straight on from top speed, at most.
    """

    friction: float
    share: float
    stopping_time_s: float
    stopping_distance_m: float


class Examination(NamedTuple):
    """Everything `drivegate check` prints."""

    robot: str
    kind: str
    motors: int
    rank: int
    condition: float
    rate_hz: float
    axes: tuple[str, ...]  # the body's, in the order of the next two
    top_speeds: Rates  # what the motors allow for each axis alone, at the worst joint angle
    reachable: Rates  # the smaller of that and the configured limit
    stopping_time_s: float  # from top speed to rest, at most
    stopping_distance_m: float
    grip: Gripping | None  # None: launches and commanded stops do not go by the floor
    turning_share: float  # of all top speeds at once that can be driven: the rest would turn too fast for its speed
    torque_share: float  # of its torque that the most strained motor gives at the acceleration limits, all axes at once
    buses: tuple[BusLoad, ...]
    sensors: tuple[Sensing, ...]
    loop_limits: tuple[LoopLimit, ...]  # what is stable at top speed only with a loop that is fast enough
    effective_motors: Pushes | None  # None: they change with the angle of a joint
    warnings: tuple[str, ...]


def frame_bits(length: int, *, extended: bool) -> int:
    """Longest frame on the wire, interframe space included (Davis et al. 2007: 55 + 10 n, or 80 + 10 n)."""
    return (80 if extended else 55) + 10 * length


def fd_frame_bits(length: int, *, extended: bool) -> tuple[int, int]:
    """Longest CAN FD frame: bits at the rate of arbitration, and those behind the bit rate switch.

    Every fourth bit after the first may be a stuff bit, from the start of frame to the last of the data; counted from
    the frame format of ISO 11898-1:2015.
    """
    header, data = (36 if extended else 17), 1 + 4 + 8 * length  # to the switch; error state, length code, data
    stuffed = (header - 1) // 4
    crc, fixed = next((crc, fixed) for longest, crc, fixed in _FD_CHECKS if length <= longest)
    return header + stuffed + _FD_TRAILER, data + (header + data - 1) // 4 - stuffed + 4 + crc + fixed


def frame_time(item: Traffic, bus: Bus) -> float:
    """Longest time on the wire, s."""
    if not item.fd:
        return frame_bits(item.length, extended=item.extended) / bus.bitrate
    nominal, fast = fd_frame_bits(item.length, extended=item.extended)
    return nominal / bus.bitrate + fast / (bus.fd_bitrate if item.bit_rate_switch else bus.bitrate)


class Examined(NamedTuple):
    """`parts`: the sound ones of the file. `report`: None where the robot cannot be built; with `problems` (everything
    that is wrong, of every layer at once) it must not be driven with, whatever else the report says.
    """

    config: RobotConfig | None
    parts: Parts
    report: Examination | None
    problems: tuple[str, ...]


def examined(text: str, origin: str) -> Examined:
    """What can be said of the robot of a file. Raises ConfigError for what is no TOML."""
    found = survey(text, origin)
    problems = [*found.problems, *problems_of(found.parts)]
    limits = found.parts.limits
    if found.config is None:
        problems += _late_stops(limits) if limits is not None and _alike(limits) else []
        return Examined(None, found.parts, None, tuple(dict.fromkeys(problems)))
    report, more = _examined(found.config)
    return Examined(found.config, found.parts, report, tuple(dict.fromkeys([*problems, *more])))


def examine_text(text: str, origin: str) -> tuple[RobotConfig, Examination]:
    """The robot of a file and its report. Raises ConfigError with everything that is wrong, of every layer at once."""
    config, _, report, problems = examined(text, origin)
    if config is None or report is None or problems:
        raise ConfigError(origin, problems)
    return config, report


def examine(config: RobotConfig, origin: str) -> Examination:
    """The report. Raises ConfigError for a robot that cannot be driven or a bus beyond LOAD_REFUSAL."""
    report, problems = _examined(config)
    if report is None or problems:
        raise ConfigError(origin, problems)
    return report


def _examined(config: RobotConfig) -> tuple[Examination | None, list[str]]:
    """The report of a robot as far as it can be built, and everything that it must not be driven with for."""
    robot, refused = assemble(config)
    if robot is None:
        return None, [*refused, *_late_stops(config.limits)]
    matrix = robot.kinematics.matrix()
    top = _top_speeds(robot)
    limit = config.limits.velocity.as_rates(config.robot.AXES)
    buses = tuple(_bus_load(config, robot, bus) for bus in config.bus)
    problems = list(refused)
    problems += [
        f"bus {bus.bus}: load {bus.load:.0%} at {config.loop.rate:g} Hz; allowed up to {LOAD_REFUSAL:.0%}"
        for bus in buses
        if bus.load > LOAD_REFUSAL
    ]
    stop_s, stop_m = _stop(config.limits)
    problems += _late_stops(config.limits)
    grip = _gripping(config, robot)
    if grip is not None and grip.stopping_time_s > STOPPING_REFUSAL_S:
        problems.append(
            f"robot.grip.friction = {grip.friction:g}: a commanded stop from top speed takes "
            f"{grip.stopping_time_s:.1f} s and {grip.stopping_distance_m:.1f} m; allowed up to "
            f"{STOPPING_REFUSAL_S:g} s: lower limits.velocity"
        )
    problems += _wild_loops(config, robot)
    spare = _spare_torques(config, robot)
    problems += [f"{words} nothing" for words, left, _ in spare if left <= 0.0]
    loop_limits = config.robot.loop_limits(max(limit[0], limit[1]), delay=feedback_delay(config))
    problems += [
        f"loop.rate = {config.loop.rate:g} Hz: too slow for {one.name} at limits.velocity: {one.needed}"
        for one in loop_limits
        if one.used and 1.0 / config.loop.rate > one.period
    ]
    strained, torque_share = _torque_share(config, robot)
    report = Examination(
        robot=config.robot.name,
        kind=config.robot.kind,
        motors=len(robot.names),
        rank=decompose(matrix).rank,
        condition=condition(matrix),
        rate_hz=config.loop.rate,
        axes=config.robot.AXES,
        top_speeds=top,
        reachable=tuple(min(axis) for axis in zip(top, limit, strict=True)),
        stopping_time_s=stop_s,
        stopping_distance_m=stop_m,
        grip=grip,
        turning_share=1.0
        / sqrt(max(1.0, turning_excess(limit, config.limits.acceleration.as_rates(config.robot.AXES)))),
        torque_share=torque_share,
        buses=buses,
        sensors=tuple(map(_sensing, config.sensor)),
        loop_limits=loop_limits,
        effective_motors=None if robot.kinematics.steered else _pushes(robot),
        warnings=tuple(
            _warnings(
                config=config,
                robot=robot,
                buses=buses,
                top=top,
                limit=limit,
                loop_limits=loop_limits,
                strain=(strained, torque_share),
                spare=spare,
            )
        ),
    )
    return report, problems


def _gripping(config: RobotConfig, robot: Robot) -> Gripping | None:
    ground = robot.law.ground(whole=True) if robot.law.features.grip else None
    if ground is None:
        return None
    still = (0.0,) * len(robot.kinematics.axes)
    stopping = config.limits.as_stopping()
    limits = stopping["acceleration"]
    ways = [(0.0, 0.0, turn) for turn in (1.0, -1.0)]
    ways += [(c, s, 0.0) for s, c in (sin_cos(2.0 * pi * step / _HEADINGS) for step in range(_HEADINGS))]
    share = min(ground.effort(still, tuple([p * limit for p, limit in zip(way, limits)]), still) for way in ways)
    stopping["acceleration"] = tuple([share * limit for limit in limits])
    friction = robot.law.settings[FRICTION]
    return Gripping(friction, share, stopping_time(**stopping), stopping_distance(**stopping))


def _top_speeds(robot: Robot) -> Rates:
    """For each axis alone, the speed at which the first motor reaches its limit, at the worst joint angle."""
    return tuple(min(_top_speed(robot, axis, turn) for turn in _turns(robot)) for axis in _units(robot))


def _units(robot: Robot) -> list[Rates]:
    """One of each axis alone."""
    axes = robot.kinematics.axes
    return [tuple(1.0 if place == axis else 0.0 for place in range(len(axes))) for axis in range(len(axes))]


def _top_speed(robot: Robot, axis: Rates, turn: float) -> float:
    speeds = _wheel_speeds(robot, axis, turn)
    return min(
        limits.speed / abs(speed) for speed, limits in zip(speeds, robot.limits, strict=True) if abs(speed) > 1e-9
    )


def _turns(robot: Robot) -> list[float]:
    """The joint angles to look at, rad."""
    return [2.0 * pi * step / _HEADINGS for step in range(_HEADINGS)] if robot.kinematics.steered else [0.0]


def _wheel_speeds(robot: Robot, rates: Rates, turn: float) -> list[float]:
    """Rad/s of every motor with the steered joints at this angle."""
    positions: list[float | None] = [turn if i in robot.kinematics.steered else 0.0 for i in range(len(robot.names))]
    return robot.kinematics.wheel_speeds(rates, positions) or []


def _pushes(robot: Robot) -> Pushes:
    table = PushTable(robot.kinematics.matrix(), [limits.torque for limits in robot.limits])
    every = (True,) * len(robot.names)
    directions = tuple(2.0 * pi * step / _HEADINGS for step in range(_HEADINGS))
    return Pushes(
        force=table.unit,
        directions=directions,
        motors=tuple(table.along(direction, every) for direction in directions),
        every=_push(table, every),
        without={
            name: _push(table, [other != place for other in range(len(robot.names))])
            for place, name in enumerate(robot.names)
        },
    )


def _push(table: PushTable, usable: Sequence[bool]) -> Push:
    forward, diagonal, sideways = (table.along(direction, usable) for direction in (0.0, pi / 4.0, pi / 2.0))
    return Push(forward, diagonal, sideways, *table.least(usable))


def _stop(limits: Limits) -> tuple[float, float]:
    """From top speed to rest: s and m, at most."""
    stopping = limits.as_stopping()
    late = limits.motors_stop()  # where the motors follow slowly they are later than the setpoint at rest
    vx, vy, _ = limits.velocity.as_twist()
    return stopping_time(**stopping) + late, stopping_distance(**stopping) + sqrt(vx * vx + vy * vy) * late


def _alike(limits: Limits) -> bool:
    """Whether all of them are of the same axes and motors, as they are in a file that is right."""
    axes = limits.velocity.named()
    motors = limits.motor_acceleration or {}
    return all(of.named() == axes for of in limits.axes().values()) and motors.keys() <= limits.motor_speed.keys()


def _late_stops(limits: Limits) -> list[str]:
    """That a stop takes too long, and what would make it shorter."""
    seconds, metres = _stop(limits)
    if seconds <= STOPPING_REFUSAL_S:
        return []
    late = limits.motors_stop()
    return [
        f"limits: a stop from top speed takes {seconds:.1f} s and {metres:.1f} m; allowed up to "
        f"{STOPPING_REFUSAL_S:g} s: {_sooner(limits)}"
        + (f"; the motors alone need {late:.1f} s of it: raise limits.motor_acceleration" if late else "")
    ]


def _sooner(limits: Limits) -> str:
    """What lets the axis stop sooner that takes longest: to brake harder, or to get to it (and out of it) faster."""
    axes = limits.velocity.named()
    rates = [of.as_rates(axes) for of in limits.axes().values()]
    times = [
        (velocity / acceleration, acceleration / jerk) for velocity, acceleration, jerk in zip(*rates, strict=True)
    ]
    braking, growing = max(times, key=lambda pair: pair[0] + pair[1])
    axis = axes[times.index((braking, growing))]
    if growing > braking:
        return f"raise limits.jerk.{axis}, or lower limits.acceleration.{axis}"
    return f"raise limits.acceleration.{axis}, or lower limits.velocity.{axis}"


def _torque_share(config: RobotConfig, robot: Robot) -> tuple[str, float]:
    """The motor that the acceleration limits strain most, all axes at once, and the share of its torque.

    The torques are those of least norm; dry friction and that of half top speed come on top. The inertia of a chassis
    below its joint is left out.
    """
    body, limits = config.robot.body, config.limits.acceleration.as_rates(config.robot.AXES)
    masses = diagonal(config.robot.masses())
    accelerations = tuple(itertools.product(*((-limit, limit) for limit in limits)))
    worst = ("", 0.0)
    for turn in _turns(robot):
        coupling = force_coupling(
            transpose(tuple(tuple(_wheel_speeds(robot, axis, turn)) for axis in _units(robot))), masses
        )
        torques = [max(map(abs, row)) for row in product(pseudo_inverse(coupling), transpose(accelerations))]
        for name, torque, motor in zip(robot.names, torques, robot.limits, strict=True):
            share = (torque + body.joint_drag + body.joint_friction * motor.speed / 2.0) / motor.torque
            worst = max(worst, (name, share), key=lambda one: one[1])
    return worst


def _wild_loops(config: RobotConfig, robot: Robot) -> list[str]:
    """Speed loops that correct too much at once: with torque = kp error, error' = (1 - kp mobility / rate) error."""
    mobility = max(_mobility(config, robot, turn) for turn in _turns(robot))
    return [
        f"motor {motor.name}: speed_loop.kp = {motor.speed_loop.kp:g}: takes back {gain:.0%} of a speed error in one "
        f"cycle of loop.rate = {config.loop.rate:g} Hz; allowed up to {LOOP_GAIN_REFUSAL:.0%}, beyond 200% it swings "
        f"without end: kp up to {0.995 * motor.speed_loop.kp * LOOP_GAIN_REFUSAL / gain:.3g}, or raise loop.rate (what "
        "the wheel has to move follows from body.mass, body.inertia, body.joint_inertia and the geometry: "
        f"{config.robot.GEOMETRY})"
        for motor in config.motors_in_order()
        if motor.speed_loop is not None
        and (gain := motor.speed_loop.kp * mobility / config.loop.rate) > LOOP_GAIN_REFUSAL
    ]


def _spare_torques(config: RobotConfig, robot: Robot) -> list[tuple[str, float, float]]:
    """Of each motor that is told voltages: words, the N m that its supply leaves at its top speed, and max_torque."""
    found = []
    for motor, gear in zip(config.motors_in_order(), robot.transmissions, strict=True):
        if gear.winding is None or motor.winding is None:
            continue
        speed = config.limits.motor_speed[motor.name]
        needed = gear.winding.voltage(0.0, speed * motor.gear_ratio)
        left = (motor.winding.voltage - needed) / gear.winding.volts_per_torque * motor.gear_ratio
        words = (
            f"motor {motor.name}: at limits.motor_speed = {speed:g} rad/s winding.back_emf takes {needed:.3g} of "
            f"winding.voltage = {motor.winding.voltage:g} V, which leaves"
        )
        found.append((words, left, motor.max_torque))
    return found


def _mobility(config: RobotConfig, robot: Robot, turn: float) -> float:
    """Rad/s^2 per N m with which wheels give way at most, all of them on the ground: the lightest way to move."""
    lightest = 1.0 / _ways(config, robot, turn)[0]
    return 1.0 / (lightest + config.robot.body.joint_inertia)


def carried_inertia(config: RobotConfig) -> float:
    """Kg m^2 that a wheel on the ground carries of the robot, without its own, where all move it the heaviest way."""
    robot = build(config)
    return max(1.0 / _ways(config, robot, turn)[-1] for turn in _turns(robot))


def _ways(config: RobotConfig, robot: Robot, turn: float) -> list[float]:
    """Rad/s^2 per N m of the ways in which wheels can move the robot together, massless themselves, the most first."""
    scales = [1.0 / sqrt(mass) for mass in config.robot.masses()]
    columns = [
        [speed * scale for speed in _wheel_speeds(robot, axis, turn)]
        for axis, scale in zip(_units(robot), scales, strict=True)
    ]
    found = decompose(tuple(zip(*columns, strict=True)))
    return [value * value for value in found.values[: found.rank]]


def _bus_load(config: RobotConfig, robot: Robot, bus: Bus) -> BusLoad:
    traffic = robot.traffic(bus.name, loop_rate_hz=config.loop.rate)
    load = fsum(item.rate_hz * frame_time(item, bus) for item in traffic)
    return BusLoad(bus.name, bus.bitrate, load, fsum(item.rate_hz for item in traffic))


def _sensing(sensor: Sensor) -> Sensing:
    if sensor.bus is None:
        return Sensing(sensor.name, sensor.kind.value, "Zenoh")
    by = f"{sensor.bus}, {sensor.driver} 0x{sensor.id:X}, {sensor.rate:g} Hz"
    return Sensing(sensor.name, sensor.kind.value, by)


def _warnings(
    *,
    config: RobotConfig,
    robot: Robot,
    buses: tuple[BusLoad, ...],
    top: Rates,
    limit: Rates,
    loop_limits: tuple[LoopLimit, ...],
    strain: tuple[str, float],
    spare: list[tuple[str, float, float]],
) -> list[str]:
    found = [
        f"bus {bus.bus}: load {bus.load:.0%}; stay below {LOAD_WARNING:.0%}" for bus in buses if bus.load > LOAD_WARNING
    ]
    found += [
        f"limits.velocity.{name} = {wanted:g} is beyond the motors: {possible:.3g} at the worst joint angle"
        for name, wanted, possible in zip(config.robot.AXES, limit, top, strict=True)
        if wanted > possible
    ]
    name, share = strain
    if share > 1.0:
        found.append(
            f"limits.acceleration, all axes at once, asks {share:.0%} of the torque of motor {name}: "
            "such twists are held back as far as the motors follow"
        )
    found += config.robot.doubts()
    found += [f"{words} {left:.3g} N m of max_torque = {most:g}" for words, left, most in spare if left < most]
    found += [
        f"loop.rate = {config.loop.rate:g} Hz is too slow for {one.name}: {one.needed}"
        for one in loop_limits
        if not one.used and 1.0 / config.loop.rate > one.period
    ]
    found += [
        f"motor {motor.name}: no watchdog in the controller: {motor.watchdog_waiver}"
        for motor in config.motor
        if motor.watchdog_waiver is not None
    ]
    return [*found, *_unguarded(robot)]


def _unguarded(robot: Robot) -> list[str]:
    """Controllers that cannot be seen to stop by themselves."""
    names = [name for name, able in zip(robot.names, robot.capabilities, strict=True) if not able.device_watchdog]
    if not names:
        return []
    return [
        f"{', '.join(names)}: may hold the last command when a cable is cut or this computer dies, and no software "
        "ends that: a relay in the supply of the motors does"
    ]

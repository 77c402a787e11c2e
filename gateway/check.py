"""What follows from a robot file, without touching any bus: geometry, top speeds, bus load, sampling limits."""

from math import log, pi
from typing import NamedTuple

import numpy as np

from drivers.interface import Traffic
from gateway.config import ConfigError, OffsetDifferentialRobot, RobotConfig
from gateway.robot import Robot, build
from gateway.types import Twist

LOAD_WARNING = 0.70
LOAD_REFUSAL = 0.95
COMPENSATION_GAIN = 2.0  # k of the pull-region compensation: mirror-image decay (preprints202312.1327, Eq. 23)
_HEADINGS = 72  # joint angles at which the top speed of a steered chassis is looked for


class BusLoad(NamedTuple):
    """Worst-case share of the bus time that cyclic frames take."""

    bus: str
    bitrate: int
    load: float
    frames_per_second: float


class Report(NamedTuple):
    """Everything `drivegate check` prints."""

    robot: str
    kind: str
    motors: int
    rank: int
    condition: float
    rate_hz: float
    top_speeds: Twist  # what the motors allow for each axis alone, at the worst joint angle
    reachable: Twist  # the smaller of that and the configured limit
    buses: tuple[BusLoad, ...]
    compensation_period_limit_s: float | None  # longest loop period at which compensation is stable at top speed
    warnings: tuple[str, ...]


def frame_bits(length: int, *, extended: bool) -> int:
    """Longest frame on the wire, interframe space included (Davis et al. 2007: 55 + 10 n, or 80 + 10 n)."""
    return (80 if extended else 55) + 10 * length


def examine(config: RobotConfig, origin: str) -> Report:
    """The report. Raises ConfigError for a robot that cannot be driven or a bus beyond LOAD_REFUSAL."""
    robot = build(config, origin)
    matrix = robot.kinematics.matrix()
    top = _top_speeds(robot)
    limit = config.limits.velocity.as_twist()
    buses = tuple(_bus_load(config, robot, bus.name, bus.bitrate) for bus in config.bus)
    overloaded = [
        f"bus {bus.bus}: load {bus.load:.0%} at {config.loop.rate:g} Hz; allowed up to {LOAD_REFUSAL:.0%}"
        for bus in buses
        if bus.load > LOAD_REFUSAL
    ]
    if overloaded:
        raise ConfigError(origin, overloaded)
    period_limit = _compensation_limit(config, limit)
    return Report(
        robot=config.robot.name,
        kind=config.robot.kind,
        motors=len(robot.names),
        rank=int(np.linalg.matrix_rank(matrix)),
        condition=float(np.linalg.cond(matrix)),
        rate_hz=config.loop.rate,
        top_speeds=top,
        reachable=Twist(*(min(axis) for axis in zip(top, limit, strict=True))),
        buses=buses,
        compensation_period_limit_s=period_limit,
        warnings=tuple(_warnings(config, buses, top, limit, period_limit)),
    )


def _top_speeds(robot: Robot) -> Twist:
    """For each axis alone, the speed at which the first motor reaches its limit, at the worst joint angle."""
    turns = [2.0 * pi * step / _HEADINGS for step in range(_HEADINGS)] if robot.kinematics.steered else [0.0]
    unit = (Twist(1.0, 0.0, 0.0), Twist(0.0, 1.0, 0.0), Twist(0.0, 0.0, 1.0))
    return Twist(*(min(_top_speed(robot, axis, turn) for turn in turns) for axis in unit))


def _top_speed(robot: Robot, axis: Twist, turn: float) -> float:
    positions: list[float | None] = [turn if i in robot.kinematics.steered else 0.0 for i in range(len(robot.names))]
    speeds = robot.kinematics.wheel_speeds(axis, positions) or []
    return min(
        limits.speed / abs(speed) for speed, limits in zip(speeds, robot.limits, strict=True) if abs(speed) > 1e-9
    )


def _bus_load(config: RobotConfig, robot: Robot, bus: str, bitrate: int) -> BusLoad:
    traffic: list[Traffic] = []
    for group in robot.groups:
        if group.bus == bus:
            traffic += group.driver.traffic(loop_rate_hz=config.loop.rate)
    bits = sum(item.rate_hz * frame_bits(item.length, extended=item.extended) for item in traffic)
    return BusLoad(bus, bitrate, bits / bitrate, sum(item.rate_hz for item in traffic))


def _compensation_limit(config: RobotConfig, limit: Twist) -> float | None:
    """h < ln(1 + 2/(k - 1)) d1 / c: beyond it the sampled compensation oscillates (science 1.4, e^a < 3 for k = 2)."""
    if not isinstance(config.robot, OffsetDifferentialRobot):
        return None
    speed = max(limit.vx, limit.vy)
    return log(1.0 + 2.0 / (COMPENSATION_GAIN - 1.0)) * config.robot.axle_offset / speed


def _warnings(
    config: RobotConfig, buses: tuple[BusLoad, ...], top: Twist, limit: Twist, period_limit: float | None
) -> list[str]:
    found = [
        f"bus {bus.bus}: load {bus.load:.0%}; stay below {LOAD_WARNING:.0%}" for bus in buses if bus.load > LOAD_WARNING
    ]
    found += [
        f"limits.velocity.{name} = {wanted:g} is beyond the motors: {possible:.3g} at the worst joint angle"
        for name, wanted, possible in zip(Twist._fields, limit, top, strict=True)
        if wanted > possible
    ]
    if period_limit is not None and 1.0 / config.loop.rate > period_limit:
        found.append(f"loop.rate = {config.loop.rate:g} Hz is too slow for compensation: {1 / period_limit:.1f} Hz")
    found += [
        f"motor {motor.name}: no watchdog in the controller: {motor.watchdog_waiver}"
        for motor in config.motor
        if motor.watchdog_waiver is not None
    ]
    return found

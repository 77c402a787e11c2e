"""A motor of an omni robot that dies at full speed: in each direction, each motor, each way of dying; in virtual time.

What is told of each drive is the truth of the simulated world, and of the commands what the core says it sent.
Bounds are what the dead wheel can do:
- seen: silence counts from 50 ms on; a position that stands for three samples; a lost torque once its memory is full of
  it (0.2 s, as measured: at most 0.188 s);
- spin: at worst a frozen wheel is driven with all of 4.5 N m for 20 ms, 2.6 rad/s per rad/s of turning, 1.03 kg m^2:
  0.23 rad/s (measured 0.11); else 1.2 N m, twice a wheel's friction at full speed, that the speed loops of the other
  three (each 3.5 N m s/rad) hold against: 0.045 rad/s and their overshoot (measured 0.053);
- the turn that is left is not taken back, nobody measures it against the floor: 0.1 rad/s for 0.4 s, 2 degrees
  (measured 1.2), and 2 m/s for 2 s along it: 0.14 m (measured 0.076).
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from math import atan2, cos, degrees, pi, remainder, sin, tau
from typing import Any, NamedTuple

from gateway.config import RobotConfig
from gateway.core.assembly import build
from gateway.kinematics.contract import desaturate
from gateway.types import Mode, Twist
from replay.drive.moment import Moment
from replay.drive.scenario import run_scenario
from replay.drive.scenario_file import Scenario

DIRECTIONS = tuple(45.0 * eighth for eighth in range(8))  # degrees from forward, counter-clockwise
WAYS = ("power_off", "cable_out", "encoder_frozen", "torque_lost")
START_S, LOSS_S, WATCHED_S, BRAKED_S = 0.6, 2.6, 2.0, 1.5
SLOW = 0.3  # m/s; below it a heading says little


class Death(NamedTuple):
    """One drive: direction in degrees, motor, and the fault of the scenario; `turning`: rad/s besides."""

    direction: float
    motor: str
    way: str
    turning: float = 0.0


class Found(NamedTuple):
    """What came of it, from the loss on for 2 s of the same command, and then while it brakes (`seconds` only)."""

    death: Death
    seconds: float | None  # until it is seen; None: not before the robot rests
    mode: Mode  # that follows then
    blamed: tuple[str, ...]  # motors, in the order in which faults were told
    heading: float  # degrees between the true way and the commanded one
    offset: float  # m beside the line that it was on
    spin: float  # rad/s of turning that nobody asked for
    turned: float  # degrees, by that
    slowest: float  # of the speed before: what is left of it at worst
    asked: bool  # whether its wheel is to turn: of one that is to stand, motor and encoder are not missed
    step: float  # of a wheel command from cycle to cycle, in units of what the acceleration limits ask of that wheel


class Bounds(NamedTuple):
    """What of `Found` may be at most; `slowest` at least."""

    seconds: float
    spin: float
    heading: float = 2.0
    turned: float = 2.0
    offset: float = 0.14
    slowest: float = 0.95
    step: float = 1.0 + 1e-6


BOUNDS = {
    "omni4": {
        "power_off": Bounds(0.056, 0.1),
        "cable_out": Bounds(0.056, 0.1),
        "encoder_frozen": Bounds(0.02, 0.23),
        "torque_lost": Bounds(0.25, 0.1),
    },
    # Released it drags with 0.06 N m per rad/s, which the other three at speed have not got to spare: what it then does
    # is told and held to nothing. A motor whose torque is lost drags nothing.
    "omni4_gm6020": {"torque_lost": Bounds(0.25, 0.1, heading=4.0, turned=4.0)},
}


def missed(found: Found, bounds: Bounds) -> list[str]:
    """What is not as it has to be."""
    most = [name for name in Bounds._fields if name != "slowest"]
    beyond = [name for name in most if not (getattr(found, name) or 0.0) <= getattr(bounds, name)]
    seen = found.seconds is not None
    wrong = {
        "not seen": not seen and found.asked,
        "slowest": found.slowest < bounds.slowest,
        "mode": found.mode is not (Mode.DEGRADED if seen else Mode.DRIVE),
        "blamed": found.blamed != ((found.death.motor,) if seen else ()),
    }
    return beyond + [name for name, so in wrong.items() if so]


def deaths(config: RobotConfig) -> Iterator[Death]:
    """All of them."""
    for direction, motor, way in product(DIRECTIONS, config.robot.motor_names(), WAYS):
        yield Death(direction, motor, way)


def full_speed(config: RobotConfig, direction: float, turning: float = 0.0) -> Twist:
    """The fastest twist this way that neither the limits of the body nor a wheel shortens."""
    robot, velocity = build(config), config.limits.velocity
    along, across = cos(direction * pi / 180.0), sin(direction * pi / 180.0)
    speed = min(limit / abs(part) for limit, part in ((velocity.vx, along), (velocity.vy, across)) if abs(part) > 1e-9)
    twist = Twist(speed * along, speed * across, turning)
    wheels = robot.kinematics.wheel_speeds(twist, ()) or []
    share = desaturate(wheels, [limits.speed for limits in robot.limits])
    return Twist(*[part * share for part in twist])


def drive(config: RobotConfig, death: Death, *more: dict[str, Any]) -> Found:
    """This drive. `more`: entries of its scenario besides, as a slope."""
    return measured(config, death, driven(config, death, *more))


def driven(config: RobotConfig, death: Death, *more: dict[str, Any]) -> list[Moment]:
    """Every cycle of it."""
    twist = full_speed(config, death.direction, death.turning)
    end = LOSS_S + WATCHED_S
    at = [
        _command(0.3, Twist(0.0, 0.0, 0.0)),
        _command(START_S, twist),
        {"t": LOSS_S, "fault": {"kind": death.way, "motor": death.motor}},
        _command(end, Twist(0.0, 0.0, 0.0)),
        *more,
    ]
    script = {"robot": config.robot.name, "seconds": end + BRAKED_S, "seed": 1, "at": at}
    moments: list[Moment] = []
    run_scenario(Scenario.model_validate(script), config, watch=moments.append)
    return moments


def measured(config: RobotConfig, death: Death, moments: Sequence[Moment]) -> Found:
    """What the drive shows."""
    after = [one for one in moments if one.t >= LOSS_S]
    watched = [one for one in after if one.t < LOSS_S + WATCHED_S]
    if after[0].outputs.mode is not Mode.DRIVE:
        raise ValueError(f"{death}: it does not drive when the motor dies: {after[0].outputs.mode}")
    first = next((one for one in after if one.outputs.mode not in (Mode.DRIVE, Mode.IDLE)), None)
    faults = [event.text for one in after for event in one.outputs.events if event.code.startswith("fault_")]
    start, way = watched[0].truth.pose, _way(watched[0])
    asked = death.turning
    headings = [remainder(_way(one) - way, tau) for one in watched if one.speed > SLOW]
    return Found(
        death=death,
        seconds=None if first is None else first.t - LOSS_S,
        mode=after[0].outputs.mode if first is None else first.outputs.mode,
        blamed=tuple(dict.fromkeys(text.partition(":")[0] for text in faults)),
        heading=0.0 if asked else degrees(max(map(abs, headings))),
        offset=0.0 if asked else max(abs(_beside(start.x, start.y, way, one)) for one in watched),
        spin=max(abs(one.truth.twist.wz) - abs(asked) for one in watched),
        turned=0.0 if asked else degrees(max(abs(one.truth.pose.theta - start.theta) for one in watched)),
        slowest=min(one.speed for one in watched) / watched[0].speed,
        asked=abs(watched[0].outputs.trace.wheel_setpoints[config.robot.motor_names().index(death.motor)] or 0.0) > 0.1,
        step=worst_step(config, after),
    )


def worst_step(config: RobotConfig, moments: Sequence[Moment]) -> float:
    """The largest change of what a wheel is told, in units of what the body's acceleration limits can ask of it."""
    rows, period = build(config).kinematics.matrix(), 1.0 / config.loop.rate
    limits = config.limits.acceleration.as_twist()
    most = [sum(abs(part) * limit for part, limit in zip(row, limits, strict=True)) * period for row in rows]
    worst = 0.0
    for before, now in pairwise(moments):
        told = zip(before.outputs.trace.wheel_setpoints, now.outputs.trace.wheel_setpoints, most, strict=True)
        worst = max([worst, *(abs(b - a) / limit for a, b, limit in told if a is not None and b is not None)])
    return worst


def _command(t: float, twist: Twist) -> dict[str, Any]:
    return {"t": t, "command": {"source": "teleop", "vx": twist.vx, "vy": twist.vy, "wz": twist.wz}}


def _way(moment: Moment) -> float:
    """Direction of the true motion over the ground, rad in the world."""
    vx, vy, _ = moment.truth.twist
    return atan2(vy, vx) + moment.truth.pose.theta


def _beside(x: float, y: float, way: float, moment: Moment) -> float:
    pose = moment.truth.pose
    return (pose.y - y) * cos(way) - (pose.x - x) * sin(way)

"""Figure 8: a blow at the caster's fork while the robot is pulled: 4000 N for 25 ms, across the chassis."""

from math import cos, degrees, hypot, inf, pi, remainder, sin, tau
from typing import NamedTuple

from gateway.types import Level as Severity
from replay.reproduce.direct import PERIOD, TOP
from replay.reproduce.ideal import compensation
from replay.reproduce.picture import Arrow, DrawnRobot, Level, Line, Mark, Panel, Picture
from replay.reproduce.result import Found, Row, Stage, at_least, at_most, within
from replay.reproduce.robot import setup_of, shape_of
from replay.reproduce.service import Driven, Order, drive
from replay.reproduce.straight import NOT_PRINTED
from replay.sim.plants.contract import Point
from replay.sim.plants.offset_caster import OffsetCaster
from replay.sim.plants.offset_dynamics import OffsetDynamics
from replay.sim.plants.offset_parameters import SETS, trailing

FORCE, BLOW = 4000.0, 0.025  # N, s; printed
LIMIT, WEAK = 75.5, 20.0  # N m of the wheels' motors; ours (Otbot's gear, and one that is too weak)
JOINT_LIMIT = 150.0  # N m; ours
DIRECT_AT, SERVICE_AT = 0.5, 2.5  # s at which it is hit; from 1.2 m/s, and from rest
AFTER = 4.0  # s that are watched then
SETTLED = 5.0  # deg


class Blow(NamedTuple):
    """Error of gamma over the time from the blow, deg and s, place, heading and swivel, m and rad."""

    t: list[float]
    error: list[float]
    x: list[float]
    y: list[float]
    heading: list[float]
    swivel: list[float]

    @property
    def largest(self) -> float:
        """deg."""
        return max(self.error)

    @property
    def back(self) -> float:
        """s after which it stays within SETTLED; infinite where it flips."""
        late = [t for t, error in zip(self.t, self.error, strict=True) if error >= SETTLED]
        return inf if late and late[-1] >= self.t[-1] - PERIOD else late[-1] if late else 0.0


def figure_8(stage: Stage) -> Found:
    """Compensated the chassis comes back to its heading, and the robot goes on beside its line."""
    stage.tell("motors at their limit, directly")
    held, free, weak = _direct(2.0, LIMIT), _direct(0.0, LIMIT), _direct(2.0, WEAK)
    stage.tell("through the service, compensated")
    driven = _driven(stage, 2.0, 75.0)
    stage.tell("through the service, uncompensated")
    flipped = _driven(stage, None, 75.0)
    stage.tell("through the service, weak motors")
    tired = _driven(stage, 2.0, WEAK)
    loop, loop_free, loop_weak = _blow(driven), _blow(flipped), _blow(tired)
    alarms = _alarms(tired)
    limit = f"set B, motors of {LIMIT:g} N m"
    rows = (
        Row("largest error, compensated", "deg", held.largest, None, limit, within(53.0, 8.0)),
        Row("time until within 5 deg", "s", held.back, None, f"{limit}; ref 0.775", at_most(1.0)),
        Row("error at the end, compensated", "deg", held.error[-1], None, limit, at_most(0.1)),
        Row("error at the end, uncompensated", "deg", free.error[-1], None, "it flips", at_least(90.0)),
        Row("error at the end, motors of 20 N m", "deg", weak.error[-1], None, "it flips", at_least(90.0)),
        Row("beside the line at the end", "mm", 1e3 * abs(held.y[-1]), None, f"{limit}; {NOT_PRINTED}"),
        Row("largest error, compensated, service", "deg", loop.largest, None, NOT_PRINTED),
        Row("time until within 5 deg, service", "s", loop.back, None, NOT_PRINTED),
        Row("error at the end, compensated, service", "deg", loop.error[-1], None, NOT_PRINTED),
        Row("error at the end, uncompensated, service", "deg", loop_free.error[-1], None, NOT_PRINTED),
        Row("error at the end, motors of 20 N m, service", "deg", loop_weak.error[-1], None, NOT_PRINTED),
        Row("alarms, compensated, service", "1", len(_alarms(driven)), None, NOT_PRINTED),
        Row(
            "alarms, motors of 20 N m, service",
            "1",
            len(alarms),
            None,
            f"there must be; {alarms[0] if alarms else 'none'}",
            at_least(1.0),
        ),
        Row("beside the line at the end, service", "mm", 1e3 * abs(loop.y[-1]), None, NOT_PRINTED),
    )
    errors = (
        _errors("Motors at their limit, directly", held, free, weak),
        _errors("Through the service", loop, loop_free, loop_weak),
    )
    picture = Picture("Figure 8: a blow at the fork of the caster", ((_map(loop),), errors))
    notes = (
        "The paper prints the force, its duration, where it acts and that it is across the chassis. Path (straight), "
        "speed (1.2 m/s), set B and the motors' limit are ours; the paper's controller and limit are unknown.",
        "Directly: every millisecond the torques that would give the wanted velocity a millisecond later, cut at the "
        "motors' limits. Through the service: the velocity loops of the simulated controllers, 1 kHz.",
        "As in the paper only the heading comes back; the way back to the line is for who commands the robot.",
    )
    sessions = {"compensated": driven.session, "uncompensated": flipped.session, "weak motors": tired.session}
    return Found(rows, picture, notes, sessions)


def _direct(gain: float, limit: float) -> Blow:
    """From 1.2 m/s, pulled, the caster trailing."""
    parameters = SETS["B"]
    robot, plant = OffsetDynamics(parameters), OffsetCaster(parameters, swivel=trailing(pulled=True))
    correct = compensation(gain, parameters.axle_offset)
    plant.place((0.0, 0.0, -pi))
    plant.set_velocity((-TOP, 0.0, 0.0))
    found = Blow([], [], [], [], [], [])
    for cycle in range(round((DIRECT_AT + AFTER) / PERIOD)):
        t = cycle * PERIOD - DIRECT_AT
        now = _free(plant)
        vx, vy, pull = correct.turn(TOP, 0.0, joint=-plant.chassis_angle, path_rate=0.0, dt=PERIOD)
        wanted = [(after - before) / PERIOD for before, after in zip(now, (vx, vy, 0.0), strict=True)]
        torques = robot.inverse(plant.coordinates, now, wanted).torques
        limits = (limit, limit, JOINT_LIMIT)
        plant.set_force(Point.CASTER_JOINT, 0.0, FORCE if -1e-9 <= t < BLOW - 1e-9 else 0.0)
        _add(found, t, 0.0 if pull is None else pull.error, *_seen(plant))
        plant.step([max(-most, min(most, torque)) for most, torque in zip(limits, torques, strict=True)])
    return found


def _free(plant: OffsetCaster) -> tuple[float, float, float]:
    """Velocity of the joint over the floor, m/s, and rate of the platform, rad/s."""
    c, s = cos(plant.pose.theta), sin(plant.pose.theta)
    vx, vy, wz = plant.twist
    return c * vx - s * vy, s * vx + c * vy, wz


def _seen(plant: OffsetCaster) -> tuple[float, float, float, float]:
    return plant.pose.x, plant.pose.y, plant.chassis_angle, plant.swivel


def _add(found: Blow, t: float, error: float, *seen: float) -> None:
    for values, value in zip(found, (t, degrees(abs(error)), *seen), strict=True):
        values.append(value)


def _driven(stage: Stage, gain: float | None, torque: float) -> Driven:
    """From rest to 1.2 m/s, and hit at SERVICE_AT."""

    def hit(t: float, plant: OffsetCaster) -> None:
        plant.set_force(Point.CASTER_JOINT, 0.0, FORCE if -1e-9 <= t - SERVICE_AT < BLOW - 1e-9 else 0.0)

    return drive(
        setup_of(SETS["B"], rate=1.0 / PERIOD, gain=gain, torque=torque),
        lambda t, _: Order(min(TOP, 0.8 * t), 0.0, 0.0),
        stage,
        seconds=SERVICE_AT + AFTER,
        heading=pi,
        swivel=trailing(pulled=True),
        disturb=hit,
    )


def _blow(driven: Driven) -> Blow:
    """From half a second before it on; the error against the line that was to be driven."""
    found = Blow([], [], [], [], [], [])
    for sample in driven.samples:
        if sample.t >= SERVICE_AT - DIRECT_AT and sample.swivel is not None:
            error = remainder(sample.chassis - pi, tau)
            _add(found, sample.t - SERVICE_AT, error, sample.x, sample.y, sample.chassis, sample.swivel)
    return found


def _alarms(driven: Driven) -> list[str]:
    """What the service says of motors that cannot do what they are told."""
    return [event.text for event in driven.events if event.level is not Severity.INFO]


def _map(loop: Blow) -> Panel:
    at = next(index for index, t in enumerate(loop.t) if t >= 0.0)
    robots, way = [], inf
    for index, (x, y) in enumerate(zip(loop.x, loop.y, strict=True)):
        way += hypot(x - loop.x[index - 1], y - loop.y[index - 1]) if index else 0.0
        if way >= 0.45:
            robots.append(DrawnRobot(x, y, loop.heading[index], loop.swivel[index]))
            way = 0.0
    side = -1.0 if loop.y[-1] > 0.0 else 1.0
    return Panel(
        "Robot from above, through the service, compensated",
        "x [m]",
        "y [m]",
        lines=(
            Line("without the blow", [loop.x[0], loop.x[-1]], [0.0, 0.0], 2, dashed=True),
            Line("joint", loop.x, loop.y),
        ),
        arrows=(Arrow("4000 N, 25 ms", loop.x[at] - 0.25, side * 0.55, 0.0, -side * 0.52),),
        robots=robots,
        shape=shape_of(setup_of(SETS["B"], rate=1000.0, gain=2.0)),
    )


def _errors(title: str, held: Blow, free: Blow, weak: Blow) -> Panel:
    return Panel(
        title,
        "t from the blow [s]",
        "error of gamma [deg]",
        lines=(
            Line("compensated", held.t, held.error),
            Line("uncompensated", free.t, free.error, 1),
            Line("compensated, motors of 20 N m", weak.t, weak.error, 3),
        ),
        levels=(Level("neutral steering", 90.0),),
        marks=(Mark("blow", 0.0, BLOW),),
    )

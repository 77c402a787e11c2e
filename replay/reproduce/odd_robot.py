"""The ODD of arXiv 2412.10773 in the service: forms of the robot, the floor it drives on, courses, and driving them.

The paper prints no mass, size, speed, time or floor; those of the robot file and of this one are ours.
"""

from collections.abc import Sequence
from math import cos, hypot, radians, sin
from typing import Final, NamedTuple

from gateway.chassis.odd import OddRobot
from gateway.config import parse
from gateway.kinematics.odd import OddKinematics
from gateway.robot_files import find
from gateway.types import Pose, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.reproduce.result import Stage
from replay.reproduce.service import Driven, Order, Sample, drive_in
from replay.sim.plants.contract import PlantName
from replay.sim.plants.odd_bodies import parameters
from replay.sim.plants.odd_dynamics import OddDynamics, leaning_of

PAPER_NOTE: Final = (
    "The paper prints no gain, mass, size, speed, duration or width, and of these paths four deviations alone: robot, "
    "commands and floor are ours, so a figure near to its own proves nothing. Bounds are the paper's figures."
)
_REST: Final = 1.0  # s without motion at the end of a course


class Form(NamedTuple):
    """A robot file of the bundled ones, and how far the robot reaches from its axle."""

    words: str
    robot: str
    reach: float  # m forward and back


CASTERS: Final = Form("on ball casters", "odd", 0.17)
BALANCING: Final = Form("balancing", "odd_balancing", 0.08)


class Floor(NamedTuple):
    """What disturbs: slope (rad, rising along x), friction under the wheels, and what the robot file does not say.

    `left`: share of the mass in the left half; `rollers`: N per N of load across their axles; `creep`: share of its
    speed by which a wheel slips that pushes as hard as it is loaded; slides in N and N s/m; `reach` of the casters, m.
    """

    words: str
    slope: float = 0.0
    friction: float = 0.6
    left: float = 0.5
    rollers: float = 0.0
    creep: float = 0.0
    slide_drag: float = 0.0
    slide_friction: float = 0.0
    reach: float | None = None


LEVEL: Final = Floor("level floor")
TILTED: Final = Floor(
    "tilted floor",
    slope=radians(0.5),
    left=0.53,
    rollers=0.02,
    creep=0.05,
    slide_drag=2.0,
    slide_friction=5.0,
    reach=0.15,
)


class Rates(NamedTuple):
    """Of the four axes of the body: m/s, m/s, rad/s, m/s."""

    vx: float = 0.0
    vy: float = 0.0
    wz: float = 0.0
    width: float = 0.0


class Leg(NamedTuple):
    """Rates from an instant on for so long: rising within the ramp, and after these seconds falling in another one."""

    start: float
    seconds: float
    rates: Rates


class Course:
    """Legs, which may overlap. All rates of one rise and fall together within `ramp`, s, so that its path is kept.

    What a leg makes is its rates times its seconds. In the end it rests.
    """

    def __init__(self, legs: Sequence[Leg], *, ramp: float = 0.4) -> None:
        self._legs, self.ramp = tuple(legs), ramp
        self.driven = max([leg.start + leg.seconds + ramp for leg in legs])
        self.seconds = self.driven + _REST

    def at(self, t: float) -> Rates:
        """What is commanded at this time."""
        total = [0.0] * 4
        for start, seconds, rates in self._legs:
            share = min(1.0, (t - start) / self.ramp, (start + seconds + self.ramp - t) / self.ramp)
            if share > 0.0:
                total = [one + share * two for one, two in zip(total, rates, strict=True)]
        return Rates(*total)


def one_by_one(legs: Sequence[tuple[float, Rates]], *, ramp: float = 0.4) -> Course:
    """Legs of so many seconds, each from where the one before has ended."""
    found, start = list[Leg](), 0.0
    for seconds, rates in legs:
        found.append(Leg(start, seconds, rates))
        start += seconds + ramp
    return Course(found, ramp=ramp)


class Seen(NamedTuple):
    """A drive and, of each sample, the width that really was, m, and how it changed, m/s."""

    drive: Driven
    widths: list[float]
    width_rates: list[float]

    @property
    def samples(self) -> list[Sample]:
        """Of the drive."""
        return self.drive.samples

    def pairs(self) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
        """Where the middles of the left and of the right pair were."""
        left, right = list[tuple[float, float]](), list[tuple[float, float]]()
        for sample, width in zip(self.samples, self.widths, strict=True):
            dx, dy = -0.5 * width * sin(sample.heading), 0.5 * width * cos(sample.heading)
            left.append((sample.x + dx, sample.y + dy))
            right.append((sample.x - dx, sample.y - dy))
        return left, right


def robot_of(form: Form) -> OddRobot:
    """As its file has it."""
    robot = parse(find(form.robot).read_text(encoding="utf-8"), form.robot).robot
    if not isinstance(robot, OddRobot):
        raise TypeError(f"{form.robot}: kind = {robot.kind!r}: must be odd")
    return robot


def drive_odd(stage: Stage, form: Form, floor: Floor, course: Course, *, hold: bool = False) -> Seen:
    """Through the service, commands in the axes of the body and nothing that corrects the place, as in the paper.

    `hold`: the width of the start is commanded all the time, in place of the course's rates of it.
    """
    text = find(form.robot).read_text(encoding="utf-8")
    plant = plant_on(robot_of(form), floor)
    start = plant.width
    loop = ClosedLoop(parse(text, form.robot), plant=plant)
    seen = Seen(Driven([], (), stage.folder), [], [])

    def order(t: float, _: Pose) -> Order:
        rates = course.at(t)
        if hold:
            return Order(rates.vx, rates.vy, wz=rates.wz, frame=TwistFrame.BODY, width=start)
        return Order(rates.vx, rates.vy, wz=rates.wz, frame=TwistFrame.BODY, width_rate=rates.width)

    def look(_: float) -> None:
        plant.slope = floor.slope
        seen.widths.append(plant.width)
        seen.width_rates.append(plant.width_rate)

    drive = drive_in(loop, text, PlantName.DYNAMICS, order, stage, seconds=course.seconds, disturb=look)
    return seen._replace(drive=drive)


def plant_on(robot: OddRobot, floor: Floor) -> OddDynamics:
    """The robot on this floor, level until the first command."""
    p = parameters(robot, leaning_of(robot))
    plant = OddDynamics(
        p._replace(
            left=floor.left * p.mass,
            right=(1.0 - floor.left) * p.mass,
            roller_drag=floor.rollers,
            creep=floor.creep,
            slide_drag=floor.slide_drag,
            slide_friction=floor.slide_friction,
            caster_reach=floor.reach,
        ),
        width=robot.width,
    )
    plant.attended = True
    for joint in plant.wheels:
        plant.set_friction(joint, floor.friction)
    return plant


def ideal(robot: OddRobot, course: Course, *, period: float = 0.004) -> list[Pose]:
    """Where wheels that never slip and are never late take it: commands to wheel speeds and back, along exact arcs."""
    kinematics = robot.kinematics()
    poses = [Pose(0.0, 0.0, 0.0)]
    for cycle in range(round(course.seconds / period)):
        speeds = kinematics.wheel_speeds(course.at((cycle + 0.5) * period))
        assert speeds is not None  # a robot file is refused where the wheels do not tell the motion
        poses.append(_moved(poses[-1], kinematics, speeds, period))
    return poses


def _moved(pose: Pose, kinematics: OddKinematics, speeds: Sequence[float], period: float) -> Pose:
    estimate = kinematics.twist(speeds)
    assert estimate is not None
    vx, vy, wz = estimate.twist
    kinematics.width.metres += period * estimate.more[0]
    half = 0.5 * wz * period
    chord = period * (sin(half) / half if half else 1.0)
    c, s = chord * cos(pose.theta + half), chord * sin(pose.theta + half)
    return Pose(pose.x + c * vx - s * vy, pose.y + s * vx + c * vy, pose.theta + wz * period)


def apart(one: Pose | Sample, other: Pose | Sample) -> float:
    """m between two places."""
    return hypot(one.x - other.x, one.y - other.y)

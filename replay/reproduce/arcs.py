"""Figures 9 and 10: a path of two arcs and a line, pulled, at several periods of the loop."""

from math import asin, cos, degrees, hypot, inf, pi, sin

from gateway.control.pull_region import Region
from gateway.paths.drive import Demands, PathDrive
from gateway.paths.path import Path, Piece
from gateway.types import Pose
from replay.reproduce import ideal
from replay.reproduce.ideal import Step, Velocity
from replay.reproduce.picture import Line, Mark, Panel, Picture
from replay.reproduce.result import Found, Row, Stage, at_most, within
from replay.reproduce.robot import Setup, shape_of
from replay.reproduce.service import Driven, Order, Sample, Wanted, drive
from replay.reproduce.straight import NOT_PRINTED, robots_along
from replay.sim.plants.offset_parameters import trailing

OFFSET = 0.145  # m, d1 of the real robot; printed in section 8
SPEED = 0.5  # m/s; ours
RAMP = 1.0  # s, in which the curvature changes between the arcs; ours
FIRST, SECOND, STRAIGHT = 5.0, 8.0, 5.0  # m; printed
FREE_WAY = 5.0  # m that are looked at without compensation: the first arc
BOUNDS = {0.001: 8.0, 0.004: 8.0, 0.02: 15.0, 0.1: 50.0}  # period of the loop, s: mm
REFERENCE = {0.001: 6.4, 0.004: 7.6, 0.02: 14.6, 0.1: 48.2}
_EVERY = 25  # samples between those whose place beside the path is looked for


def arcs() -> Path:
    """60 degrees at 5 m, 90 degrees at 8 m, 5 m straight on; the curvature changes evenly between."""
    a, b, ramp = 1.0 / FIRST, 1.0 / SECOND, SPEED * RAMP
    return Path(
        Pose(0.0, 0.0, 0.0),
        [
            Piece("arc", FIRST * pi / 3.0, a, a),
            Piece("clothoid", ramp, a, b),
            Piece("arc", SECOND * pi / 2.0, b, b),
            Piece("clothoid", ramp, b, 0.0),
            Piece("line", STRAIGHT, 0.0, 0.0),
        ],
    )


def figure_9(stage: Stage) -> Found:
    """Each change of curvature shifts the robot a little, the more the slower the loop."""
    path = arcs()
    stage.tell("kinematics")
    steps = {period: _along(path, 2.0, period, path.length) for period in BOUNDS}
    free = {period: _along(path, 0.0, period, FREE_WAY) for period in BOUNDS}
    setup = Setup(wheel_radius=0.1, axle_offset=OFFSET, track=0.4, rate=250.0, gain=2.0)
    stage.tell("through the service")
    driven = _driven(setup, path, stage, _blind(path))
    stage.tell("through the service, recomputed")
    follower = _follower(path)
    merged = _driven(setup, path, stage, _following(follower))
    beside, back = _beside(path, driven.samples), _beside(path, merged.samples)
    rows = (
        Row(
            "length of the arcs and the line",
            "m",
            path.length - 2.0 * SPEED * RAMP,
            None,
            "by the paper's radii and angles 5 pi/3 + 4 pi + 5",
            within(22.802, 5e-4),
        ),
        *_rows(path, steps, free),
        Row("largest way beside the path, service", "mm", _largest(beside), None, f"4 ms, blind; {NOT_PRINTED}"),
        Row("largest error, service", "deg", _error(driven), None, f"4 ms, blind; {NOT_PRINTED}"),
        Row(
            "largest way beside the path, recomputed, service",
            "mm",
            _largest(back),
            None,
            "4 ms; a way back planned every 0.1 s, which the paper leaves open",
        ),
        Row(
            "the same by its odometry",
            "mm",
            1e3 * follower.max_deviation,
            None,
            "what it can know of; the rest is the odometry's own error",
        ),
    )
    points = [path.at(0.05 * number) for number in range(int(path.length / 0.05) + 1)]
    map_ = Panel(
        "Robot from above (drawn three times as large)",
        "x [m]",
        "y [m]",
        lines=(
            Line("path", [p.x for p in points], [p.y for p in points], 2, dashed=True),
            Line("through the service, 4 ms", [s.x for s in driven.samples], [s.y for s in driven.samples]),
        ),
        robots=robots_along(driven.samples, 1.5),
        shape=shape_of(setup).times(3.0),
    )
    ramps = tuple(
        Mark("curvature changes" if number == 0 else "", path.starts[piece], path.starts[piece + 1])
        for number, piece in enumerate((1, 3))
    )
    deviation = Panel(
        "Figure 10: distance from where it should be, kinematics",
        "way [m]",
        "distance [mm]",
        lines=tuple(
            Line(f"loop of {1e3 * period:g} ms", [SPEED * s.t for s in one], _distances(path, one), colour)
            for colour, (period, one) in enumerate(steps.items())
        ),
        marks=ramps,
    )
    service = Panel(
        "Beside the path, through the service",
        "way [m]",
        "to the left [mm]",
        lines=(
            Line("velocities of the path, blind", [way for way, _ in beside], [left for _, left in beside]),
            Line("way ahead recomputed every 0.1 s", [way for way, _ in back], [left for _, left in back], 1),
        ),
        marks=ramps,
    )
    notes = (
        "The paper prints radii, angles and the length of the line, and no speed, no period and no deviation; "
        "0.5 m/s, 1 s for the curvature to change, k = 2 and d1 = 0.145 m of its section 8 are ours.",
        "The deviation does not grow with the radius alone: each change of curvature leaves its own.",
    )
    picture = Picture("Figures 9 and 10: two arcs and a line, pulled", ((map_,), (deviation, service)))
    return Found(rows, picture, notes, {"blind": driven.session, "recomputed": merged.session})


def _rows(path: Path, steps: dict[float, list[Step]], free: dict[float, list[Step]]) -> list[Row]:
    found = []
    for period, bound in BOUNDS.items():
        loop = f"loop of {1e3 * period:g} ms"
        far, note = (
            max(_distances(path, steps[period])),
            f"kinematics; at most {bound:g}, ref {REFERENCE[period]:g}",
        )
        found.append(Row(f"largest distance, {loop}", "mm", far, None, note, at_most(bound)))
        error = max(degrees(abs(step.error or 0.0)) for step in steps[period])
        found.append(Row(f"largest error, {loop}", "deg", error, None, "kinematics; at most 0.5", at_most(0.5)))
    for period, one in free.items():
        pushed = next((SPEED * step.t for step in one if step.region is Region.PUSH), inf)
        allowed = (0.0, FREE_WAY)
        note = "kinematics; it must leave it"
        found.append(
            Row(f"way until it is pushed, k = 0, loop of {1e3 * period:g} ms", "m", pushed, None, note, allowed)
        )
    return found


def _along(path: Path, gain: float, period: float, way: float) -> list[Step]:
    """The velocities of the path at its times, so far, blind to where the robot is."""

    def wanted(t: float) -> Velocity:
        point = path.at(SPEED * t)
        return Velocity(SPEED * cos(point.heading), SPEED * sin(point.heading), SPEED * point.curvature)

    cycles = int(way / SPEED / period)
    return ideal.drive(
        wanted,
        seconds=cycles * period,
        period=period,
        axle_offset=OFFSET,
        heading=_balanced(),
        gain=lambda _: gain,
    )


def _balanced() -> float:
    """Heading of the chassis that the first arc keeps, pulled (Eq. 22), rad."""
    return asin(OFFSET / FIRST) - pi


def _distances(path: Path, steps: list[Step]) -> list[float]:
    """From where it should be at that time, mm."""
    points = [path.at(SPEED * step.t) for step in steps]
    return [1e3 * hypot(step.x - p.x, step.y - p.y) for step, p in zip(steps, points, strict=True)]


def _driven(setup: Setup, path: Path, stage: Stage, wanted: Wanted) -> Driven:
    seconds = path.length / SPEED + 1.0
    return drive(setup, wanted, stage, seconds=seconds, heading=_balanced(), swivel=trailing(pulled=True))


def _blind(path: Path) -> Wanted:
    """From rest within a second, evenly faster."""

    def order(t: float, _: Pose) -> Order:
        speed = SPEED * min(t, 1.0)
        way = 0.5 * speed * min(t, 1.0) + SPEED * max(0.0, t - 1.0)
        if way >= path.length:
            return Order(0.0, 0.0)
        point = path.at(way)
        return Order(speed * cos(point.heading), speed * sin(point.heading), speed * point.curvature)

    return order


def _follower(path: Path) -> PathDrive:
    """As `drivegate path` leads a robot."""
    demands = Demands(axle_offset=OFFSET, pulled=True, top_speed=1.0, acceleration=SPEED)
    return PathDrive(demands.follower(path, SPEED), period=0.004)


def _following(follower: PathDrive) -> Wanted:
    def order(t: float, pose: Pose) -> Order:
        told = follower.step(t, pose.x, pose.y)
        return Order(told.vx, told.vy, told.path_rate)

    return order


def _beside(path: Path, samples: list[Sample]) -> list[tuple[float, float]]:
    """Way along the path and place to the left of it, m and mm."""
    found, way = [], 0.0
    for sample in samples[::_EVERY]:
        way = path.nearest(sample.x, sample.y, between=(way - 0.2, min(way + 0.2, path.length)))
        found.append((way, 1e3 * path.beside(sample.x, sample.y, way)[1]))
    return found


def _largest(beside: list[tuple[float, float]]) -> float:
    return max(abs(left) for _, left in beside)


def _error(driven: Driven) -> float:
    return max(degrees(abs(sample.error)) for sample in driven.samples if sample.error is not None)

"""Following a path in closed loop with the kinematics of both chassis: pushed off, the robot merges back."""

import math
from itertools import pairwise
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.chassis.omni import WheelPose, omni_kinematics
from gateway.control.compensation import Compensation, RegionAt
from gateway.control.pull_region import Region
from gateway.kinematics.contract import Kinematics
from gateway.kinematics.offset_differential import OffsetDifferentialKinematics
from gateway.paths import path_file
from gateway.paths.follower import Follower, FollowerState, Order, _beside, _values
from gateway.paths.path import Path, Piece
from gateway.paths.rules import least_stretch
from gateway.types import Pose, Twist
from tests.pulled import PulledRobot

D1, SPEED = 0.145, 0.5
OMNI = omni_kinematics(
    [WheelPose(0.2 * math.cos(a), 0.2 * math.sin(a), a, 0.05) for a in (0.6, math.pi - 0.6, math.pi + 0.6, -0.6)]
)
OFFSET = OffsetDifferentialKinematics(wheel_radius=0.1, axle_offset=D1, track=0.45)

COURSE = """
[[piece]]
kind = "line"
length = 3.0
[[piece]]
kind = "clothoid"
length = 1.0
[[piece]]
kind = "arc"
radius = 2.0
angle = 1.5707963267948966
[[piece]]
kind = "clothoid"
length = 1.0
[[piece]]
kind = "line"
length = 6.0
"""
PATH = path_file.parse(COURSE, "course.toml")


class Push(NamedTuple):
    """Velocity over the floor, m/s, that comes on top from this time on, s, for so long, s."""

    vx: float
    vy: float
    start: float = 3.0
    seconds: float = 0.4


class Drive(NamedTuple):
    orders: list[Order]
    end: tuple[float, float]
    regions: set[Region]

    def deviation(self, way: float) -> float:
        return min(self.orders, key=lambda order: abs(order.way - way)).deviation


def driven(kinematics: Kinematics, velocity: tuple[float, float], joint: float) -> tuple[float, float]:
    """Through the wheels: to their speeds, and back to the motion that they make. The platform keeps heading 0."""
    places = [None, None, joint]
    speeds = kinematics.wheel_speeds(Twist(*velocity, 0.0), places)
    assert speeds is not None
    estimate = kinematics.twist(speeds, places)
    assert estimate is not None
    assert abs(estimate.twist.wz) < 1e-9
    return estimate.twist.vx, estimate.twist.vy


def drive(
    kinematics: Kinematics,
    push: Push,
    *,
    h: float = 0.004,
    period: float = 0.1,
    stretch: float = 1.2,
    path: Path = PATH,
    seconds: float = 60.0,
) -> Drive:
    pulled = kinematics is OFFSET
    least_radius = 1.5 * D1 if pulled else None
    follower = Follower(path, speed=SPEED, acceleration=0.5, period=period, stretch=stretch, least_radius=least_radius)
    robot, state = PulledRobot(D1, math.pi), FollowerState()
    correct = Compensation(gain=2.0, regions=(RegionAt(0.0, 1.57),), axle_offset=D1, authority=3.0)
    orders: list[Order] = []
    regions: set[Region] = set()
    for cycle in range(round(seconds / h)):
        order, state = follower.step(state, robot.x, robot.y, h)
        orders.append(order)
        if order.arrived or order.lost:
            break
        velocity = order.vx, order.vy
        if pulled:
            vx, vy, pull = correct.turn(*velocity, joint=-robot.heading, path_rate=order.path_rate, dt=h)
            velocity = vx, vy
            regions |= {pull.region} if pull is not None else set()
        vx, vy = driven(kinematics, velocity, -robot.heading)
        if push.start <= cycle * h < push.start + push.seconds:
            vx, vy = vx + push.vx, vy + push.vy
        robot.move(vx, vy, h)
    return Drive(orders, (robot.x, robot.y), regions)


def miss(done: Drive, path: Path = PATH) -> float:
    end = path.at(path.length)
    return math.hypot(done.end[0] - end.x, done.end[1] - end.y)


@pytest.mark.parametrize("kinematics", [OMNI, OFFSET], ids=["omni", "offset"])
@pytest.mark.parametrize(("h", "period"), [(0.01, 0.1), (0.01, 0.5), (0.02, 0.02)])
@pytest.mark.parametrize("push", [Push(0.0, 0.4), Push(0.1, -0.3), Push(-0.3, 0.2, start=9.0)])
def test_a_pushed_robot_merges_back(kinematics: Kinematics, h: float, period: float, push: Push) -> None:
    """Off by some 10 cm it is back to 5 mm 2.5 stretches later, arrives, and turns steadily all the time.

    Back to where it is there without the push: pulled over a clothoid it is up to 2 cm beside the path.
    """
    done, unpushed = (drive(kinematics, one, h=h, period=period) for one in (push, Push(0.0, 0.0)))
    off = max(abs(order.deviation) for order in done.orders)
    assert off > 0.03
    later = done.orders[round((push.start + push.seconds + 6.0) / h)]
    assert abs(later.deviation - unpushed.deviation(later.way)) < max(5e-3, 0.05 * off)
    assert done.orders[-1].arrived
    assert miss(done) < 3e-3
    assert done.regions <= {Region.PULL}
    curvatures = [order.curvature for order in done.orders[:-1]]
    assert max(map(abs, curvatures)) < 1.5
    # From cycle to cycle 5 mm or 10 mm of way; the path's own clothoids change by 0.5 1/m in a metre.
    assert max(abs(b - a) for a, b in pairwise(curvatures)) < 10.0 * SPEED * h
    directions = [math.atan2(order.vy, order.vx) for order in done.orders[1:-1]]
    assert max(abs(math.remainder(b - a, math.tau)) for a, b in pairwise(directions)) < 1.5 * SPEED * h


def test_undisturbed_it_stays_on_the_path() -> None:
    for kinematics, bound in ((OMNI, 1e-3), (OFFSET, 0.02)):
        done = drive(kinematics, Push(0.0, 0.0))
        assert max(abs(order.deviation) for order in done.orders) < bound
        assert miss(done) < 2e-3


def test_planning_more_often_is_nearer_to_the_path() -> None:
    """The paper's reason to plan anew: without it what the compensation shifted stays."""
    never, often = drive(OFFSET, Push(0.0, 0.4), period=1e9), drive(OFFSET, Push(0.0, 0.4))
    assert abs(never.orders[-1].deviation) > 0.05
    assert abs(often.orders[-1].deviation) < 1e-3


def test_too_short_a_stretch_swings_against_the_compensation() -> None:
    """What is left in the last third of a long line after a push, against the bound of the rules."""
    line = Path(Pose(0.0, 0.0, 0.0), [Piece("line", 15.0, 0.0, 0.0)])
    left = {}
    for stretch in (2.0 * D1, least_stretch(D1, 0.1 * SPEED)):
        done = drive(OFFSET, Push(0.0, 0.1), stretch=stretch, path=line)
        tail = [abs(order.deviation) for order in done.orders if order.way > 10.0]
        left[stretch] = max(tail)
    short, enough = left.values()
    assert short > 10e-3
    assert enough < 0.1e-3


values = st.floats(-1.0, 1.0)


@settings(max_examples=100, deadline=None)
@given(st.floats(0.5, 11.0), values, values, values)
def test_a_new_plan_goes_on_as_the_old_one_went(way: float, x: float, y: float, bend: float) -> None:
    """Direction and curvature at the moment of planning, from wherever the robot was pushed to."""
    follower = Follower(PATH, speed=SPEED, acceleration=0.5, period=0.1, stretch=1.0, least_radius=None)
    point = PATH.at(way)
    first = follower._planned(FollowerState(way), point.x + 0.2 * bend, point.y - 0.2 * bend)
    state = first._replace(way=first.way + 0.3)
    going = PATH.at(state.way)
    second = follower._planned(state, going.x + 0.4 * x, going.y + 0.4 * y)
    before = _beside(going, *_values(state.plan, state.way))
    after = _beside(PATH.at(second.way), *_values(second.plan, second.way))
    assert before is not None
    assert after is not None
    assert math.remainder(after.heading - before.heading, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert after.curvature == pytest.approx(before.curvature, abs=1e-8)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.5, 12.0), st.floats(-0.5, 0.5))
def test_curvature_and_direction_of_a_plan_are_those_of_its_points(way: float, aside: float) -> None:
    """By differences of the points themselves."""
    follower = Follower(PATH, speed=SPEED, acceleration=0.5, period=0.1, stretch=1.0, least_radius=None)
    point = PATH.at(way)
    planned = follower._planned(
        FollowerState(way), point.x - aside * math.sin(point.heading), point.y + aside * math.cos(point.heading)
    )
    at = planned.way + 0.4 * planned.plan.length
    step = 1e-3
    places = []
    for s in (at - step, at, at + step):
        p, (n, _, _) = PATH.at(s), _values(planned.plan, s)
        places.append((p.x - n * math.sin(p.heading), p.y + n * math.cos(p.heading)))
    (ax, ay), (bx, by), (cx, cy) = places
    beside = _beside(PATH.at(at), *_values(planned.plan, at))
    assert beside is not None
    first, second = math.atan2(by - ay, bx - ax), math.atan2(cy - by, cx - bx)
    turned, way_of_it = math.remainder(second - first, math.tau), 0.5 * math.hypot(cx - ax, cy - ay)
    middle = math.atan2(cy - ay, cx - ax)
    assert math.remainder(beside.heading - middle, math.tau) == pytest.approx(0.0, abs=1e-4)
    assert beside.curvature == pytest.approx(turned / way_of_it, abs=2e-3)
    assert beside.progress == pytest.approx(step / way_of_it, rel=1e-4)


def test_a_merge_turns_no_tighter_than_allowed() -> None:
    """40 cm off a line: over 4 times as much way 5.77 n/L^2 = 0.9 1/m; with half of that allowed it takes longer."""
    line = Path(Pose(0.0, 0.0, 0.0), [Piece("line", 30.0, 0.0, 0.0)])
    for least_radius, least, most in ((0.5, 0.8, 2.0), (2.0, 0.3, 0.51)):
        follower = Follower(line, speed=1.0, acceleration=1.0, period=0.1, stretch=1.0, least_radius=least_radius)
        plan = follower._planned(FollowerState(5.0), 5.0, 0.4).plan
        ways = [plan.start + plan.length * number / 500 for number in range(501)]
        sharpest = max(abs(b.curvature) for way in ways if (b := _beside(line.at(way), *_values(plan, way))))
        assert least < sharpest <= most


@pytest.mark.parametrize(
    ("way", "ahead", "aside"),
    [(1.0, 1.2, 0.0), (5.5, 0.0, 1.9), (5.5, -1.1, 0.0)],
    ids=["far ahead", "at the centre of its arc", "far behind"],
)
def test_off_beyond_return_it_is_told_to_stand(way: float, ahead: float, aside: float) -> None:
    follower = Follower(PATH, speed=SPEED, acceleration=0.5, period=1.0, stretch=1.0, least_radius=None)
    point = PATH.at(way)
    s, c = math.sin(point.heading), math.cos(point.heading)
    state = FollowerState(way, speed=SPEED)
    order, after = follower.step(state, point.x + ahead * c - aside * s, point.y + ahead * s + aside * c, 0.01)
    assert order.lost
    assert (order.vx, order.vy, order.path_rate) == (0.0, 0.0, 0.0)
    assert after == state._replace(speed=0.0)


def test_start_and_end_are_slow() -> None:
    orders = drive(OMNI, Push(0.0, 0.0)).orders
    speeds = [math.hypot(order.vx, order.vy) for order in orders]
    assert speeds[0] == pytest.approx(0.5 * 0.004)
    assert max(speeds) <= SPEED * (1.0 + 1e-12)
    assert speeds[-1] == 0.0
    assert max(abs(b - a) for a, b in pairwise(speeds)) < 0.05
    assert max(b - a for a, b in pairwise(speeds)) <= 0.5 * 0.004 * (1.0 + 1e-9)


def test_an_omni_robot_takes_corners() -> None:
    corner = path_file.parse(
        "[[piece]]\nkind = 'line'\nlength = 2.0\n[[piece]]\nkind = 'corner'\nangle = 1.5707963267948966\n"
        "[[piece]]\nkind = 'line'\nlength = 4.0\n",
        "corner.toml",
    )
    done = drive(OMNI, Push(0.0, 0.0), path=corner)
    assert miss(done, corner) < 3e-3
    assert max(abs(order.deviation) for order in done.orders) < 0.02

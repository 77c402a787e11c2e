"""A body with an axis more than a twist: two collinear pairs of mecanum wheels whose distance is driven as well.

A chassis of the test alone, of fixed distance d: wheel i at y_i rolls at (vx - wz y_i) + tan(alpha_i) vy of its side,
and each side moves by half the width rate (arXiv 2407.10127; its equations 12 to 14).
"""

import json
from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import pi, tan
from typing import ClassVar, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.chassis.contract import ALIKE, ChassisChannels, Drawing, DrawnWheel, LawParts, LoopLimit, Sideways
from gateway.config import ConfigError, RobotConfig, parse, parse_as
from gateway.control.decoupled import Saturation
from gateway.control.drive_law import Measured, SpeedLaw
from gateway.control.limits import TwistLimiter, excess
from gateway.core.channels import layout_of
from gateway.core.engine import Engine
from gateway.core.examination import examine
from gateway.kinematics.fixed_wheels import FixedWheels
from gateway.kinematics.linear import Matrix, diagonal
from gateway.sections import Body, Length, Name, Section
from gateway.types import PLANAR, ZERO_TWIST, Inputs, Mode, Rates, RequestKind
from tests.gateway.test_engine_rules import FORWARD, Stand
from tests.world import robot_text

R, D, W = 0.05, 0.4, 0.1  # m: rolling radius, distance of the pairs, distance within a pair
AXES = (*PLANAR, "width_rate")
VELOCITY, ACCELERATION, JERK = (2.0, 1.5, 4.0, 0.2), (2.0, 1.5, 6.0, 0.4), (15.0, 12.0, 40.0, 4.0)
ALPHAS = (pi / 4, -pi / 4, -pi / 4, pi / 4)
PLACES = (D / 2 + W / 2, D / 2 - W / 2, -D / 2 + W / 2, -D / 2 - W / 2)
SIDES = (0.5, 0.5, -0.5, -0.5)  # of the width rate, to the left


class FourAxes(Section):
    """The section of its robot file."""

    GEOMETRY: ClassVar[str] = "distance and radius"
    AXES: ClassVar[tuple[str, ...]] = AXES
    SIDEWAYS: ClassVar[Sideways] = ALIKE
    saturation: ClassVar[Saturation] = Saturation.BOTH

    kind: Literal["four_axes"]
    name: Name
    body: Body
    distance: Length
    radius: Length
    wheels: tuple[Name, Name, Name, Name]

    def motor_names(self) -> tuple[str, ...]:
        return self.wheels

    def kinematics(self) -> FixedWheels:
        rows = [(1.0, tan(a), -y, tan(a) * side) for a, y, side in zip(ALPHAS, PLACES, SIDES, strict=True)]
        return FixedWheels(rows, (self.radius,) * 4, axes=self.AXES)

    def trailing(self) -> None:
        pass

    def doubts(self) -> tuple[str, ...]:
        return ()

    def channels(self) -> tuple[ChassisChannels, ...]:
        return ()

    def law(self, parts: LawParts) -> SpeedLaw:
        return SpeedLaw(parts.kinematics, top_speeds=parts.top_speeds, velocity=parts.velocity, period=parts.period)

    def inertia(self, angles: Sequence[float]) -> Matrix:
        return diagonal(self.masses())

    def masses(self) -> Rates:
        return (self.body.mass, self.body.mass, self.body.inertia, self.body.mass / 4.0)

    def drawing(self) -> Drawing:
        return Drawing(self.distance, tuple(DrawnWheel(0.0, y, 0.0, self.radius) for y in PLACES))

    def loop_limits(self, top_speed: float, *, delay: float) -> tuple[LoopLimit, ...]:
        return ()


class FourAxesConfig(RobotConfig):
    """The robot file with that chassis."""

    robot: FourAxes  # type: ignore[assignment]


def text(*, width_rate: bool = True) -> str:
    """That of omni4 with another chassis, of the same motors."""
    found = robot_text("omni4")
    head = found[: found.index("[[robot.wheel]]")].replace(
        'kind = "omni"', f'kind = "four_axes"\ndistance = {D}\nradius = {R}\nwheels = ["a", "b", "c", "d"]'
    )
    rest = found[found.index("[loop]") :]
    for name, new in zip(("front_left", "rear_left", "rear_right", "front_right"), "abcd", strict=True):
        rest = rest.replace(name, new)
    if width_rate:
        for key, (*_, wz, limit) in (("velocity", VELOCITY), ("acceleration", ACCELERATION), ("jerk", JERK)):
            line = next(line for line in rest.splitlines() if line.startswith(key))
            rest = rest.replace(line, line.replace(f"wz = {wz}", f"wz = {wz}, width_rate = {limit}"))
    return head + rest


CONFIG = parse_as(FourAxesConfig, text(), "four_axes")
CHASSIS = CONFIG.robot.kinematics()
STILL = (0.0,) * 4
shares = st.tuples(*[st.floats(-1.0, 1.0) for _ in AXES])


# the robot file


@pytest.mark.parametrize("key", ["velocity", "acceleration", "jerk"])
def test_limits_name_every_axis_of_the_chassis(key: str) -> None:
    with pytest.raises(ConfigError, match=rf"limits\.{key}\.width_rate: missing, the chassis has this axis"):
        parse_as(FourAxesConfig, text(width_rate=False), "four_axes")


@pytest.mark.parametrize("name", ["moby", "omni4"])
def test_limits_name_no_axis_that_the_chassis_has_not(name: str) -> None:
    other = robot_text(name).replace("velocity = { ", "velocity = { width_rate = 0.2, ")
    with pytest.raises(ConfigError, match=r"limits\.velocity\.width_rate: no axis of this chassis; it has vx, vy, wz"):
        parse(other, name)


@pytest.mark.parametrize("limit", ["0.0", "-1.0", "1e9", "inf", "'fast'"])
def test_a_limit_of_such_an_axis_has_the_range_of_any_limit(limit: str) -> None:
    other = text().replace(f"width_rate = {VELOCITY[3]}", f"width_rate = {limit}")
    with pytest.raises(ConfigError, match=r"limits\.velocity\.width_rate"):
        parse_as(FourAxesConfig, other, "four_axes")


def test_check_tells_every_axis() -> None:
    """Along width_rate alone a wheel turns at half of it over R: 45 rad/s x 2 x 0.05 m = 4.5 m/s."""
    report = examine(CONFIG, "four_axes")
    assert (report.axes, report.rank) == (AXES, 4)
    assert report.top_speeds == pytest.approx([2.25, 2.25, 2.25 / PLACES[0], 4.5])
    assert report.reachable == VELOCITY


# geometry


def test_forward_kinematics_by_hand() -> None:
    """The printed inverse of (45, -45, -45, 45) degrees, per R times the wheel speeds."""
    far, near = D + W, D - W
    printed = np.array(
        [
            [0.25, 0.25, 0.25, 0.25],
            [0.25, -0.25, -0.25, 0.25],
            np.array([-1.0, -1.0, 1.0, 1.0]) / (2 * D),
            np.array([near, -far, far, -near]) / (2 * D),
        ]
    )
    for wheel in range(4):
        estimate = CHASSIS.twist([1.0 / R if place == wheel else 0.0 for place in range(4)])
        assert estimate is not None
        assert estimate.rates == pytest.approx(printed[:, wheel], abs=1e-12)
        assert (estimate.residual, estimate.residuals) == (None, None)


@given(shares)
def test_round_trip(rates: Rates) -> None:
    estimate = CHASSIS.twist(CHASSIS.wheel_speeds(rates))
    assert estimate is not None
    assert estimate.rates == pytest.approx(rates, abs=1e-12)
    assert estimate.twist == pytest.approx(rates[:3], abs=1e-12)
    assert estimate.more == pytest.approx(rates[3:], abs=1e-12)


def test_every_wheel_is_needed() -> None:
    assert CHASSIS.reach((True,) * 4).complete
    assert CHASSIS.reach((True,) * 4).effort == 1.0
    for lost in range(4):
        reach = CHASSIS.reach([place != lost for place in range(4)])
        assert (reach.rank, reach.complete, reach.effort) == (3, False, 0.0)
        assert CHASSIS.twist([None if place == lost else 1.0 for place in range(4)]) is None


# limits


def limiter() -> TwistLimiter:
    return TwistLimiter(velocity=VELOCITY, acceleration=ACCELERATION, jerk=JERK)


def walk(moving: TwistLimiter, target: Rates) -> Iterator[Rates]:
    """Setpoints until nothing changes any more."""
    before: Rates | None = None
    while moving.rates != before:
        before = moving.rates
        moving.step(target, 0.004)
        yield moving.rates


@settings(max_examples=40, deadline=None)
@given(shares)
def test_from_rest_all_axes_go_straight_and_within_every_limit(share: Rates) -> None:
    """No turning, which holds back what it bends; a motion that does not turn is on a straight line."""
    target = tuple(part * top for part, top in zip((share[0], share[1], 0.0, share[3]), VELOCITY, strict=True))
    size = excess(target, VELOCITY)
    course = list(walk(limiter(), target))
    assert course[-1] == pytest.approx(target, abs=1e-12)
    for before, after in pairwise(course):
        progress = excess(after, VELOCITY) / size if size else 0.0
        assert after == pytest.approx([progress * axis for axis in target], abs=1e-9)
        assert progress <= 1.0 + 1e-12
        change = tuple((new - old) / 0.004 for old, new in zip(before, after, strict=True))
        assert excess(change, ACCELERATION) <= 1.0 + 1e-9


def test_the_slowest_axis_holds_the_others_back() -> None:
    """0.2 m/s of width at 0.4 m/s^2 and the jerk of the slowest axis, 40 of 6 rad/s^2: 0.5 s and 0.15 s."""
    moving = limiter()
    course = list(walk(moving, (0.1, 0.0, 0.0, 0.2)))
    assert len(course) * 0.004 == pytest.approx(0.65, abs=0.03)
    assert "velocity" in moving.step((2.0, 0.0, 0.0, 0.4), 0.004)[1]


@settings(max_examples=40, deadline=None)
@given(shares, st.integers(1, 300))
def test_braking_keeps_the_proportion_of_all_axes(share: Rates, cycles: int) -> None:
    moving = limiter()
    for _, _ in zip(
        range(cycles), walk(moving, tuple(a * b for a, b in zip(share, VELOCITY, strict=True))), strict=False
    ):
        pass
    start = moving.rates
    for _ in range(2000):
        before = moving.rates
        after = moving.brake(0.004)
        assert all(abs(new) <= abs(old) for old, new in zip(before, after, strict=True))
        assert np.outer(after, start) == pytest.approx(np.outer(start, after), abs=1e-9)
    assert moving.at_rest


@given(shares)
def test_desaturation_keeps_the_direction_of_all_axes(share: Rates) -> None:
    setpoint = tuple(part * top for part, top in zip(share, VELOCITY, strict=True))
    law = SpeedLaw(CHASSIS, top_speeds=[20.0] * 4, velocity=VELOCITY, period=0.004)
    motion = law.motion(setpoint, Measured(0, 0.004, STILL, STILL, STILL, (0,) * 4, STILL), braking=False)
    driven = CHASSIS.twist([command.value for command in motion.commands])
    assert driven is not None
    assert driven.rates == pytest.approx([motion.share * axis for axis in setpoint], abs=1e-9)
    assert max(abs(command.value) for command in motion.commands) <= 20.0 * (1.0 + 1e-12)


# the engine


class Robot:
    """The core with that chassis."""

    def __init__(self) -> None:
        self.stand = Stand("four_axes", config=CONFIG)

    def start(self) -> None:
        self.stand.cycle(ZERO_TWIST)
        self.stand.cycle(ZERO_TWIST)
        assert self.stand.is_in(Mode.DRIVE)


@pytest.fixture
def robot() -> Robot:
    return Robot()


@pytest.mark.pure_python
def test_it_drives_all_four_axes_and_comes_to_rest(robot: Robot) -> None:
    robot.start()
    robot.stand.width_rate = 0.15
    out = robot.stand.run(2.0, FORWARD)
    (width,) = out.trace.more
    assert (width.target, width.setpoint) == pytest.approx((0.15, 0.15))
    assert width.measured == pytest.approx(0.15, abs=1e-6)
    assert out.trace.setpoint == pytest.approx(FORWARD)
    assert robot.stand.setpoints == pytest.approx(CHASSIS.wheel_speeds((*FORWARD, 0.15)))
    named = layout_of(CONFIG).named(out.trace)
    assert [named[f"width_rate_{what}"] for what in ("wanted", "limited", "measured")] == pytest.approx([0.15] * 3)
    robot.stand.run(0.5)
    assert robot.stand.is_in(Mode.STOPPING)
    assert 0.0 < robot.stand.out.trace.more[0].setpoint < 0.15
    robot.stand.run(2.0)
    assert robot.stand.is_in(Mode.IDLE)
    assert robot.stand.out.trace.more[0].setpoint == 0.0


@pytest.mark.pure_python
def test_a_width_rate_is_no_zero(robot: Robot) -> None:
    robot.stand.width_rate = 0.1
    robot.stand.run(1.0, ZERO_TWIST)
    assert robot.stand.is_in(Mode.IDLE)
    robot.stand.width_rate = None
    robot.stand.cycle(ZERO_TWIST)
    assert robot.stand.is_in(Mode.STARTING)


@pytest.mark.pure_python
def test_an_emergency_stop_stops_all_four(robot: Robot) -> None:
    robot.start()
    robot.stand.width_rate = 0.15
    robot.stand.run(1.0, ZERO_TWIST)
    assert robot.stand.out.trace.more[0].setpoint == pytest.approx(0.15)
    out = robot.stand.cycle(ZERO_TWIST, RequestKind.ESTOP)
    assert (out.trace.more[0].target, out.trace.more[0].setpoint) == (0.0, 0.0)
    assert robot.stand.setpoints == (0.0,) * 4


@pytest.mark.pure_python
def test_what_falls_behind_takes_all_four_axes_back(robot: Robot) -> None:
    """Braking while the wheels stand: setpoint falls back to the measured motion, in every axis alike."""
    robot.start()
    robot.stand.width_rate = 0.2
    robot.stand.run(2.0, ZERO_TWIST)
    robot.stand.motors.measured = dict.fromkeys(range(4), 0.0)
    before = robot.stand.out.trace.more[0].setpoint
    robot.stand.run(0.15)
    widths = robot.stand.out.trace.more[0]
    assert widths.measured == 0.0
    assert widths.setpoint < before


def test_its_state_goes_on_from_a_snapshot() -> None:
    engine = Engine(CONFIG)
    for cycle in range(5):
        engine.step(Inputs(cycle, cycle * 4_000_000))
    engine._limiter.step((*FORWARD, 0.1), 0.004)
    state = engine.snapshot()
    other = Engine(CONFIG, json.loads(json.dumps(state)))
    assert other._limiter.rates == engine._limiter.rates
    assert other._limiter.rates[3] > 0.0
    assert other.snapshot() == state

"""What wheels can follow: shares by hand and by search, and flips of the kinematics driven at the speed allowed."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.control.wheel_acceleration import FlipLimit, pace, within

R, D1, D2 = 0.1, 0.25, 0.4  # Otbot
TOP = 1.2  # m/s
DT = 0.001


def test_pace_by_hand() -> None:
    assert pace((10.0, 10.0), (10.0, 10.0), (1.0, 1.0)) == (1.0, True)
    assert pace((10.0, 20.0), (9.0, 17.0), (1.0, 1.0)) == (0.9, True)  # the second reaches 18 of 20
    assert pace((0.0, 10.0), (0.5, 10.0), (1.0, 1.0)) == (1.0, True)  # down to rest in one cycle
    share, kept = pace((10.0, -10.0), (10.0, 10.0), (1.0, 1.0))  # the second has to turn round first
    assert (share, kept) == (0.0, False)
    assert within((10.0, -10.0), (10.0, 10.0), (1.0, 2.0)) == [10.0, 8.0]


speeds = st.lists(st.floats(-30.0, 30.0), min_size=3, max_size=3)
changes = st.lists(st.floats(0.1, 5.0), min_size=3, max_size=3)


def strain(share: float, wanted: list[float], before: list[float], most: list[float]) -> float:
    return max(abs(share * w - b) / m for w, b, m in zip(wanted, before, most, strict=True))


@settings(max_examples=300, deadline=None)
@given(speeds, speeds, changes)
def test_pace_against_a_search(wanted: list[float], before: list[float], most: list[float]) -> None:
    """No share of a thousand does better, and the wheels are told what they can follow."""
    share, kept = pace(wanted, before, most)
    assert 0.0 <= share <= 1.0
    strains = [(strain(k / 1000.0, wanted, before, most), k / 1000.0) for k in range(1001)]
    if kept:
        assert strain(share, wanted, before, most) <= 1.0 + 1e-9
        assert all(other <= share + 1e-9 for worst, other in strains if worst <= 1.0)
    else:
        assert min(strains)[0] > 1.0
        assert strain(share, wanted, before, most) <= min(strains)[0] + 1e-9
    told = within([share * speed for speed in wanted], before, most)
    for speed, last, change in zip(told, before, most, strict=True):
        assert abs(speed - last) <= change * (1.0 + 1e-12)


def otbot(**changed: float) -> FlipLimit:
    figures = {"wheel_acceleration": 40.0, "joint_acceleration": 15.0, "braking": 1.0} | changed
    return FlipLimit(wheel_radius=R, axle_offset=D1, track=D2, **figures)


class Drive:
    """A straight drive of the kinematics (science 1.1 and 1.3), integrated by small steps."""

    def __init__(self, gamma: float, speed: float) -> None:
        self.gamma, self.speed = gamma, speed
        self.worst_wheel = self.worst_joint = 0.0
        self.slowest = speed
        self.before = self.rates()

    def rates(self) -> tuple[float, float, float]:
        along, across = self.speed * math.cos(self.gamma), self.speed * math.sin(self.gamma)
        turn = across / D1
        return (along - turn * D2 / 2) / R, (along + turn * D2 / 2) / R, -turn

    def go(self, limit: FlipLimit | None) -> None:
        if limit is not None:
            allowed = limit.speed(math.cos(self.gamma), math.sin(self.gamma))
            self.speed = min(allowed, self.speed + limit.braking * DT, TOP)
        self.slowest = min(self.slowest, self.speed)
        tangent = math.tan(self.gamma / 2) * math.exp(-self.speed * DT / D1)
        self.gamma = 2 * math.atan(tangent)
        now = self.rates()
        left, right, joint = (abs(b - a) / DT for a, b in zip(self.before, now, strict=True))
        self.worst_wheel = max(self.worst_wheel, left, right)
        self.worst_joint = max(self.worst_joint, joint)
        self.before = now


@pytest.mark.parametrize("error", [1e-3, 0.02, 0.3])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_flip_at_the_speed_allowed_is_followed_and_the_robot_slowed_before_it(error: float, side: float) -> None:
    """Free: 1.2 m/s asks 66 rad/s^2 of a wheel and 11.5 of the joint (science 1.5, c^2/(R d1) and c^2/d1^2 / 2)."""
    free = Drive(side * (math.pi - error), TOP)
    limit = otbot()
    slowed = Drive(side * (math.pi - error), min(TOP, limit.speed(-math.cos(error), math.sin(error))))
    for _ in range(20_000):
        free.go(None)
        slowed.go(limit)
    assert free.worst_wheel == pytest.approx(65.7, abs=0.5)
    assert free.worst_joint == pytest.approx(11.52, abs=0.05)
    assert slowed.worst_wheel <= 40.0 * 1.01
    assert slowed.worst_joint <= 15.0 * 1.01
    assert slowed.slowest == pytest.approx(0.84, abs=0.03)  # of 1.2: 31.4 rad/s^2 are left for the flip
    assert slowed.speed == pytest.approx(TOP)  # and on it goes, pushed
    assert abs(slowed.gamma) < 1e-3


def test_far_from_a_flip_nothing_is_held_back() -> None:
    limit = otbot()
    assert limit.speed(1.0, 0.0) > 10.0  # pushed
    assert limit.speed(-1.0, 1e-4) > 2.0  # 2 m before a flip
    assert limit.speed(-1.0, 0.0) > 2.0


def test_wheels_that_can_do_it_anyway_hold_nothing_back() -> None:
    limit = otbot(wheel_acceleration=200.0, joint_acceleration=200.0)
    for degrees in range(-179, 180):
        assert limit.speed(math.cos(math.radians(degrees)), math.sin(math.radians(degrees))) > TOP


def test_little_acceleration_leaves_little_for_braking() -> None:
    """A quarter of what the wheels can is kept for slowing down, however hard the body might brake."""
    assert otbot(braking=100.0).braking == pytest.approx(0.25 * 40.0 * 0.1 / math.sqrt(1.64))
    assert otbot(braking=0.5).braking == 0.5

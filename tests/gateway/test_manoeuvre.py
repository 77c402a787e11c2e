"""Manoeuvres as planned, against a chassis moved in small steps by the geometry of the paper and by the kinematics."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.control.manoeuvre import Form, Limits, Pace, Piece, Plan, Way, footprint, landing_speed, pieces_of, plan
from gateway.kinematics.offset_differential import OffsetDifferentialKinematics
from gateway.types import Twist

D1 = 0.25
PACE = Pace(speed=0.3, acceleration=0.4, braking=0.4)
STEPS = 600
turns = st.floats(0.01, math.pi) | st.floats(-math.pi, -0.01)
offsets = st.floats(0.01, 2.0)
forms = st.sampled_from(Form)


class Chassis:
    """The joint at x, y over a chassis that looks to `heading`; and how far from the start it has been."""

    def __init__(self, heading: float = 0.0) -> None:
        self.x = self.y = self.farthest = 0.0
        self.heading = heading

    def go(self, piece: Piece, axle_offset: float) -> None:
        """In small steps: each a turn about the axle's middle or a way along the axis, nothing in closed form."""
        for _ in range(STEPS):
            if piece.way is Way.TURN:
                middle = self.heading + 0.5 * piece.size / STEPS
                step = 2.0 * axle_offset * math.sin(0.5 * piece.size / STEPS)
                self.x, self.y = self.x - step * math.sin(middle), self.y + step * math.cos(middle)
                self.heading += piece.size / STEPS
            else:
                self.x += piece.size / STEPS * math.cos(self.heading)
                self.y += piece.size / STEPS * math.sin(self.heading)
            self.farthest = max(self.farthest, math.hypot(self.x, self.y))


def gone(pieces: tuple[Piece, ...], axle_offset: float, heading: float = 0.0) -> Chassis:
    chassis = Chassis(heading)
    for piece in pieces:
        chassis.go(piece, axle_offset)
    return chassis


@given(form=forms, turn=turns, axle_offset=offsets, heading=st.floats(-3.1, 3.1))
def test_it_turns_the_chassis_by_what_was_asked_for(
    form: Form, turn: float, axle_offset: float, heading: float
) -> None:
    chassis = gone(pieces_of(form, turn, axle_offset), axle_offset, heading)
    assert chassis.heading - heading == pytest.approx(turn, abs=1e-9)
    end = math.hypot(chassis.x, chassis.y)
    chord = 2.0 * axle_offset * abs(math.sin(turn / 2.0))
    assert end == pytest.approx(chord if form is Form.ARC else 0.0, abs=1e-9)


@given(form=forms, turn=turns, axle_offset=offsets)
def test_its_footprint_is_how_far_the_joint_gets(form: Form, turn: float, axle_offset: float) -> None:
    pieces = pieces_of(form, turn, axle_offset)
    farthest = gone(pieces, axle_offset).farthest
    told = footprint(pieces, axle_offset)
    assert farthest <= told + 1e-9
    assert told == pytest.approx(farthest, rel=1e-5)


@given(sizes=st.lists(st.tuples(st.sampled_from(Way), st.floats(-3.0, 3.0)), min_size=1, max_size=4))
def test_so_is_that_of_any_chain_of_pieces(sizes: list[tuple[Way, float]]) -> None:
    pieces = tuple(Piece(way, size) for way, size in sizes)
    assert footprint(pieces, 0.3) == pytest.approx(gone(pieces, 0.3).farthest, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(
    ("form", "degrees", "expected"),
    [
        ("arc", 180.0, 0.5),
        ("arc", -90.0, 0.353553),
        ("arc", 60.0, 0.25),
        ("closed", 180.0, 0.5),
        ("closed", -180.0, 0.5),
    ],
)
def test_footprints_that_can_be_told_by_hand(form: str, degrees: float, expected: float) -> None:
    """d1 = 0.25 m: the chord, and the diameter of half a circle."""
    assert footprint(pieces_of(Form(form), math.radians(degrees), D1), D1) == pytest.approx(expected, abs=1e-6)


def test_half_a_turn_that_ends_in_its_place_is_a_straight_way_and_half_a_circle() -> None:
    ahead, round_ = pieces_of(Form.CLOSED, math.pi, D1)
    assert (ahead.way, round_.way) == (Way.DRIVE, Way.TURN)
    assert (ahead.size, round_.size) == pytest.approx((0.5, math.pi))
    back, ahead, onward = pieces_of(Form.CLOSED, -math.pi / 2.0, D1)
    assert [back.size, ahead.size, onward.size] == pytest.approx([math.pi / 4, 0.3535534, -3 * math.pi / 4])


@given(form=forms, turn=turns, heading=st.floats(-3.1, 3.1))
def test_the_wheels_of_the_kinematics_drive_it_and_the_platform_keeps_its_heading(
    form: Form, turn: float, heading: float
) -> None:
    """Told as to a platform in line with its chassis, at whatever angle it stands: pose by Euler's method of Eq. 9."""
    kinematics = OffsetDifferentialKinematics(wheel_radius=0.1, axle_offset=D1, track=0.4)
    x, y, joint, steps = 0.0, 0.0, -heading, 1500
    for way, size in pieces_of(form, turn, D1):
        way_of_joint = size * (D1 if way is Way.TURN else 1.0)
        velocity = Twist(0.0, way_of_joint, 0.0) if way is Way.TURN else Twist(way_of_joint, 0.0, 0.0)
        speeds = kinematics.wheel_speeds(velocity, [None, None, 0.0])
        assert speeds is not None
        for _ in range(steps):
            estimate = kinematics.twist(speeds, [None, None, joint + 0.5 * speeds[2] / steps])
            assert estimate is not None
            assert estimate.twist.wz == pytest.approx(0.0, abs=1e-9)
            x, y = x + estimate.twist.vx / steps, y + estimate.twist.vy / steps
            joint += speeds[2] / steps
    assert -joint - heading == pytest.approx(turn, abs=1e-9)
    chord = 2.0 * D1 * abs(math.sin(turn / 2.0))
    assert math.hypot(x, y) == pytest.approx(chord if form is Form.ARC else 0.0, abs=1e-6)


def seconds_driven(found: Plan, axle_offset: float) -> float:
    """As the law drives it: rising, its top speed, landing, in steps of 0.1 ms; and 0.1 s to stand after each piece.

    Acceleration grows by the jerk, and falls by it towards top speed: to sqrt(2 j v) with v left of the speed.
    """
    seconds, h, (top, most, braking, jerk) = 0.0, 1e-4, found.pace
    for way, size in found.pieces:
        left, speed, rate = abs(size) * (axle_offset if way is Way.TURN else 1.0), 0.0, 0.0
        while left > 0.01 * axle_offset:
            tail = 0.15 * braking
            landing = math.sqrt(2.0 * braking * left + tail**2) - tail
            rate = min(rate + jerk * h, most, math.sqrt(2.0 * jerk * max(top - speed, 0.0)) + 0.01 * most)
            speed = min(speed + rate * h, top, landing)
            left -= speed * h
            seconds += h
        seconds += 0.1
    return seconds


@pytest.mark.parametrize("form", Form)
@pytest.mark.parametrize("turn", [0.05, 0.8, 1.6, 3.1])
@pytest.mark.parametrize("pace", [PACE, Pace(0.05, 0.4, 0.4), Pace(3.0, 0.4, 0.2)])
def test_it_lasts_as_long_as_it_says(form: Form, turn: float, pace: Pace) -> None:
    found = plan(form, turn, pace, axle_offset=D1)
    assert found.duration == pytest.approx(seconds_driven(found, D1), abs=0.01)


@pytest.mark.parametrize("form", Form)
@pytest.mark.parametrize("turn", [0.8, 1.6, 3.1])
@pytest.mark.parametrize("pace", [Pace(0.3, 0.4, 0.4, 0.5), Pace(0.1, 0.4, 0.4, 0.2), Pace(0.3, 0.4, 0.4, 4.0)])
def test_a_jerk_that_is_low_takes_its_time(form: Form, turn: float, pace: Pace) -> None:
    found = plan(form, turn, pace, axle_offset=D1)
    assert found.duration == pytest.approx(seconds_driven(found, D1), rel=0.05)
    hard = plan(form, turn, pace._replace(jerk=math.inf), axle_offset=D1)
    assert found.duration > hard.duration + 0.02


@given(left=st.floats(1e-6, 10.0), braking=st.floats(0.01, 5.0))
def test_it_lands_by_no_more_than_its_braking(left: float, braking: float) -> None:
    """-v dv/ds, by central differences."""
    step = 1e-4 * left
    slope = (landing_speed(left + step, braking) - landing_speed(left - step, braking)) / (2.0 * step)
    assert landing_speed(left, braking) * slope <= braking * (1.0 + 1e-6)
    assert landing_speed(0.0, braking) == landing_speed(-left, braking) == 0.0


def test_its_pace_is_within_the_command_the_body_and_the_motors() -> None:
    """On an arc of 0.25 m, 0.8 m/s^2: 0.4 are for turning, sqrt(0.4 0.25) = 0.3162 m/s, and 0.4 for changing speed."""
    limits = Limits(velocity=1.2, acceleration=0.8, motor_speed=2.0)
    assert limits.pace(5.0, 0.25) == pytest.approx((0.316228, 0.4, 0.4, math.inf), abs=1e-6)
    assert limits._replace(jerk=0.5).pace(5.0, 0.25).jerk == 0.5
    assert limits.pace(0.1, 0.25).speed == 0.1
    assert limits._replace(velocity=0.2).pace(5.0, 0.25).speed == 0.2
    assert limits._replace(motor_speed=0.15).pace(5.0, 0.25).speed == 0.15
    assert limits._replace(motor_acceleration=0.5).pace(5.0, 0.25) == pytest.approx(
        (0.316228, 0.25, 0.25, math.inf), abs=1e-6
    )

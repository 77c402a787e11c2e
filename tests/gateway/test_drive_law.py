"""What the joints are told for a setpoint of the body, with the kinematics of the bundled robots."""

from math import cos, sin

import pytest

from drivers.setpoint import CommandKind
from gateway.config import parse
from gateway.control.drive_law import BRAKE, Measured, Motion, SpeedLaw
from gateway.core.assembly import build
from gateway.types import ZERO_TWIST, Event, Level, Twist
from tests.world import robot_text

PERIOD = 0.004
FORWARD = Twist(0.5, 0.0, 0.0)


def test_limits_at_work_are_added_and_nothing_else_is_lost() -> None:
    event = Event(Level.INFO, "code", "text")
    motion = Motion((BRAKE,), 0.5, ("motor_speed",), (2.0, None), (event,), turned=0.25)
    told = motion.limited_by(("slip", "velocity"))
    assert told.limits == ("slip", "velocity", "motor_speed")
    assert (told.commands, told.share, told.numbers) == (motion.commands, 0.5, (2.0, None))
    assert (told.events, told.turned) == ((event,), 0.25)
    assert motion.limited_by(()).limits == ("motor_speed",)


def law(name: str, *, top_speed: float = 100.0) -> SpeedLaw:
    robot = build(parse(robot_text(name), name))
    return SpeedLaw(
        robot.kinematics, top_speeds=[top_speed] * len(robot.names), velocity=Twist(1.0, 1.0, 2.0), period=PERIOD
    )


def measured(
    size: int = 3, *, angle: float | None = 0.0, speed: float | None = 0.0, age_ns: int | None = 0
) -> Measured:
    speeds, angles = (0.0,) * (size - 1) + (speed,), (0.0,) * (size - 1) + (angle,)
    return Measured(0, PERIOD, speeds, angles, (None,) * size, (age_ns,) * size, angles)


def speeds(motion: Motion) -> list[float]:
    assert {command.kind for command in motion.commands} == {CommandKind.VELOCITY}
    return [command.value for command in motion.commands]


def test_every_joint_has_the_speed_of_the_kinematics() -> None:
    motion = law("moby").motion(FORWARD, measured(), braking=False)
    assert speeds(motion) == pytest.approx([5.0, 5.0, 0.0])  # wheels of 0.1 m, the joint along the axle's normal
    assert (motion.share, motion.limits) == (1.0, ())


@pytest.mark.parametrize(("top_speed", "share"), [(5.0, 1.0), (4.0, 0.8), (1.0, 0.2)])
def test_one_joint_that_cannot_slows_all(top_speed: float, share: float) -> None:
    motion = law("moby", top_speed=top_speed).motion(FORWARD, measured(), braking=False)
    assert speeds(motion) == pytest.approx([5.0 * share, 5.0 * share, 0.0])
    assert motion.share == pytest.approx(share)
    assert motion.limits == (("motor_speed",) if share < 1.0 else ())


@pytest.mark.parametrize(
    ("angle", "speed", "age_ns", "used"),
    [
        (0.3, 2.0, 1_000_000, 0.3 + 2.0 * 0.005),  # a millisecond old, and a period ahead
        (0.3, -2.0, 0, 0.3 - 2.0 * 0.004),
        (0.3, None, 1_000_000, 0.3),
        (0.3, 2.0, None, 0.3),
    ],
)
def test_a_steered_joint_is_commanded_for_where_it_will_be(
    angle: float, speed: float | None, age_ns: int | None, used: float
) -> None:
    motion = law("moby").motion(FORWARD, measured(angle=angle, speed=speed, age_ns=age_ns), braking=False)
    left, right, joint = speeds(motion)
    assert (left + right) / 2.0 == pytest.approx(5.0 * cos(used))  # along the chassis, which is turned by the angle
    assert joint == pytest.approx(-sin(used) * 0.5 / 0.25)  # axle 0.25 m behind the joint


def test_without_its_angle_the_joints_keep_their_proportion_and_slow_down_with_the_setpoint() -> None:
    blind = law("moby")
    seen = speeds(blind.motion(Twist(0.4, 0.3, 0.2), measured(angle=0.7), braking=False))
    half = speeds(blind.motion(Twist(0.2, 0.15, 0.1), measured(angle=None), braking=True))
    assert half == pytest.approx([speed / 2.0 for speed in seen])
    more = speeds(blind.motion(Twist(0.8, 0.6, 0.4), measured(angle=None), braking=True))
    assert more == pytest.approx(seen), "never faster"
    assert speeds(blind.motion(ZERO_TWIST, measured(angle=None), braking=True)) == [0.0, 0.0, 0.0]


def test_an_angle_that_comes_back_on_the_way_to_rest_is_not_used() -> None:
    blind = law("moby")
    seen = speeds(blind.motion(FORWARD, measured(angle=0.0), braking=False))
    assert speeds(blind.motion(FORWARD, measured(angle=None), braking=True)) == pytest.approx(seen)
    assert speeds(blind.motion(FORWARD, measured(angle=1.5), braking=True)) == pytest.approx(seen)
    assert speeds(blind.motion(FORWARD, measured(angle=1.5), braking=False)) != pytest.approx(seen)


def test_an_angle_never_known_is_no_motion() -> None:
    assert speeds(law("moby").motion(FORWARD, measured(angle=None), braking=False)) == [0.0, 0.0, 0.0]


def test_a_chassis_without_steered_joints_needs_no_angle() -> None:
    motion = law("omni4").motion(Twist(0.0, 0.0, 1.0), measured(4, angle=None), braking=False)
    assert len({round(speed, 9) for speed in speeds(motion)}) == 1


def test_what_stands_by_itself_is_braked_to_stop_and_may_be_let_go() -> None:
    standing = law("moby")
    assert standing.stop(measured()).commands == (BRAKE,) * 3
    assert standing.may_release(measured(speed=1.0))
    assert [standing.moves(measured(), turning=turning) for turning in (True, False, None)] == [True, False, None]


def test_after_an_emergency_stop_a_known_angle_is_used_again() -> None:
    blind = law("moby")
    blind.motion(FORWARD, measured(angle=0.0), braking=False)
    blind.motion(FORWARD, measured(angle=None), braking=True)
    blind.stop(measured(angle=1.5))
    seen = law("moby").motion(FORWARD, measured(angle=1.5), braking=True)
    assert speeds(blind.motion(FORWARD, measured(angle=1.5), braking=True)) == pytest.approx(speeds(seen))

"""The correction of wheels that slip: bounded, never a step, and gone when the slip is."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.setpoint import CommandKind
from gateway.control.drive_law import BRAKE, COAST, JointCommand
from gateway.control.slip_correction import SlipCorrection, Wheel

DT = 0.004
TOP = 45.0  # rad/s
WHEEL = Wheel(radius=0.1, top_speed=TOP, torque=4.5, inertia=0.004)
BOUND = 0.5  # N m: 0.004 kg m^2 moved by 0.05 m/s at 0.1 m in 4 ms
FAST = (20.0, -20.0, 20.0, -20.0)
Speeds = tuple[float, ...]


def correction(wheel: Wheel = WHEEL) -> SlipCorrection:
    return SlipCorrection([wheel] * 4, DT)


def velocities(*speeds: float) -> tuple[JointCommand, ...]:
    return tuple(JointCommand(CommandKind.VELOCITY, speed) for speed in speeds)


def told(
    subject: SlipCorrection,
    speeds: Speeds,
    ahead: Speeds = (),
    slipping: tuple[int, ...] = (),
    measured: tuple[float | None, ...] | None = None,
    *,
    braking: bool = False,
) -> tuple[JointCommand, ...]:
    return subject.corrected(velocities(*speeds), ahead, slipping, measured or speeds, braking=braking, dt=DT)


def settled(ahead: Speeds, slipping: tuple[int, ...] = (), speeds: Speeds = FAST) -> tuple[JointCommand, ...]:
    subject = correction()
    for _ in range(500):
        commands = told(subject, speeds, ahead, slipping)
    return commands


def test_without_slip_nothing_is_changed() -> None:
    subject = correction()
    commands = velocities(*FAST)
    assert subject.corrected(commands, (), (), FAST, braking=False, dt=DT) == commands
    assert not subject.active


def test_an_unknown_wheel_leads_all_of_them_to_the_nearest_speeds_that_fit() -> None:
    values = [command.value for command in settled((0.1, -0.1, 0.1, -0.1))]
    assert values == pytest.approx([19.0, -19.0, 19.0, -19.0], rel=1e-6)
    assert {command.limit for command in settled((0.1, -0.1, 0.1, -0.1))} == {None}


def test_a_known_wheel_is_led_back_alone_and_with_little_torque() -> None:
    commands = settled((0.0, -0.4, 0.0, 0.0), (1,))
    assert [command.value for command in commands] == pytest.approx([20.0, -16.0, 20.0, -20.0], rel=1e-6)
    assert [command.limit for command in commands] == pytest.approx([None, BOUND, None, None])


def test_no_more_than_half_of_what_a_wheel_is_told_and_nothing_of_one_that_is_to_stand() -> None:
    values = [command.value for command in settled((9.0, 9.0, -9.0, -9.0), speeds=(20.0, -20.0, 44.0, 0.0))]
    assert values == pytest.approx([10.0, -30.0, TOP, 0.0])


@given(st.lists(st.tuples(*[st.floats(-3.0, 3.0)] * 4), min_size=2, max_size=40), st.data())
def test_no_step_however_the_slip_comes_and_goes(slips: list[Speeds], data: st.DataObject) -> None:
    """A top speed takes at least half a second; and a wheel never turns the other way."""
    subject = correction()
    before: Speeds = FAST
    for ahead in slips:
        known = (data.draw(st.integers(0, 3)),) if data.draw(st.booleans()) else ()
        values = tuple(command.value for command in told(subject, FAST, ahead, known))
        assert all(abs(new - old) <= TOP * DT / 0.5 + 1e-9 for old, new in zip(before, values, strict=True))
        assert all(value * speed > 0.0 for value, speed in zip(values, FAST, strict=True))
        before = values


def test_it_fades_and_is_over() -> None:
    subject = correction()
    for _ in range(100):
        told(subject, FAST, (0.4, 0.0, 0.0, 0.0), (0,))
    values, limits = [], []
    while subject.active:
        first = told(subject, FAST)[0]
        values.append(first.value)
        limits.append(first.limit)
        assert len(values) < 500
    assert values[-1] == 20.0
    assert limits[-1] is None
    assert all(0.0 <= new - old <= 0.4 for old, new in pairwise(values))
    rising = [limit for limit in limits if limit is not None]
    assert rising == sorted(rising)
    assert len(rising) == 22, "from 0.5 to 4.5 N m at 4.5 N m in 0.1 s"


def test_on_the_way_to_rest_it_speeds_nothing_up_and_leaves_the_torque_alone() -> None:
    subject = correction()
    for _ in range(100):
        commands = told(subject, FAST, (-0.4, -0.4, 0.4, 0.4), (0, 1, 2, 3), braking=True)
    assert [command.value for command in commands] == pytest.approx([20.0, -16.0, 16.0, -20.0], rel=1e-3)
    assert {command.limit for command in commands} == {None}


def test_a_wheel_that_stands_keeps_its_torque_so_that_a_stall_is_seen() -> None:
    subject = correction()
    limits = [told(subject, FAST, (0.4, 0.0, 0.0, 0.0), (0,), (1.9, *FAST[1:]))[0].limit for _ in range(100)]
    assert limits[:12] == pytest.approx([BOUND] * 12), "not yet 0.05 s"
    assert limits[-1] is None
    for _ in range(20):
        unheard = told(subject, FAST, (0.4, 0.0, 0.0, 0.0), (0,), (None, *FAST[1:]))
    assert unheard[0].limit is None


def test_what_is_no_speed_is_left_alone() -> None:
    subject = correction()
    commands = (COAST, BRAKE, JointCommand(CommandKind.TORQUE, 1.0), JointCommand(CommandKind.VELOCITY, 20.0, 0.3, 0.2))
    for _ in range(50):
        changed = subject.corrected(commands, (0.4,) * 4, (0, 1, 2, 3), FAST, braking=False, dt=DT)
    assert changed[:3] == commands[:3]
    assert changed[3].value < 20.0
    assert (changed[3].feed_forward, changed[3].limit) == (0.3, 0.2), "a bound that is less stays"


@pytest.mark.parametrize("wheel", [WHEEL._replace(torque=None), WHEEL._replace(inertia=0.0)])
def test_without_a_bound_that_its_speed_loop_takes_there_is_none(wheel: Wheel) -> None:
    subject = correction(wheel)
    assert told(subject, FAST, (0.4, 0.0, 0.0, 0.0), (0,))[0].limit is None

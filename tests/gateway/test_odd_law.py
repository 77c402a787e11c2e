"""Driving with a width: its range ends softly, what yields to what, where the width is known from. O6 and O8."""

import json
from collections.abc import Iterator
from itertools import pairwise
from math import pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import ConfigError, parse
from gateway.control.drive_law import Measured, SpeedLaw
from gateway.control.odd_law import OddLaw, Yields
from gateway.control.steering import Steering, SteeringGains
from gateway.core.channels import layout_of
from gateway.core.engine import Engine
from gateway.kinematics.contract import Estimate
from gateway.kinematics.odd import OddGeometry, OddKinematics
from gateway.types import ZERO_TWIST, Attitude, Mode, Rates, Region, Twist, TwistCommand, TwistFrame
from replay.drive.closed_loop import ClosedLoop
from replay.sim.plants.odd import OddPlant
from tests.gateway.test_engine_rules import Stand
from tests.world import robot_text

VELOCITY = (2.0, 1.5, 4.0, 0.2)
TOP = 20.0  # rad/s
TOP_RATE = 1.0  # m/s
STILL = (0.0,) * 4
ROLLERS = "[0.7853981633974483, -0.7853981633974483, 0.7853981633974483, -0.7853981633974483]"
FORWARD = Twist(0.3, 0.0, 0.0)


def unsensed(text: str) -> str:
    assert text.count("width_sensor = 0") == 1
    return text.replace("width_sensor = 0", "# width_sensor = 0")


def law(
    yields: Yields = Yields.ALL, *, width: float = 0.4, place: int | None = None, steering: Steering | None = None
) -> OddLaw:
    """Wheels of 0.05 m, from 0.2 to 0.6 m, 0.4 m/s^2 of width."""
    geometry = OddGeometry((pi / 4, -pi / 4, pi / 4, -pi / 4), radius=0.05, spacing=0.1, narrowest=0.2, widest=0.6)
    kinematics = OddKinematics(geometry, start=width)
    wheels = SpeedLaw(kinematics, top_speeds=(TOP,) * 4, velocity=VELOCITY, period=0.004)
    return OddLaw(
        kinematics,
        wheels=wheels,
        top_speeds=(TOP,) * 4,
        top_rate=TOP_RATE,
        acceleration=0.4,
        lateness=0.125,
        yields=yields,
        place=place,
        steering=steering,
    )


def measured(width_rate: float | None = 0.0, *ranges: float | None) -> Measured:
    estimate = None if width_rate is None else Estimate(ZERO_TWIST, None, None, (width_rate,))
    return Measured(0, 0.004, STILL, STILL, STILL, (0,) * 4, STILL, estimate, ranges=ranges)


def aimed(one: OddLaw, target: Rates) -> Rates:
    return one.aim(target, measured(), region=Region.ANY, path_rate=None, whole=True)


# steering


@pytest.mark.parametrize(("wanted", "gyro"), [(0.0, 0.0), (0.02, None)])
def test_what_a_gyro_added_goes_without_a_step_at_rest_and_in_its_silence(wanted: float, gyro: float | None) -> None:
    """A body that is pushed round is held; then it is to rest, or nothing is heard of it any more."""
    one = law(steering=Steering(SteeringGains(2.0, 0.3), top=4.0, acceleration=6.0))
    step = 2.0 * 6.0 * 0.004 * 0.25 / 0.05  # rad/s of an outer wheel: of what was wanted, and of what was added
    wheel = []
    for turn, heard in [(0.02, -2.0)] * 100 + [(wanted, gyro)] * 60:
        told = measured()._replace(attitude=None if heard is None else Attitude(0.0, 0.0, yaw_rate=heard))
        motion = one.motion((0.0, 0.0, turn, 0.0), told, braking=turn == 0.0)
        wheel.append(motion.commands[0].value)
    assert wheel[99] < -4.0
    assert all(abs(after - before) <= step for before, after in pairwise(wheel))
    assert wheel[-1] == pytest.approx(-wanted * 0.25 / 0.05)


# the range of the width


@pytest.mark.parametrize(
    ("width", "rate", "aim", "driven"),
    [
        (0.4, 0.2, 0.2, 0.2),
        (0.575, 0.2, 0.1, 0.14142135623730953),  # sqrt(2 x 0.2 x 0.025), sqrt(2 x 0.4 x 0.025)
        (0.6, 0.2, 0.0, 0.0),
        (0.6, -0.2, -0.2, -0.2),
        (0.225, -0.2, -0.1, -0.14142135623730953),
        (0.2, -0.2, 0.0, 0.0),
        (0.2, 0.2, 0.2, 0.2),
    ],
)
def test_no_rate_that_could_not_stop_within_the_range(width: float, rate: float, aim: float, driven: float) -> None:
    one = law(width=width)
    assert aimed(one, (0.3, 0.1, 0.2, rate)) == pytest.approx((0.3, 0.1, 0.2, aim), abs=1e-9)
    motion = one.motion((0.3, 0.1, 0.2, rate), measured(), braking=False)
    told = one._kinematics.twist([command.value for command in motion.commands])
    assert told is not None
    assert told.rates == pytest.approx((0.3, 0.1, 0.2, driven), abs=1e-9)
    assert ("width" in motion.limits) == (driven != rate)


# what yields


@pytest.mark.parametrize(
    ("yields", "want"),
    [
        (Yields.ALL, (0.95, 0.0, 0.0, 0.2)),
        (Yields.WIDTH, (0.95, 0.0, 0.0, 0.1)),  # of 1 m/s at the rim 0.05 are left, and half of the rate is at the rim
        (Yields.MOTION, (0.9, 0.0, 0.0, 0.2)),
    ],
)
def test_what_yields_by_hand(yields: Yields, want: Rates) -> None:
    assert aimed(law(yields), (0.95, 0.0, 0.0, 0.2)) == pytest.approx(want, abs=1e-12)


axes = st.tuples(*[st.floats(-top, top) for top in (3.0, 3.0, 8.0, 4.0)])


@given(axes, st.sampled_from([Yields.WIDTH, Yields.MOTION]))
def test_what_is_kept_is_kept_and_no_wheel_has_to_turn_faster(target: Rates, yields: Yields) -> None:
    one = law(yields)
    target = one._within(target, 0.2)
    got = aimed(one, target)
    speeds = one._kinematics.wheel_speeds(got)
    assert speeds is not None
    assert max(map(abs, speeds)) <= TOP * (1.0 + 1e-9)
    kept = (*target[:3], 0.0) if yields is Yields.WIDTH else (0.0, 0.0, 0.0, target[3])
    alone = one._kinematics.wheel_speeds(kept)
    assert alone is not None
    whole = min(1.0, TOP / max(TOP, *map(abs, alone)))
    if yields is Yields.WIDTH:
        assert got[:3] == pytest.approx([whole * axis for axis in target[:3]], abs=1e-12)
    else:
        assert got[3] == pytest.approx(whole * target[3], abs=1e-12)


@given(axes)
def test_saturation_scales_all_four_wheels_together(setpoint: Rates) -> None:
    one = law()
    setpoint = one._within(setpoint, 0.4)
    motion = one.motion(setpoint, measured(), braking=False)
    driven = one._kinematics.twist([command.value for command in motion.commands])
    assert driven is not None
    assert driven.rates == pytest.approx([motion.share * axis for axis in setpoint], abs=1e-9)
    assert max(abs(command.value) for command in motion.commands) <= TOP * (1.0 + 1e-12)


# where the width is known from, without a sensor; with one: test_odd_width.py


def widths(one: OddLaw, *cycles: Measured) -> Iterator[float]:
    for cycle in cycles:
        width, _ = one.motion((0.0,) * 4, cycle, braking=False).numbers
        assert width is not None
        yield width


def test_it_is_what_the_wheels_add_up_to() -> None:
    one = law()
    assert list(widths(one, measured(0.5), measured(-0.25), measured(None))) == pytest.approx([0.402, 0.401, 0.401])
    assert one.facts == {"width": pytest.approx(0.401), "width_by": "robot file and wheels", "width_doubt": 0.0}
    assert one.unready is None


def test_it_stays_within_its_stops() -> None:
    assert list(widths(law(width=0.6), measured(1.0))) == [0.6]
    assert list(widths(law(width=0.2), measured(-1.0))) == [0.2]


# a width that is asked for


@pytest.mark.parametrize(
    ("width", "wanted", "rate"),
    [
        (0.4, 0.4, 0.0),
        (0.4, 0.41, 0.02),  # 2 / s
        (0.4, 0.39, -0.02),
        (0.4, 0.6, 0.2828427124746190),  # sqrt(2 x 0.2 x 0.2), as towards an end
        (0.6, 0.2, -0.4),
    ],
)
def test_the_rate_at_which_a_width_is_gone_to(width: float, wanted: float, rate: float) -> None:
    assert law(width=width).width_rate(wanted) == pytest.approx(rate, abs=1e-9)


def test_what_is_asked_for_is_a_channel_of_that_cycle() -> None:
    one = law()
    one.width_rate(0.5)
    assert one.motion(STILL, measured(), braking=False).numbers == (0.4, 0.5)
    assert one.motion(STILL, measured(), braking=False).numbers == (0.4, None)


# the robot file


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("width = 0.4 ", "width = 0.7 ", r"robot: width = 0\.7 m: must be from 0\.25 to 0\.6 m"),
        ("narrowest = 0.25", "narrowest = 0.05", r"robot: width from 0\.05 to 0\.6 m: must begin at the spacing"),
        ("widest = 0.6", "widest = 0.2", r"robot: width from 0\.25 to 0\.2 m"),
        (ROLLERS, ROLLERS.replace("-", ""), r"robot: these roller angles do not drive all four axes"),
        ("[0.7853981633974483", "[1.5707963267948966", r"robot: roller_angle = 1\.5708 rad: its axis lies across"),
        ('yields = "width"', 'yields = "nobody"', "robot.yields = 'nobody'"),
    ],
)
def test_what_cannot_be_is_refused_in_words(old: str, new: str, words: str) -> None:
    text = robot_text("odd")
    assert old in text
    with pytest.raises(ConfigError, match=words):
        Engine(parse(text.replace(old, new, 1), "odd"))


# the engine


@pytest.mark.pure_python
def test_a_width_that_is_driven_ends_at_its_range_without_a_step() -> None:
    """0.2 m/s from 0.4 to 0.6 m: slower from 0.1 m before, and never beyond; the motion goes on."""
    stand, layout = Stand("odd", unsensed), layout_of(parse(robot_text("odd"), "odd"))
    stand.cycle(ZERO_TWIST)
    stand.cycle(ZERO_TWIST)
    assert stand.is_in(Mode.DRIVE)
    stand.width_rate = 0.2
    seen: list[float] = []
    rates: list[float] = []
    for _ in range(1500):
        out = stand.cycle(FORWARD)
        rates.append(out.trace.more[0].setpoint)
        width = layout.named(out.trace)["width"]
        assert isinstance(width, float)
        seen.append(width)
    assert max(rates) == pytest.approx(0.2, abs=1e-6)
    assert 0.595 < seen[-1] <= 0.6
    assert seen == sorted(seen)
    assert max(abs(after - before) for before, after in pairwise(rates)) <= 0.4 * 0.004 * 1.001
    assert abs(rates[-1]) < 0.02
    assert out.trace.setpoint == pytest.approx(FORWARD)


# on its wheels


def test_a_simulated_one_changes_its_width_while_it_drives() -> None:
    """The width that the wheels add up to is that of the plant; the middle goes straight on."""
    config = parse(robot_text("odd"), "odd")
    plant = OddPlant(config.robot)  # type: ignore[arg-type]
    loop = ClosedLoop(config, plant=plant)
    for index in range(750):
        going = index >= 250
        if index % 5 == 0 and index >= 75:
            twist = FORWARD if going else ZERO_TWIST
            command = TwistCommand("teleop", twist, TwistFrame.BODY, None, loop.next_ns)
            loop.cycle(commands=[command._replace(width_rate=0.05 if going else None)])
        else:
            loop.cycle(commands=[])
    restored = Engine(config, json.loads(json.dumps(loop.engine.snapshot())))
    assert restored._law.facts == loop.engine._law.facts
    assert restored._kinematics.wheel_speeds((0.0, 0.0, 1.0, 0.0), ()) == loop.engine._kinematics.wheel_speeds(
        (0.0, 0.0, 1.0, 0.0), ()
    )
    assert loop.engine.mode is Mode.DRIVE
    assert 0.45 < plant.width < 0.51
    assert loop.engine._law.facts["width"] == pytest.approx(plant.width, abs=1e-3)
    assert plant.pose.x > 0.4
    assert abs(plant.pose.y) < 1e-3
    assert abs(plant.pose.theta) < 1e-3

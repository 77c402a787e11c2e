"""A robot that stands on its wheels alone, through the engine on the plant of its dynamics: what it does, and never."""

from collections.abc import Callable
from math import degrees, hypot, pi, radians

import pytest

from gateway.config import ConfigError, parse
from gateway.control.balance import SWAY
from gateway.control.posture import BLIND_NS, LOWERING_NS, READY_NS, STUCK_NS
from gateway.core.assembly import build
from gateway.core.engine import Engine
from gateway.types import ZERO_TWIST, Attitude, Mode, Outputs, Reply, Request, RequestKind, Twist
from tests.upright import NAME, Upright
from tests.world import World, robot_text

FORWARD = Twist(0.8, 0.0, 0.0)
Imu = Callable[[Attitude], Attitude | None]
FALL = 0.6  # rad, of the robot file
TIMEOUT_S = 0.02  # of its IMU


def reason(outputs: Outputs) -> str:
    return "" if outputs.status is None else outputs.status.reason or ""


def never_pushed(robot: Upright, first: int = 0) -> bool:
    """Whether no motor was told a torque in these cycles."""
    return all(not any(frame.data.strip(b"\0") for frame in out.frames) for _, out in robot.records[first:])


# standing up


def test_commands_alone_do_not_make_it_stand_up() -> None:
    robot = Upright()
    robot.run(2.0, ZERO_TWIST)
    robot.run(2.0, FORWARD)
    robot.run(2.0, ZERO_TWIST)
    assert robot.is_in(Mode.IDLE)
    assert never_pushed(robot)
    assert robot.plant.pose.x == 0.0
    assert "ask it to stand up" in reason(next(out for _, out in reversed(robot.records) if out.status))


def test_it_stands_up_when_it_is_asked_and_commanded_zero() -> None:
    robot = Upright()
    robot.plant.lean(radians(5.0))
    robot.stand_up()
    assert abs(robot.plant.pitch) < radians(0.5)
    assert abs(robot.plant.pose.x) < 0.06


def test_the_request_is_forgotten_after_a_while() -> None:
    robot = Upright()
    robot.run(0.3)
    assert robot.ask(RequestKind.STAND_UP).ok
    robot.run(READY_NS * 1e-9)
    robot.run(1.0, ZERO_TWIST)
    assert (robot.mode, never_pushed(robot)) == (Mode.IDLE, True)


def test_a_command_of_motion_does_not_begin_it() -> None:
    robot = Upright()
    robot.run(0.3)
    assert robot.ask(RequestKind.STAND_UP).ok
    robot.run(1.0, FORWARD)
    assert (robot.mode, never_pushed(robot)) == (Mode.IDLE, True)


@pytest.mark.parametrize(
    ("imu", "words"),
    [
        (lambda _: None, "no sensor tells how it leans"),
        (lambda told: told._replace(pitch_rate=None), "does not tell pitch_rate"),
        (lambda told: told._replace(pitch=0.13), "pitch = 0.13 rad: must be from -0.12 to 0.12"),
        (lambda told: told._replace(pitch=-0.13), "pitch = -0.13 rad: must be from -0.12 to 0.12"),
    ],
)
def test_it_does_not_stand_up_from_where_it_would_fall(imu: Imu, words: str) -> None:
    robot = Upright()
    robot.imu = imu
    robot.run(0.3, ZERO_TWIST)
    answer = robot.ask(RequestKind.STAND_UP, ZERO_TWIST)
    assert not answer.ok
    assert words in (answer.reason or "")
    robot.run(1.0, ZERO_TWIST)
    assert (robot.mode, never_pushed(robot)) == (Mode.IDLE, True)


def test_leaning_too_far_after_the_request_holds_it_back() -> None:
    robot = Upright()
    robot.run(0.3)
    assert robot.ask(RequestKind.STAND_UP).ok
    robot.imu = lambda told: told._replace(pitch=0.2)
    robot.run(1.0, ZERO_TWIST)
    assert (robot.mode, never_pushed(robot)) == (Mode.IDLE, True)
    robot.imu = lambda told: told
    robot.run(1.0, ZERO_TWIST)
    assert robot.is_in(Mode.DRIVE)


def test_other_robots_stand_by_themselves() -> None:
    world = World("omni4")
    world.start()
    for kind in (RequestKind.STAND_UP, RequestKind.LET_DOWN):
        replies = world.cycle(requests=[Request(kind, 1, world.now_ns)]).replies
        assert replies == (Reply(1, False, "this robot stands by itself"),)


# standing and driving


@pytest.mark.parametrize("lean", [5.0, -5.0])
def test_a_push_of_five_degrees_is_over_within_a_second_and_a_half(lean: float) -> None:
    robot = Upright(can=True).stand_up()
    robot.plant.lean(robot.plant.pitch + radians(lean))
    leaning = []
    for _ in range(5 * 250):
        robot.cycle(ZERO_TWIST)
        leaning.append(abs(degrees(robot.plant.pitch)))
    last = max(index for index, pitch in enumerate(leaning) if pitch >= 0.5)
    assert last / 250.0 < 1.5
    assert robot.is_in(Mode.DRIVE)


def test_it_drives_and_comes_to_rest() -> None:
    robot = Upright(can=True).stand_up()
    robot.run(4.0, FORWARD)
    assert robot.plant.twist.vx == pytest.approx(0.8, abs=0.05)
    robot.run(4.0, ZERO_TWIST)
    assert abs(robot.plant.twist.vx) < 0.03
    robot.run(4.0, Twist(0.3, 0.3, 1.0))
    assert robot.plant.twist == pytest.approx((0.3, 0.3, 1.0), abs=0.06)


def test_in_a_turn_sideways_it_leans_against_what_throws_it_out() -> None:
    """Three circles of half a metre: without that it ends 25 cm off."""
    robot = Upright(can=True).stand_up()
    where = robot.plant.pose
    robot.run(3 * 2.0 * pi / 0.8, Twist(0.0, 0.4, 0.8))
    robot.run(3.0, ZERO_TWIST)
    assert hypot(robot.plant.pose.x - where.x, robot.plant.pose.y - where.y) < 0.08


def test_the_other_axes_get_what_balancing_leaves_of_the_wheels() -> None:
    robot = Upright(edit=lambda text: text.replace("= 45.0", "= 22.0")).stand_up()
    turning = Twist(1.2, 0.0, 3.0)
    robot.run(4.0, turning)
    for _ in range(3):
        robot.plant.lean(robot.plant.pitch + 0.12)
        robot.cycle(turning)
    limits: set[str] = set()
    for _ in range(4 * 250):
        out = robot.cycle(turning)
        limits.update(out.status.limits_active if out.status else ())
    assert "balance" in limits
    assert robot.is_in(Mode.DRIVE)
    assert abs(robot.plant.pitch) < 0.3


# rest


def test_without_a_driver_it_stands_still_upright_until_it_is_let_down() -> None:
    robot = Upright(can=True).stand_up()
    robot.run(2.0, FORWARD)
    robot.run(5.0)
    assert robot.is_in(Mode.STOPPING)
    assert abs(robot.plant.twist.vx) < SWAY
    where = robot.plant.pose.x
    robot.run(20.0)
    assert robot.is_in(Mode.STOPPING)
    assert robot.plant.pose.x == pytest.approx(where, abs=0.1)
    assert robot.ask(RequestKind.LET_DOWN).ok
    robot.run(LOWERING_NS * 1e-9 + 0.5)
    assert robot.is_in(Mode.IDLE)
    first = len(robot.records)
    robot.run(2.0, ZERO_TWIST)
    assert (robot.mode, never_pushed(robot, first)) == (Mode.IDLE, True)


def test_it_is_not_let_down_while_it_is_driven_or_moves() -> None:
    robot = Upright().stand_up()
    assert "let down while nobody drives it" in (robot.ask(RequestKind.LET_DOWN, ZERO_TWIST).reason or "")
    robot.run(2.0, FORWARD)
    robot.run(0.35)
    assert robot.is_in(Mode.STOPPING)
    assert robot.ask(RequestKind.LET_DOWN).reason == "the robot still moves"
    robot.run(5.0)
    assert robot.is_in(Mode.STOPPING)


def test_what_is_being_let_down_does_not_drive_off_again() -> None:
    robot = Upright().stand_up()
    robot.run(3.0)
    assert robot.ask(RequestKind.LET_DOWN).ok
    robot.run(4.0, FORWARD)
    assert robot.is_in(Mode.IDLE)
    assert abs(robot.plant.pose.x) < 0.1


@pytest.mark.parametrize("category", [1, 2])
def test_an_emergency_stop_stops_it_and_keeps_it_upright(category: int) -> None:
    robot = Upright(edit=lambda text: text + f"\n[stop]\ncategory = {category}\n").stand_up()
    robot.run(4.0, FORWARD)
    where = robot.plant.pose.x
    robot.ask(RequestKind.ESTOP, FORWARD)
    robot.run(4.0, FORWARD)
    assert robot.is_in(Mode.ESTOP)
    assert abs(robot.plant.twist.vx) < SWAY
    assert robot.plant.pose.x - where < 0.8
    assert abs(robot.plant.pitch) < 0.05
    robot.run(1.0)
    assert "would fall" in (robot.ask(RequestKind.RESET).reason or "")
    assert robot.ask(RequestKind.LET_DOWN).ok
    robot.run(2.0)
    assert robot.ask(RequestKind.RESET).ok
    robot.run(0.1, ZERO_TWIST)
    assert robot.is_in(Mode.IDLE)


def test_an_emergency_stop_of_category_0_lets_go_at_once() -> None:
    robot = Upright(edit=lambda text: text + "\n[stop]\ncategory = 0\n", attended=False).stand_up()
    robot.run(2.0, FORWARD)
    robot.ask(RequestKind.ESTOP, FORWARD)
    first = len(robot.records) - 1
    robot.run(3.0, FORWARD)
    assert never_pushed(robot, first)
    assert robot.plant.fallen
    assert robot.is_in(Mode.ESTOP)


def test_only_a_robot_that_balances_has_category_0() -> None:
    config = parse(robot_text("odd") + "\n[stop]\ncategory = 0\n", "odd")
    with pytest.raises(ConfigError, match=r"stop\.category = 0: must be 1 or 2"):
        build(config)


# falling


def fallen(robot: Upright) -> bool:
    return any(event.code == "fault_fallen" for event in robot.events)


@pytest.mark.parametrize("mode", [Mode.DRIVE, Mode.STOPPING, Mode.ESTOP])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_fall_lets_go_at_once_and_nothing_moves_again_by_itself(mode: Mode, way: float) -> None:
    robot = Upright(attended=False).stand_up()
    if mode is Mode.ESTOP:
        robot.ask(RequestKind.ESTOP)
    robot.run(1.0, ZERO_TWIST if mode is Mode.DRIVE else None)
    assert robot.mode is mode
    for lean in (0.12, 0.24, 0.36, 0.48, FALL + 0.01):  # by so little in a cycle that it can be believed
        robot.plant.lean(way * lean)
        robot.cycle(ZERO_TWIST)
    first = len(robot.records) - 1
    robot.run(5.0, ZERO_TWIST)
    robot.run(2.0, FORWARD)
    robot.run(2.0, ZERO_TWIST)
    assert never_pushed(robot, first)
    assert fallen(robot)
    assert robot.mode is (Mode.ESTOP if mode is Mode.ESTOP else Mode.IDLE)
    assert robot.plant.fallen
    robot.plant.lean(0.0)  # somebody lifts it
    robot.plant.attended = True
    robot.run(2.0, ZERO_TWIST)
    robot.run(2.0, FORWARD)
    assert never_pushed(robot, first)


def test_what_is_told_wrong_for_a_moment_does_not_make_it_fall() -> None:
    robot = Upright(attended=False).stand_up()
    for seconds, imu in ((0.004, lambda told: told._replace(pitch=-1.0)), (0.056, lambda _: None)):
        robot.imu = imu
        robot.run(seconds, ZERO_TWIST)
        robot.imu = lambda told: told
        robot.run(2.0, ZERO_TWIST)
        assert robot.is_in(Mode.DRIVE)
        assert abs(robot.plant.pitch) < 0.05


@pytest.mark.parametrize(
    "imu", [lambda _: None, lambda told: told._replace(pitch_rate=None)], ids=["silent", "without its rate"]
)
def test_without_its_imu_it_lets_go(imu: Imu) -> None:
    robot = Upright(attended=False).stand_up()
    robot.imu = imu
    took = robot.run(1.0, ZERO_TWIST, until=lambda now: now.mode is not Mode.DRIVE)
    assert took <= TIMEOUT_S + BLIND_NS * 1e-9 + 0.005
    assert fallen(robot)
    first = len(robot.records) - 1
    robot.run(4.0, ZERO_TWIST)
    robot.imu = lambda told: told
    robot.run(4.0, ZERO_TWIST)
    assert robot.is_in(Mode.IDLE)
    assert never_pushed(robot, first)


def test_an_imu_that_hangs_lets_go() -> None:
    """Its frames go on, each counted, with the same numbers in them."""
    robot = Upright(attended=False, can=True).stand_up()
    robot.loop.bus.robot.sensors["imu"].signals["attitude"].stuck = True
    took = robot.run(1.0, ZERO_TWIST, until=lambda now: now.mode is not Mode.DRIVE)
    assert took < (STUCK_NS + BLIND_NS) * 1e-9 + 0.02
    assert fallen(robot)


@pytest.mark.parametrize("push", [15.0, -15.0])
def test_pushed_for_long_it_leans_and_stands(push: float) -> None:
    robot = Upright(can=True).stand_up()
    robot.plant.push = push
    robot.run(10.0, ZERO_TWIST)
    assert robot.is_in(Mode.DRIVE)
    assert abs(robot.plant.twist.vx) < 0.03
    assert 0.3 < abs(robot.plant.pose.x) < 1.0


@pytest.mark.parametrize("motor", range(4))
def test_without_a_motor_it_is_no_robot_that_drives_on(motor: int) -> None:
    robot = Upright(attended=False).stand_up()
    name = robot.loop.config.robot.motor_names()[motor]
    robot.run(1.0, Twist(0.4, 0.0, 0.0))
    robot.loop.bus.robot.devices[name].power_off()
    robot.run(0.2, Twist(0.4, 0.0, 0.0))
    assert [event.text for event in robot.events if event.code == "balance_lost"] == [
        "a motor is lost, and it will fall: take hold of it"
    ]
    robot.run(5.8, Twist(0.4, 0.0, 0.0))
    status = next(out.status for _, out in reversed(robot.records) if out.status)
    assert status.chassis["can_balance"] is False
    assert robot.mode in {Mode.FAULT, Mode.IDLE}
    assert any(event.code == "fault_silent" for event in robot.events)


@pytest.mark.parametrize("mode", [Mode.DRIVE, Mode.STOPPING, Mode.ESTOP])
def test_a_motor_that_was_gone_is_not_driven_again_before_it_lies(mode: Mode) -> None:
    """Also in an emergency stop, in which motors of other robots are braked whatever they tell."""
    robot = Upright(attended=False, can=True).stand_up()
    if mode is Mode.ESTOP:
        robot.ask(RequestKind.ESTOP)
    twist = ZERO_TWIST if mode is Mode.DRIVE else None
    robot.run(1.0, twist)
    assert robot.is_in(mode)
    lost = robot.loop.bus.robot.devices[robot.loop.config.robot.motor_names()[0]]
    lost.power_off()
    robot.run(0.1, twist)
    lost.power_on()
    first = len(robot.records)
    robot.run(3.0, twist, until=lambda robot: robot.is_in(Mode.IDLE))
    assert len(robot.records) - first > 20
    assert all(out.trace.wheel_setpoints[0] is None for _, out in robot.records[first:])


@pytest.mark.parametrize("seconds", [0.01, 0.06, 1.0])
@pytest.mark.parametrize("mode", [Mode.DRIVE, Mode.STOPPING, Mode.ESTOP])
def test_after_its_bus_was_down_it_stands_or_lies_and_drives_for_nobody(mode: Mode, seconds: float) -> None:
    robot = Upright(attended=False, can=True).stand_up()
    if mode is Mode.ESTOP:
        robot.ask(RequestKind.ESTOP)
    robot.run(1.0, FORWARD if mode is Mode.DRIVE else None)
    assert robot.is_in(mode)
    bus, *others = robot.loop.config.bus
    assert not others
    robot.loop.bus.fail(bus.name)
    robot.run(seconds, FORWARD)
    robot.loop.bus.restore(bus.name)
    robot.run(3.0, FORWARD)
    assert robot.plant.fallen is (seconds > BLIND_NS * 1e-9)
    where, first = robot.plant.pose.x, len(robot.records)
    for twist in (ZERO_TWIST, FORWARD):
        robot.run(1.0, twist)
    assert abs(robot.plant.pose.x - where) < 0.05
    assert not robot.plant.fallen or never_pushed(robot, first)


def test_after_a_restart_it_is_down() -> None:
    robot = Upright(attended=False).stand_up()
    robot.loop.restart(robot.loop.next_ns + 500_000_000)
    first = len(robot.records)
    robot.run(5.0, ZERO_TWIST)
    assert robot.is_in(Mode.IDLE)
    assert never_pushed(robot, first)


# state

COURSE = (
    (RequestKind.STAND_UP, 0.5, ZERO_TWIST),
    (None, 1.0, FORWARD),
    (None, 3.0, None),
    (RequestKind.LET_DOWN, 0.5, None),
    (RequestKind.ESTOP, 0.2, None),
)


def test_restored_at_any_cycle_it_goes_on_byte_for_byte() -> None:
    robot = Upright(attended=False, can=True)
    states = {}
    robot.run(0.3, ZERO_TWIST)
    for request, seconds, twist in COURSE:
        if request is not None:
            assert robot.ask(request, twist).ok
        robot.run(seconds, twist)
        states[len(robot.records)] = robot.loop.engine.snapshot()
    robot.run(2.0)
    for start, state in states.items():
        engine = Engine(robot.loop.config, state)
        for inputs, outputs in robot.records[start:]:
            assert repr(engine.step(inputs)) == repr(outputs)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("velocity = 1.3         #", "velocity = 1.0         #", "velocity = 1: must be above 1"),
        ("pitch_rate = 0.2", "pitch_rate = 0.08", "pitch_rate = 0.08: must be above"),
        ("{ outer_left = 45.0,", "{ outer_left = 18.0,", r"limits\.velocity\.vx = 1\.2: must be at most 0\.9"),
        ("fall = 0.6 ", "fall = 0.11 ", "catch = 0.12: must be below fall, 0.11"),
        ("lag = 0.02 ", "lag = 0.2 ", "these gains do not catch it"),
    ],
)
def test_what_cannot_balance_is_refused_in_words(before: str, after: str, words: str) -> None:
    text = robot_text(NAME)
    assert text.count(before) == 1
    with pytest.raises(ConfigError, match=words):
        Engine(parse(text.replace(before, after), NAME))


def test_its_state_tells_how_it_stands() -> None:
    robot = Upright()
    robot.plant.lean(0.05)
    robot.run(0.5)
    status = next(out.status for _, out in reversed(robot.records) if out.status)
    assert status.chassis["stance"] == "down"
    assert status.chassis["pitch"] == pytest.approx(0.05)
    robot.stand_up()
    status = next(out.status for _, out in reversed(robot.records) if out.status)
    assert status.chassis["stance"] == "up"

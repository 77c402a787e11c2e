"""The core against simulated controllers: what a user relies on, in virtual time, on both robots."""

import itertools
from math import hypot, pi

import pytest

from drivers.contract import MotorState
from gateway.control.drive_law import Measured
from gateway.core.health import Fault, FaultKind
from gateway.types import ZERO_TWIST, Mode, Reply, Request, RequestKind, Status, Twist, TwistFrame
from tests.world import NAMES, World

FORWARD = Twist(0.4, 0.0, 0.0)
both = pytest.mark.parametrize("name", NAMES)


def moving(name: str) -> World:
    world = World(name)
    world.start()
    world.run(2.0, FORWARD)
    assert world.bus.robot.truth.twist[0] == pytest.approx(0.4, abs=0.02)
    return world


@both
def test_nothing_moves_at_start_under_a_streaming_commander(name: str) -> None:
    world = World(name)
    world.run(2.0, FORWARD)
    assert world.is_in(Mode.IDLE)
    assert world.true_speed() == 0.0
    assert world.last.status is None or world.last.status.reason == "waiting for a zero command from teleop"
    world.run(1.0, ZERO_TWIST)
    assert world.is_in(Mode.DRIVE)
    assert world.true_speed() < 1e-3


@both
@pytest.mark.parametrize("twist", [FORWARD, Twist(0.0, 0.3, 0.0), Twist(0.0, 0.0, 0.7), Twist(0.3, -0.2, 0.5)])
def test_drives_what_is_commanded_and_knows_where_it_is(name: str, twist: Twist) -> None:
    world = World(name)
    world.start()
    world.run(4.0, twist)
    assert world.last.trace.measured == pytest.approx(twist, abs=0.02)
    assert world.bus.robot.truth.twist == pytest.approx(twist, abs=0.02)
    world.run(3.0, ZERO_TWIST)
    pose, truth = world.last.trace.pose, world.bus.robot.truth.pose
    assert hypot(pose.x - truth.x, pose.y - truth.y) < 0.02
    assert pose.theta == pytest.approx(truth.theta, abs=0.01)


@both
def test_silence_ramps_to_rest_within_the_limits(name: str) -> None:
    world = moving(name)
    begin = len(world.records)
    world.run(4.0)
    assert world.is_in(Mode.IDLE)
    assert world.true_speed() < 0.02
    speeds = [outputs.trace.setpoint.vx for _, outputs in world.records[begin:]]
    assert all(after <= before + 1e-12 for before, after in itertools.pairwise(speeds)), "never faster"
    steepest = max(before - after for before, after in itertools.pairwise(speeds))
    assert steepest <= world.config.limits.acceleration.vx * world.period_ns * 1e-9 * (1 + 1e-6), "never a step"
    timeout = 0.3 + FORWARD.vx / world.config.limits.acceleration.vx + 0.5
    rest = next(index for index, speed in enumerate(speeds) if speed == 0.0)
    assert rest * world.period_ns * 1e-9 < timeout


@both
def test_a_commander_that_returns_after_rest_must_send_zero_first(name: str) -> None:
    world = moving(name)
    world.run(4.0)
    world.run(2.0, FORWARD)
    assert world.is_in(Mode.IDLE)
    assert world.true_speed() < 0.02
    world.run(0.5, ZERO_TWIST)
    world.run(1.0, FORWARD)
    assert world.is_in(Mode.DRIVE)


@both
def test_a_short_dropout_is_only_a_dip_where_the_commander_tells_when_it_sent(name: str) -> None:
    world = World(name)
    world.start()
    world.run(0.2, ZERO_TWIST, stamped=True)
    world.run(2.0, FORWARD, stamped=True)
    world.run(0.4)
    assert world.is_in(Mode.STOPPING)
    world.run(1.5, FORWARD, stamped=True)
    assert world.is_in(Mode.DRIVE)
    assert world.bus.robot.truth.twist[0] == pytest.approx(0.4, abs=0.02)


@both
def test_without_a_stamp_a_silence_needs_a_new_zero(name: str) -> None:
    """What comes after a silence may be the past of a commander that is long dead."""
    world = moving(name)
    world.run(0.4)
    assert world.is_in(Mode.STOPPING)
    world.run(3.0, FORWARD)
    assert world.is_in(Mode.IDLE)
    assert world.true_speed() < 0.02


@both
def test_priorities_and_their_reasons(name: str) -> None:
    world = World(name)
    world.start()
    world.cycle(commands=[world.command(ZERO_TWIST, "autonomy")])
    for index in range(500):
        commands = [world.command(Twist(0.2, 0, 0), "autonomy")] if index % 5 == 0 else []
        if index < 250 and index % 5 == 0:
            commands.append(world.command(Twist(0.0, 0.3, 0.0), "teleop"))
        world.cycle(commands=commands)
        status = world.last.status
        if index == 200:
            assert world.last.trace.target == Twist(0.0, 0.3, 0.0)
        if status is not None and 100 < index < 240:
            assert status.winner == "teleop"
            assert [source.reason for source in status.sources] == [None, "outranked by teleop"]
        if status is not None and index > 350:
            assert status.winner == "autonomy"
            assert status.sources[0].reason == "silent for longer than its timeout of 0.3 s"
    assert world.last.trace.target == Twist(0.2, 0.0, 0.0)
    assert world.is_in(Mode.DRIVE)


@both
def test_emergency_stop_is_quick_latched_and_released_only_at_rest(name: str) -> None:
    world = moving(name)
    world.request(RequestKind.ESTOP)
    assert world.is_in(Mode.ESTOP)
    reply = world.request(RequestKind.RESET)
    assert reply is not None
    assert not reply.ok
    assert reply.reason == "teleop commands motion; commands must be zero"
    world.run(1.0, FORWARD)
    assert world.is_in(Mode.ESTOP)
    assert world.true_speed() < 0.02
    world.run(0.5)
    reply = world.request(RequestKind.RESET)
    assert reply is not None
    assert reply.ok
    world.run(1.0, FORWARD)
    assert world.is_in(Mode.IDLE)
    assert world.true_speed() < 0.02
    world.run(1.0, ZERO_TWIST)
    assert world.is_in(Mode.DRIVE)


@both
def test_reset_is_refused_while_the_robot_still_moves(name: str) -> None:
    world = moving(name)
    world.run(0.3)
    world.request(RequestKind.ESTOP)
    reply = world.request(RequestKind.RESET)
    assert reply is not None
    assert reply.reason == "the robot still moves"


@both
def test_a_zero_from_before_the_release_does_not_start_the_robot(name: str) -> None:
    """The last zero is still fresh when the stop is released; only one sent after it may start the robot."""
    world = World(name)
    world.start()
    world.run(0.2, ZERO_TWIST)
    world.request(RequestKind.ESTOP)
    reply = world.request(RequestKind.RESET)
    assert reply is not None
    assert reply.ok
    world.run(0.5)
    assert world.is_in(Mode.IDLE)
    assert "mode_starting" not in world.codes()[world.codes().index("mode_estop") :]


@both
def test_a_source_that_never_sent_zero_does_not_inherit_the_robot(name: str) -> None:
    world = World(name)
    world.start()
    for index in range(400):
        commands = [world.command(FORWARD, "autonomy")] if index % 5 == 0 else []
        if index < 100 and index % 5 == 0:
            commands.append(world.command(ZERO_TWIST, "teleop"))
        world.cycle(commands=commands)
    assert world.is_in(Mode.IDLE)
    assert world.true_speed() < 0.001
    status = next(outputs.status for _, outputs in reversed(world.records) if outputs.status)
    assert status.sources[1].reason == "has to send zero first"
    assert status.reason == "waiting for a zero command from autonomy"


@both
def test_another_sender_of_the_same_source_needs_its_own_zero(name: str) -> None:
    world = moving(name)
    stranger = [world.command(FORWARD)._replace(sender="somebody else")]
    world.cycle(commands=stranger)
    assert world.is_in(Mode.STOPPING)


@both
def test_a_reset_looks_at_every_fresh_source(name: str) -> None:
    world = World(name)
    world.start()
    world.request(RequestKind.ESTOP)
    for index in range(100):
        commands = [world.command(FORWARD, "autonomy"), world.command(ZERO_TWIST, "teleop")]
        world.cycle(commands=commands if index % 5 == 0 else [])
    reply = world.request(RequestKind.RESET)
    assert reply is not None
    assert reply.reason == "autonomy commands motion; commands must be zero"


@both
def test_a_reset_arms_nothing(name: str) -> None:
    world = World(name)
    world.run(0.5)
    reply = world.request(RequestKind.RESET)
    assert reply is not None
    assert reply.ok
    world.run(0.5, FORWARD)
    assert world.is_in(Mode.IDLE)


def test_offset_robot_stops_when_a_motor_goes_silent_and_recovers_without_moving() -> None:
    world = moving("moby")
    world.bus.robot.devices["left"].unplug()
    world.run(1.0, FORWARD)
    assert world.is_in(Mode.FAULT)
    assert "fault_silent" in world.codes()
    world.run(3.0, FORWARD)
    assert world.true_speed() < 0.02
    world.bus.robot.devices["left"].plug()
    world.run(2.0, FORWARD)
    assert world.is_in(Mode.IDLE), "recovery is automatic"
    assert world.true_speed() < 0.02, "motion is not"
    world.run(2.0, ZERO_TWIST)
    assert world.is_in(Mode.DRIVE)


def test_omni_robot_drives_on_with_three_motors() -> None:
    world = moving("omni4")
    world.bus.robot.devices["rear_left"].power_off()
    world.run(2.0, FORWARD)
    assert world.is_in(Mode.DEGRADED)
    assert world.bus.robot.truth.twist[0] == pytest.approx(0.4, abs=0.03)
    world.bus.robot.devices["front_left"].power_off()
    world.run(4.0, FORWARD)
    assert world.is_in(Mode.FAULT)
    assert world.true_speed() < 0.05


def test_a_motor_that_answers_late_is_waited_for_one_that_never_does_is_driven_without() -> None:
    late = World("omni4")
    late.bus.robot.devices["front_right"].power_off()
    late.run(1.0, ZERO_TWIST)
    assert late.is_in(Mode.IDLE)
    late.bus.robot.devices["front_right"].power_on()
    late.run(1.0, ZERO_TWIST)
    assert late.is_in(Mode.DRIVE)
    absent = World("omni4")
    absent.bus.robot.devices["front_right"].power_off()
    absent.run(4.0, ZERO_TWIST)
    assert absent.is_in(Mode.DEGRADED)


def test_motors_that_appear_one_after_the_other_are_waited_for_however_long_they_were_all_silent() -> None:
    """Their supply comes on long after the service, under a commander that asks to start all the time."""
    world = World("omni4")
    motors = [world.bus.robot.devices[name] for name in world.config.robot.motor_names()]
    for motor in motors:
        motor.power_off()
    world.run(5.0, ZERO_TWIST)
    for motor in motors:
        motor.power_on()
        assert world.is_in(Mode.IDLE)
        world.run(1.0, ZERO_TWIST)
    assert world.is_in(Mode.DRIVE)
    assert {mode for mode in (outputs.mode for _, outputs in world.records)} == {Mode.IDLE, Mode.STARTING, Mode.DRIVE}


def test_after_the_last_one_has_appeared_it_is_not_waited_for_ever() -> None:
    world = World("omni4")
    motors = [world.bus.robot.devices[name] for name in world.config.robot.motor_names()]
    for motor in motors:
        motor.power_off()
    world.run(5.0, ZERO_TWIST)
    for motor in motors[:3]:
        motor.power_on()
    world.run(2.5, ZERO_TWIST)
    assert world.is_in(Mode.IDLE)
    world.run(1.5, ZERO_TWIST)
    assert world.is_in(Mode.DEGRADED)


@both
def test_bus_loss_stops_and_comes_back_at_rest(name: str) -> None:
    world = moving(name)
    world.bus.fail("can0")
    world.run(1.0, FORWARD)
    assert world.is_in(Mode.FAULT)
    status = next(outputs.status for _, outputs in reversed(world.records) if outputs.status)
    assert any(fault.startswith("can0") for fault in status.faults)
    world.bus.restore("can0")
    world.run(4.0, FORWARD)
    assert world.is_in(Mode.IDLE)
    assert world.true_speed() < 0.02
    world.run(2.0, ZERO_TWIST)
    assert world.is_in(Mode.DRIVE)


@both
def test_world_frame_commands_keep_their_direction_while_turning(name: str) -> None:
    world = World(name)
    world.start()
    world.run(4.0, Twist(0.3, 0.0, 0.5), frame=TwistFrame.ODOM)
    truth = world.bus.robot.truth.pose
    assert truth.x > 0.8
    assert abs(truth.y) < 0.08 * truth.x
    assert truth.theta > 1.5


@both
def test_shutdown_comes_to_rest_and_releases_the_motors(name: str) -> None:
    world = moving(name)
    world.request(RequestKind.SHUTDOWN)
    world.run(5.0, FORWARD, until=lambda outputs: outputs.finished)
    assert world.last.finished
    assert world.is_in(Mode.IDLE)
    assert world.true_speed() < 0.02
    assert set(world.last.trace.wheel_setpoints) == {None}


@both
def test_shutdown_from_idle_is_immediate(name: str) -> None:
    world = World(name)
    world.run(0.2)
    world.request(RequestKind.SHUTDOWN)
    assert world.last.finished


def last_status(world: World) -> Status:
    return next(outputs.status for _, outputs in reversed(world.records) if outputs.status)


def incremental(name: str = "moby") -> World:
    """The same robot with an encoder at its joint that counts from power-on."""
    world = World(name, edit=lambda text: text.replace('encoder = "absolute"', 'encoder = "incremental"'))
    world.run(0.3)
    return world


def reference(world: World, angle: float = 0.0, motor: str | None = None) -> Reply:
    request = Request(RequestKind.REFERENCE, 5, world.now_ns + world.period_ns, motor, angle)
    return world.cycle(requests=[request]).replies[0]


def test_a_joint_that_is_not_absolute_must_be_referenced_before_the_robot_drives() -> None:
    world = incremental()
    world.run(4.0, ZERO_TWIST)
    assert world.is_in(Mode.IDLE)
    unknown = "platform: joint angle unknown (its encoder is not absolute): drivegate reference moby"
    assert last_status(world).faults == (unknown,)
    assert not reference(world, motor="left").ok
    assert reference(world) == Reply(5, ok=True, reason=None)
    world.run(1.0, ZERO_TWIST)
    assert world.is_in(Mode.DRIVE)
    assert reference(world).reason == "the robot is in mode drive; a joint is referenced at rest"


def test_a_referenced_joint_stands_where_it_was_said_to() -> None:
    """The joint stands at 90 degrees and its counter at zero: after the reference the robot drives forward."""
    world = World(
        "moby",
        edit=lambda text: text.replace('encoder = "absolute"', 'encoder = "incremental"'),
        joint_angles={"platform": pi / 2},
    )
    world.bus.robot.devices["platform"].power_off()
    world.bus.robot.devices["platform"].power_on()
    world.run(0.5)
    assert reference(world, angle=pi / 2).ok
    world.run(1.0, ZERO_TWIST)
    world.run(1.0, FORWARD)
    truth = world.bus.robot.truth.twist
    assert truth.vx == pytest.approx(0.4, abs=0.1)
    assert abs(truth.vy) < 0.01


def test_a_joint_that_jumps_is_not_believed_and_a_reset_does_not_change_that() -> None:
    """A controller that lost its position would send the offset robot the wrong way."""
    world = World("moby")
    world.start()
    world.run(1.0, Twist(0.3, 0.3, 0.0))
    before = [abs(speed or 0.0) for speed in world.last.trace.wheel_setpoints]
    world.bus.robot.shift_encoder("platform", 1.0)
    outputs = world.run(0.02, Twist(0.3, 0.3, 0.0))
    assert world.is_in(Mode.FAULT)
    after = [abs(speed or 0.0) for speed in outputs.trace.wheel_setpoints]
    assert all(new <= old for new, old in zip(after, before, strict=True)), "in proportion, without the angle"
    world.run(3.0)
    assert world.true_speed() < 0.01
    reply = world.request(RequestKind.RESET)
    assert reply is not None
    assert reply.reason == "platform: joint angle unknown (its position jumped): reference it first"
    assert reference(world).ok
    world.run(0.1)
    assert world.is_in(Mode.IDLE)


def test_a_runaway_releases_every_motor_at_once_however_many_wheels_there_are() -> None:
    """Two opposite wheels of omni4 with a wrong sign: the other two alone would be driven on, to 4.5 m/s."""
    world = World("omni4")
    world.start()
    world.run(1.0, Twist(1.0, 0.0, 0.5))
    for name in ("front_left", "rear_right"):
        world.bus.robot.drivetrain(name).gain = -1.0
    fastest = 0.0
    for _ in range(250):
        outputs = world.run(0.004, Twist(1.0, 0.0, 0.5))
        fastest = max(fastest, world.true_speed())
    assert "fault_runaway" in {event.code for event in world.events}
    assert world.is_in(Mode.FAULT)
    assert set(outputs.trace.wheel_setpoints) == {None}
    assert fastest < 3.0


def test_a_robot_that_stopped_while_its_bus_was_away_stays_at_rest() -> None:
    """A relay cut the supply of the motors meanwhile: what they were told before the bus went counts no more."""
    world = World("omni4")
    world.start()
    world.run(2.0, Twist(1.5, 0.0, 0.0))
    world.bus.fail("can0")
    world.run(0.2)
    for device in world.bus.robot.devices.values():
        device.power_off()
        device.power_on()
    world.run(5.0)
    assert world.true_speed() < 0.05
    world.bus.restore("can0")
    fastest = 0.0
    for _ in range(100):
        world.run(0.004)
        fastest = max(fastest, world.true_speed())
    assert fastest < 0.05


def test_a_joint_that_jumps_while_it_stands_is_not_believed_either() -> None:
    """However long it stood: nothing turns by 1.2 rad between two measurements of 4 ms."""
    world = World("moby")
    world.start()
    world.run(1.0, ZERO_TWIST)
    world.bus.robot.shift_encoder("platform", 1.2)
    world.run(2.0, Twist(0.5, 0.0, 0.0))
    assert world.is_in(Mode.FAULT)
    assert world.true_speed() < 0.01
    assert "fault_position_unknown" in {event.code for event in world.events}


def test_wheels_saturate_together() -> None:
    """Both axes at once ask more of a wheel than it has: all are scaled, the direction stays."""
    world = World("moby")
    world.start()
    world.run(6.0, Twist(1.2, 1.2, 1.0))
    setpoint = world.last.trace.setpoint
    wheels = [abs(speed or 0.0) for speed in world.last.trace.wheel_setpoints]
    top = world.config.limits.motor_speed
    assert all(speed <= limit * (1 + 1e-9) for speed, limit in zip(wheels, top.values(), strict=True))
    assert setpoint.vx == pytest.approx(setpoint.vy)


def test_feedback_is_in_si_at_the_output() -> None:
    world = World("omni4")
    world.start()
    world.run(3.0, Twist(0.0, 0.0, pi / 4))
    expected = pi / 4 * 0.2 / 0.0762
    assert world.last.trace.wheel_speeds == pytest.approx([expected] * 4, rel=0.02)
    assert all(feedback.state is MotorState.OPERATIONAL for feedback in world.engine._motors.feedback)


@both
def test_category_1_releases_at_rest_and_category_2_goes_on_holding(name: str) -> None:
    for category, held in ((1, False), (2, True)):
        world = World(name, edit=lambda text, number=category: f"{text}\n[stop]\ncategory = {number}\n")  # type: ignore[misc]
        world.start()
        world.run(1.0, FORWARD)
        world.request(RequestKind.ESTOP)
        world.run(3.0)
        assert world.is_in(Mode.ESTOP)
        assert (None not in world.last.trace.wheel_setpoints) is held
        assert last_status(world).stop_category == category
        assert world.true_speed() < 0.02
        world.request(RequestKind.SHUTDOWN)
        world.run(0.5)
        assert world.last.finished, "what is held does not keep the process alive"
        assert set(world.last.trace.wheel_setpoints) == {None}


@both
def test_a_robot_that_rolls_in_an_emergency_stop_is_braked_again_and_held(name: str) -> None:
    world = World(name)
    world.start()
    world.request(RequestKind.ESTOP)
    world.run(1.0)
    assert set(world.last.trace.wheel_setpoints) == {None}
    world.bus.robot.set_slope(0.15)
    world.run(3.0)
    assert set(world.last.trace.wheel_setpoints) == {0.0}
    assert world.true_speed() < 0.02
    assert abs(world.bus.robot.truth.pose.x) < 0.3


def test_all_motors_are_released_at_once_when_one_runs_away() -> None:
    world = moving("moby")
    world.bus.robot.drivetrain("left").gain = -1.0
    world.run(0.5, FORWARD, until=lambda outputs: outputs.mode is Mode.FAULT)
    assert world.is_in(Mode.FAULT)
    assert set(world.last.trace.wheel_setpoints) == {None}
    world.request(RequestKind.ESTOP)
    world.run(0.1)
    assert set(world.last.trace.wheel_setpoints) == {None}, "no brake whose sign is wrong"


def test_a_joint_angle_that_comes_back_while_braking_makes_no_wheel_step() -> None:
    """The chassis turned under the platform while nobody could see it."""
    world = World("moby")
    world.start()
    swinging = Twist(-0.8, 0.1, -0.5)
    world.run(1.3, swinging)
    world.bus.fail("can0")
    world.run(0.08, swinging)
    world.bus.restore("can0")
    world.run(0.5, swinging)
    assert world.is_in(Mode.FAULT)
    pairs = itertools.pairwise(outputs.trace.wheel_setpoints for _, outputs in world.records[-240:])
    steps = [abs(b - a) for old, new in pairs for a, b in zip(old, new, strict=True) if a is not None and b is not None]
    assert max(steps) < 0.5


@pytest.mark.pure_python
def test_a_motor_released_while_driving_is_not_driven_again_on_the_way_to_rest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A stalled wheel that would still obey, and a controller that goes on saying so, have been let go all the same."""
    world = moving("omni4")
    place = world.config.robot.motor_names().index("front_left")
    motors = world.engine._motors
    measure = motors.measure

    def measure_eager(now_ns: int, dt: float) -> Measured:
        measured = measure(now_ns, dt)
        feedback = list(motors.feedback)
        feedback[place] = feedback[place]._replace(state=MotorState.OPERATIONAL)
        motors.feedback = tuple(feedback)
        return measured

    monkeypatch.setattr(motors, "measure", measure_eager)
    world.engine._health.latch(Fault(FaultKind.STALL, "front_left", "stands still", latched=True))
    world.run(0.3, FORWARD)
    assert world.is_in(Mode.DEGRADED)
    released = len(world.records)
    world.run(1.5)
    assert "mode_stopping" in world.codes()
    assert {outputs.trace.wheel_setpoints[place] for _, outputs in world.records[released:]} == {None}


@both
def test_the_setpoint_waits_while_no_motor_can_be_reached(name: str) -> None:
    """Nobody follows it meanwhile; a ramp that ran on would be a step for motors that still do what they were told."""
    world = moving(name)
    world.bus.fail("can0")
    world.run(0.4, FORWARD)
    setpoints = {outputs.trace.setpoint for _, outputs in world.records[-80:]}  # once their silence shows
    assert len(setpoints) == 1
    assert setpoints.pop().vx == pytest.approx(FORWARD.vx, abs=0.03)


def test_a_setpoint_that_nobody_follows_falls_back_to_what_is_measured() -> None:
    """The watchdogs have let go: the robot rolls out, and the setpoint with it, down to the slack."""
    world = World("moby")
    world.start()
    world.run(3.0, Twist(1.0, 0.0, 0.0))
    world.bus.fail("can0")
    world.run(0.4)
    world.bus.restore("can0")
    world.run(1.5)
    trace = world.last.trace
    assert trace.measured is not None
    assert 0.2 < trace.measured.vx < 0.9
    assert trace.setpoint.vx < trace.measured.vx + 0.13


def test_motors_are_judged_anew_after_a_pause_of_the_loop() -> None:
    """What happened meanwhile fits no period: a speed gained in it is no runaway."""
    world = moving("omni4")
    before = world.engine._health._detectors
    world.cycle()
    assert world.engine._health._detectors is before
    world.loop.pause(world.now_ns + 500_000_000)
    world.cycle()
    assert world.engine._health._detectors is not before


def test_the_odometry_is_as_sure_of_itself_as_the_robot_file_says() -> None:
    """Hundred times the variance per metre: that of the position across a straight line, its start taken off."""
    told = []
    for edit in (str, lambda text: f"{text}\n[odometry]\nvariance_per_metre = 0.04\n"):
        world = World("omni4", edit=edit)
        world.start()
        world.run(1.5, Twist(0.3, 0.0, 0.0))
        (odometry,) = [outputs.odometry for _, outputs in world.records if outputs.odometry is not None][-1:]
        assert odometry is not None
        told.append(odometry.covariance[0] - 1e-6)
    assert told[1] == pytest.approx(100.0 * told[0], rel=0.05)

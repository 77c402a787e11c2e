"""The rules of the core cycle by cycle, with motors that turn exactly as they are told or as a test says."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from math import pi

import pytest

from drivers.contract import CanFrame, DriverFault, MotorFeedback, MotorState
from drivers.setpoint import CommandKind, MotorCommand
from gateway.config import RobotConfig, parse
from gateway.control.drive_law import Motion
from gateway.control.transmission import Transmission
from gateway.core.assembly import Group, Robot, build
from gateway.core.engine import Engine
from gateway.core.health import Fault, FaultKind, Health
from gateway.kinematics.contract import Estimate
from gateway.types import (
    ZERO_TWIST,
    BusEvent,
    BusEventKind,
    Inputs,
    Mode,
    Outputs,
    Region,
    Request,
    RequestKind,
    Twist,
    TwistCommand,
    TwistFrame,
)
from tests.world import NAMES, robot_text

pytestmark = pytest.mark.pure_python  # the motors are put in place of the drivers that the engine builds

MS = 1_000_000
SECOND = 1000 * MS
FORWARD = Twist(0.4, 0.0, 0.0)
DRIVE, DEGRADED, STOPPING, IDLE = Mode.DRIVE, Mode.DEGRADED, Mode.STOPPING, Mode.IDLE
STARTING, ESTOP, FAULT = Mode.STARTING, Mode.ESTOP, Mode.FAULT
OPERATIONAL, SILENT, READY = MotorState.OPERATIONAL, MotorState.SILENT, MotorState.IDLE
both = pytest.mark.parametrize("name", NAMES)


class Notes:
    """A driver of all motors; `measured` overrules the speed of a motor, `states` what it says of itself."""

    def __init__(self, size: int) -> None:
        self.commands = [MotorCommand(CommandKind.COAST)] * size
        self.states = [OPERATIONAL] * size
        self.faults: dict[int, DriverFault] = {}
        self.measured: dict[int, float] = {}
        self.torques: dict[int, float] = {}
        self.positions = [0.0] * size
        self.age_ns = 0
        self.cleared = 0
        self.heard: list[int] = []

    def receive(self, frame: CanFrame) -> bool:
        self.heard.append(frame.id)
        return True

    def turn(self, seconds: float) -> None:
        for index in range(len(self.positions)):
            self.positions[index] += self.speed(index) * seconds

    def speed(self, index: int) -> float:
        return self.measured.get(index, self.commands[index].value)

    def feedback(self, *, now_ns: int) -> list[MotorFeedback]:
        return [
            MotorFeedback(
                *(state, self.positions[index], self.speed(index), self.torques.get(index, 0.0)),
                fault=self.faults.get(index),
                age_ns=self.age_ns,
            )
            for index, state in enumerate(self.states)
        ]

    def command(self, commands: Sequence[MotorCommand], *, now_ns: int) -> list[CanFrame]:
        self.commands = list(commands)
        return []

    def clear_faults(self) -> None:
        self.cleared += 1

    def coast_frames(self) -> list[CanFrame]:
        return [CanFrame("can0", 1, b"coast")]

    def stop_frames(self, *, now_ns: int) -> list[CanFrame]:
        return [CanFrame("can0", 1, b"stop", received_ns=now_ns)]


class Stand:
    """The real core of a robot on such a driver, from one second of the clock on."""

    def __init__(
        self,
        name: str,
        edit: Callable[[str], str] = str,
        *,
        states: Sequence[MotorState] = (),
        config: RobotConfig | None = None,
    ) -> None:
        config = config or parse(edit(robot_text(name)), name)
        self.names = config.robot.motor_names()
        size = len(self.names)
        self.motors = Notes(size)
        self.motors.states[: len(states)] = states
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("gateway.core.engine.build", self._build)
            self.engine = Engine(config)
        self.width_rate: float | None = None  # that every command asks for
        self.now_ns = SECOND
        self.out = self.cycle(ms=0.0)

    def _build(self, config: RobotConfig) -> Robot:
        size = len(self.names)
        group = Group("can0", self.motors, tuple(range(size)))  # type: ignore[arg-type]
        return build(config)._replace(
            groups=(group,), transmissions=(Transmission(1.0, 0.0),) * size, speed_loops=(None,) * size
        )

    def cycle(
        self,
        twist: Twist | None = None,
        *requests: RequestKind,
        ms: float = 4.0,
        source: str = "teleop",
        frame: TwistFrame = TwistFrame.BODY,
        bus: BusEventKind | None = None,
    ) -> Outputs:
        self.now_ns += round(ms * MS)
        self.motors.turn(ms * 1e-3)
        commands: tuple[TwistCommand, ...] = ()
        if twist is not None:
            command = TwistCommand(source, twist, frame, None, self.now_ns, source, stamped=True)
            commands = (command._replace(width_rate=self.width_rate),)
        asked = tuple(Request(kind, number, self.now_ns) for number, kind in enumerate(requests, 1))
        events = () if bus is None else (BusEvent("can0", bus, 1, "off"),)
        self.out = self.engine.step(Inputs(1, self.now_ns, commands=commands, requests=asked, bus_events=events))
        return self.out

    def run(self, seconds: float, twist: Twist | None = None) -> Outputs:
        for _ in range(round(seconds * 250)):
            self.cycle(twist)
        return self.out

    def drive(self, twist: Twist = FORWARD, *, seconds: float = 2.0) -> Outputs:
        self.cycle(ZERO_TWIST)
        self.cycle(ZERO_TWIST)
        assert self.out.mode is DRIVE
        return self.run(seconds, twist)

    def reply(self, kind: RequestKind, *others: RequestKind, twist: Twist | None = None) -> str | None:
        (reply,) = self.cycle(twist, kind, *others).replies
        assert reply.ok is (reply.reason is None)
        return reply.reason

    def reference(self, motor: str | None = None, angle: float | None = 0.0) -> str | None:
        self.now_ns += 4 * MS
        request = Request(RequestKind.REFERENCE, 5, self.now_ns, motor, angle)
        (reply,) = self.engine.step(Inputs(1, self.now_ns, requests=(request,))).replies
        assert (reply.id, reply.ok) == (5, reply.reason is None)
        return reply.reason

    def limit(self, target: Twist, *, dt: float = 0.004) -> Motion:
        return self.engine._limit(target, self.engine._measured._replace(dt=dt), self.engine._health._well, None)

    @property
    def setpoints(self) -> tuple[float | None, ...]:
        return self.out.trace.wheel_setpoints

    def is_released(self) -> bool:
        return set(self.setpoints) == {None}

    def is_in(self, mode: Mode) -> bool:
        return self.out.mode is mode


# time


@pytest.mark.parametrize(
    ("ms", "counted"), [(4.0, 4.0), (0.0, 0.0), (-7.0, 0.0), (20.0, 20.0), (20.1, 20.0), (500.0, 20.0)]
)
def test_the_setpoint_moves_on_for_five_periods_at_most(ms: float, counted: float) -> None:
    stand = Stand("omni4")
    stand.drive(Twist(1.0, 0.0, 0.0), seconds=0.3)  # at full acceleration: 2 m/s^2
    before = stand.out.trace.setpoint.vx
    detectors = stand.engine._health._detectors
    stand.cycle(Twist(1.0, 0.0, 0.0), ms=ms)
    assert stand.out.trace.setpoint.vx - before == pytest.approx(2e-3 * counted)
    assert (stand.engine._health._detectors is detectors) is (ms <= 20.0)


def test_the_first_cycle_lasts_a_period() -> None:
    stand = Stand("omni4")
    assert stand.engine._elapsed(5) == 0.0
    stand = Stand("omni4")
    stand.engine._last_ns = None
    assert stand.engine._elapsed(5) == 0.004


# start


def test_a_robot_that_lacks_a_motor_from_the_start_waits_three_seconds_for_it() -> None:
    stand = Stand("omni4")
    stand.motors.states[0] = SILENT
    for at_ms, mode in ((2999.999999, IDLE), (3000.0, STARTING)):
        stand.now_ns = SECOND
        stand.cycle(ZERO_TWIST, ms=at_ms)
        assert stand.out.mode is mode
    stand.cycle(ZERO_TWIST)
    assert stand.out.mode is DEGRADED


@both
def test_only_a_zero_starts(name: str) -> None:
    stand = Stand(name)
    assert stand.run(0.2, FORWARD).mode is IDLE
    assert stand.is_released()
    assert stand.cycle(ZERO_TWIST).mode is STARTING
    assert stand.setpoints == (0.0,) * len(stand.names)
    assert stand.cycle(ZERO_TWIST).mode is DRIVE


def test_a_zero_that_is_followed_by_motion_in_the_same_cycle_starts_nothing() -> None:
    stand = Stand("omni4")
    stand.now_ns += 4 * MS
    zero = TwistCommand("teleop", ZERO_TWIST, TwistFrame.BODY, None, stand.now_ns, "teleop", stamped=True)
    out = stand.engine.step(Inputs(1, stand.now_ns, commands=(zero, zero._replace(twist=FORWARD))))
    assert out.mode is IDLE


@both
def test_a_zero_before_the_robot_could_start_does_not_count_once_motion_followed(name: str) -> None:
    """Autonomy sent its zero while motors were off, and went on; hours later teleop starts the robot and lets go."""
    size = len(Stand(name).names)
    stand = Stand(name, states=[SILENT] * size)
    stand.cycle(ZERO_TWIST, source="autonomy")
    stand.run(4.0, FORWARD)
    stand.cycle(FORWARD, source="autonomy")
    assert stand.is_in(IDLE)
    stand.motors.states = [OPERATIONAL] * size
    stand.cycle(ZERO_TWIST)
    stand.cycle(ZERO_TWIST)
    assert stand.is_in(DRIVE)
    for _ in range(100):
        stand.cycle(FORWARD, source="autonomy")
    assert stand.is_in(IDLE)
    assert stand.out.trace.setpoint == ZERO_TWIST


def test_arming_takes_three_seconds_at_most_and_says_who_did_not_arm() -> None:
    stand = Stand("omni4", states=[READY, OPERATIONAL, MotorState.STARTING])
    assert stand.cycle(ZERO_TWIST).mode is STARTING
    assert stand.cycle(ZERO_TWIST, ms=3000.0).mode is STARTING
    assert stand.cycle(ZERO_TWIST, ms=0.000001).mode is FAULT
    stand.motors.states = [OPERATIONAL] * 4
    faults = stand.cycle().mode, stand.engine._judge(stand.engine._measured).faults
    assert faults == (
        FAULT,
        (
            Fault(FaultKind.ARMING, "front_left", "still idle 3 s after arming began", latched=True),
            Fault(FaultKind.ARMING, "rear_right", "still starting 3 s after arming began", latched=True),
        ),
    )


# requests


@both
def test_a_shutdown_ends_once_the_robot_rests_and_is_released(name: str) -> None:
    stand = Stand(name)
    assert not stand.out.finished
    assert stand.cycle(None, RequestKind.SHUTDOWN).finished
    stand = Stand(name)
    stand.drive()
    assert not stand.cycle(FORWARD, RequestKind.SHUTDOWN).finished
    assert stand.out.mode is STOPPING
    seen = [stand.cycle(FORWARD) for _ in range(750)]
    assert [out.finished for out in seen] == [out.mode is IDLE for out in seen]
    assert seen[-1].finished
    assert stand.is_released()


def test_resets_and_their_refusals() -> None:
    stand = Stand("omni4")
    reset, estop = RequestKind.RESET, RequestKind.ESTOP
    assert stand.reply(reset) is None
    assert stand.motors.cleared == 1
    stand.drive()
    assert stand.reply(reset, twist=FORWARD) == "nothing to reset in mode drive"
    assert stand.reply(reset, estop, twist=FORWARD) == "an emergency stop arrived at the same moment"
    assert stand.out.mode is ESTOP
    assert stand.reply(reset, twist=FORWARD) == "teleop commands motion; commands must be zero"
    assert stand.reply(reset, twist=ZERO_TWIST) is None
    assert stand.motors.cleared == 2
    assert stand.is_in(IDLE)
    stand.cycle(None, estop)
    stand.motors.measured[0] = 1.0
    assert stand.reply(reset) == "the robot still moves"
    stand.motors.measured.clear()
    stand.motors.states = [SILENT, SILENT, OPERATIONAL, OPERATIONAL]
    assert stand.reply(reset) == "too few motors report their speed, so the robot is not known to stand"
    assert stand.cycle(None, reset, reset).replies == tuple(stand.out.replies)
    assert [reply.ok for reply in stand.out.replies] == [False, False]
    assert stand.motors.cleared == 2


def test_a_reset_forgets_latched_faults() -> None:
    stand = Stand("omni4")
    stand.engine._health.latch(Fault(FaultKind.STALL, "front_left", "stands still", latched=True))
    assert stand.cycle().mode is FAULT
    assert stand.cycle(ZERO_TWIST).mode is FAULT
    assert stand.reply(RequestKind.RESET) is None
    assert stand.cycle().mode is IDLE


def incremental(text: str) -> str:
    return text.replace('encoder = "absolute"', 'encoder = "incremental"')


def test_references_and_their_refusals() -> None:
    stand = Stand("moby", incremental)
    unknown = "platform: joint angle unknown (its encoder is not absolute): "
    assert stand.cycle(ZERO_TWIST).mode is IDLE
    assert stand.engine._other_faults(stand.engine._measured) == [
        Fault(FaultKind.POSITION_UNKNOWN, "platform", f"{unknown[10:]}drivegate reference moby", latched=False)
    ]
    assert stand.reply(RequestKind.RESET) == f"{unknown}reference it first"
    assert stand.reference("left") == "motor = 'left': must be one of the steered joints: platform"
    stand.motors.measured[2] = 1.0
    assert stand.reference() == "the robot still moves"
    stand.motors.measured.clear()
    stand.motors.states[2] = SILENT
    assert stand.engine._other_faults(stand.engine._measured) != []
    stand.cycle()
    assert stand.engine._other_faults(stand.engine._measured) == []
    assert stand.reference() == "platform does not report its position"
    stand.motors.states[2] = OPERATIONAL
    stand.cycle()
    position = stand.motors.positions[2]
    assert stand.reference("platform", 0.5) is None
    assert stand.engine._trust.angles([None, None, position])[2] == 0.5
    assert stand.reference(None, None) is None
    assert stand.engine._trust.angles([None, None, position])[2] == 0.0
    stand.drive(ZERO_TWIST, seconds=0.1)
    assert stand.reference() == "the robot is in mode drive; a joint is referenced at rest"
    assert Stand("omni4").reference() == "motor = 'no joint': must be one of the steered joints: there are none"


# what takes the robot out of motion


@both
def test_a_bus_that_is_down_is_a_fault_until_it_is_up(name: str) -> None:
    stand = Stand(name)
    stand.drive()
    assert stand.cycle(FORWARD, bus=BusEventKind.DOWN).mode is FAULT
    assert stand.cycle(FORWARD, bus=BusEventKind.ERROR_ACTIVE).mode is FAULT
    assert stand.engine._other_faults(stand.engine._measured) == [Fault(FaultKind.BUS, "can0", "off", latched=False)]
    stand.cycle(FORWARD, bus=BusEventKind.UP)
    assert stand.engine._other_faults(stand.engine._measured) == []
    assert stand.run(3.0, FORWARD).mode is IDLE
    stand.cycle(bus=BusEventKind.UP)
    assert stand.is_in(IDLE)


@both
def test_outside_driving_the_setpoint_only_falls(name: str) -> None:
    stand = Stand(name)
    stand.drive()
    speeds = [stand.out.trace.setpoint.vx, *(stand.cycle().trace.setpoint.vx for _ in range(500))]
    assert speeds[-1] == 0.0
    fallen = [before - after for before, after in pairwise(speeds)]
    assert min(fallen) >= 0.0
    assert stand.is_in(IDLE)
    assert stand.is_released()
    assert speeds.index(0.0) < 75 + 250, "silent for 0.3 s, then the ramp of 0.4 m/s"


def test_odometry_frame_and_body_frame() -> None:
    stand = Stand("omni4")
    stand.drive(ZERO_TWIST, seconds=0.1)
    stand.engine._odometry.pose = stand.engine._odometry.pose._replace(theta=pi / 6)
    stand.cycle(Twist(0.8, 0.5, 0.25), frame=TwistFrame.ODOM)
    assert stand.out.trace.target == pytest.approx((0.6928203 + 0.25, 0.4330127 - 0.4, 0.25))
    stand.cycle(Twist(1.0, 0.5, 0.25))
    assert stand.out.trace.target == Twist(1.0, 0.5, 0.25)
    stand.cycle(None, RequestKind.ESTOP)
    assert stand.out.trace.target == ZERO_TWIST


# limits


def test_with_three_motors_half_the_acceleration() -> None:
    stand = Stand("omni4")
    stand.drive(ZERO_TWIST, seconds=0.1)
    stand.motors.states[0] = SILENT
    stand.run(0.3, Twist(1.5, 0.0, 0.0))
    assert stand.out.mode is DEGRADED
    before = stand.out.trace.setpoint.vx
    assert stand.cycle(Twist(1.5, 0.0, 0.0)).trace.setpoint.vx - before == pytest.approx(0.004)
    assert stand.setpoints[0] is None


def test_a_motor_at_its_torque_limit_holds_the_setpoint_back() -> None:
    stand = Stand("omni4")
    stand.drive(Twist(1.0, 0.0, 0.0), seconds=0.3)
    before = stand.out.trace.setpoint
    stand.motors.torques[0] = 4.5 if (stand.setpoints[0] or 0.0) > 0.0 else -4.5
    stand.motors.measured[0] = 0.8 * (stand.setpoints[0] or 0.0)
    stand.cycle(Twist(1.0, 0.0, 0.0))
    assert stand.out.trace.setpoint == before
    assert stand.limit(Twist(1.0, 0.0, 0.0)).limits == ("acceleration", "torque")


def test_wheels_too_fast_scale_the_setpoint() -> None:
    stand = Stand("omni4")
    stand.drive(ZERO_TWIST, seconds=0.1)
    stand.engine._limiter.reset(Twist(4.0, 3.0, 8.0))
    motion = stand.limit(Twist(2.0, 1.5, 4.0), dt=0.0)
    speeds = [command.value for command in motion.commands]
    assert max(map(abs, speeds)) == pytest.approx(45.0)
    assert motion.share == pytest.approx(45.0 / 86.143066)
    assert "motor_speed" in motion.limits
    assert stand.engine._kinematics.wheel_speeds(stand.engine._limiter.setpoint, ()) == pytest.approx(speeds)


@pytest.mark.parametrize("mode", [Mode.DRIVE, Mode.STOPPING, Mode.ESTOP])
def test_slip_is_named(mode: Mode) -> None:
    stand = Stand("omni4")
    stand.drive(ZERO_TWIST, seconds=0.1)
    stand.engine._measured = stand.engine._measured._replace(slipping=True)
    stand.engine._mode = mode
    assert stand.limit(ZERO_TWIST, dt=0.0).limits == ("slip",)


@pytest.mark.parametrize(
    ("setpoint", "measured", "dt", "factor"),
    [
        (Twist(1.0, 0.0, 0.0), Twist(0.2, 0.0, 0.0), 0.004, 0.96),  # half of top speed, less 5 of it per second
        (Twist(1.0, 0.0, 0.0), Twist(0.2, 0.0, 0.0), 1.0, 0.4),  # a tenth, and a tenth of slack
        (Twist(-1.0, 0.0, 0.0), Twist(0.2, 0.0, 0.0), 1.0, 0.2),
        (Twist(1.0, 0.0, 0.0), Twist(0.81, 0.0, 0.0), 1.0, 1.0),
        (Twist(1.0, 0.0, 0.0), Twist(0.79, 1.0, 1.0), 1.0, 0.99),
        (Twist(1.0, 0.75, 2.0), Twist(0.5, 0.375, -1.0), 1.0, 1 / 6 + 0.2),
        (ZERO_TWIST, Twist(0.2, 0.0, 0.0), 0.004, 1.0),
        (Twist(1e-170, 0.0, 0.0), Twist(0.2, 0.0, 0.0), 0.004, 1.0),  # the tail of a filter; its square is zero
    ],
)
def test_a_braking_setpoint_falls_back_to_what_is_measured(
    setpoint: Twist, measured: Twist, dt: float, factor: float
) -> None:
    engine = Stand("omni4").engine
    engine._limiter.reset(setpoint)
    engine._fall_back(measured, dt)
    assert engine._limiter.setpoint == pytest.approx([factor * axis for axis in setpoint])


def test_an_angle_lost_while_driving_is_not_used_before_the_next_rest() -> None:
    stand = Stand("moby")
    stand.drive(Twist(0.4, 0.3, 0.2), seconds=0.5)
    left, right = stand.setpoints[:2]
    assert left is not None
    assert right is not None
    shares = []
    for cycle in range(100):
        stand.motors.states[2] = SILENT if cycle < 10 else OPERATIONAL
        stand.cycle(Twist(0.4, 0.3, 0.2))
        assert stand.out.mode is FAULT
        shares.append([(speed or 0.0) / before for speed, before in zip(stand.setpoints, (left, right), strict=False)])
    assert all(a == pytest.approx(b) and 0.0 < a <= 1.0 for a, b in shares)
    assert shares[-1][0] < 0.9
    assert stand.run(3.0).mode is IDLE
    stand.drive(Twist(0.4, 0.3, 0.2), seconds=0.1)


@both
def test_the_setpoint_waits_while_nobody_follows(name: str) -> None:
    stand = Stand(name)
    stand.drive()
    stand.motors.states = [SILENT] * len(stand.names)
    before = stand.out.trace.setpoint
    seen = [stand.cycle(FORWARD) for _ in range(10)]
    assert {out.trace.setpoint for out in seen} == {before}
    assert {out.mode for out in seen} == {FAULT}


def test_a_fault_is_not_left_while_a_wheel_turns() -> None:
    """Two wheels stand and two are silent: taken for rest in the end, but the robot may spin about those two."""
    stand = Stand("omni4")
    stand.drive()
    stand.motors.states = [SILENT, SILENT, OPERATIONAL, OPERATIONAL]
    stand.run(4.0)
    assert stand.is_in(FAULT)
    assert not stand.is_released(), "braking goes on while the motion of the body is not known"
    stand.run(2.0)
    assert stand.is_released()
    stand.motors.states = [OPERATIONAL] * 4
    stand.motors.measured = {index: 5.0 for index in range(4)}
    assert stand.run(2.0).mode is FAULT
    stand.motors.measured = {}
    assert stand.cycle().mode is IDLE


@both
def test_motors_that_are_to_brake_again_after_their_release_are_no_fault(name: str) -> None:
    stand = Stand(name)
    stand.drive(ZERO_TWIST, seconds=0.2)
    stand.cycle(None, RequestKind.ESTOP)
    stand.motors.measured = {}
    stand.run(1.0)
    assert stand.is_released()
    stand.motors.states = [READY] * len(stand.names)
    stand.motors.measured = {0: 3.0}
    outs = [stand.cycle() for _ in range(50)]
    assert not stand.is_released(), "what rolls is braked"
    assert [event for out in outs for event in out.events if event.code.startswith("fault")] == []


@both
@pytest.mark.parametrize("heard", [1, 3])
@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_motors_that_follow_again_go_on_from_how_they_turn(name: str, heard: int, share: float) -> None:
    """Whatever stopped them meanwhile; and who is heard first is enough to know."""
    stand = Stand(name)
    stand.drive()
    size = len(stand.names)
    stand.motors.states = [SILENT] * size
    stand.cycle(FORWARD, bus=BusEventKind.DOWN)
    for _ in range(10):
        stand.cycle(FORWARD)
    waiting, told = stand.out.trace.setpoint, stand.setpoints
    stand.motors.states = [OPERATIONAL] * heard + [SILENT] * (size - heard)
    stand.motors.measured = {index: share * (speed or 0.0) for index, speed in enumerate(told)}
    stand.cycle(FORWARD, bus=BusEventKind.UP)
    assert stand.out.mode is FAULT
    assert share * waiting.vx - 0.01 < stand.out.trace.setpoint.vx <= share * waiting.vx + 1e-12


# measurement


def test_the_speed_of_a_wheel_by_the_others() -> None:
    stand = Stand("omni4")
    stand.drive()
    expected = stand.setpoints[0]
    stand.motors.measured[0] = 0.0
    stand.cycle(FORWARD)
    assert stand.engine._expected_speed(0) == pytest.approx(expected)
    front_left, _, *others = stand.engine._measured.speeds
    stand.engine._measured = stand.engine._measured._replace(speeds=(front_left, None, *others))
    assert stand.engine._expected_speed(0) is None
    assert Stand("moby").engine._expected_speed(0) is None


def test_rest_is_known_only_where_every_motor_tells() -> None:
    stand = Stand("omni4")
    assert stand.engine.at_rest((), now_ns=0)
    stand.motors.measured[0] = 1.0
    assert not stand.engine.at_rest((), now_ns=0)
    stand.motors.measured.clear()
    stand.motors.states[0] = SILENT
    assert not stand.engine.at_rest((), now_ns=0)
    assert stand.engine.coast_frames() == [CanFrame("can0", 1, b"coast")]
    assert stand.engine.stop_frames(now_ns=9) == [CanFrame("can0", 1, b"stop", received_ns=9)]


def test_what_is_told_of_a_drive() -> None:
    stand = Stand("omni4")
    stand.drive()
    trace = stand.out.trace
    assert trace.measured == pytest.approx(FORWARD, abs=0.01)
    assert trace.winner_age_s == 0.0
    assert trace.residual == pytest.approx(0.0, abs=1e-9)
    assert trace.residuals == pytest.approx([0.0] * 4, abs=1e-9)
    assert stand.cycle().trace.winner_age_s == 0.004
    status = next(out.status for out in iter(stand.cycle, None) if out.status is not None)
    assert (status.mode, status.winner, status.reason, status.faults) == (DRIVE, "teleop", None, ())
    assert status.winner_age_s == pytest.approx(stand.out.trace.winner_age_s)
    assert (status.standing, status.stop_category, len(status.motors)) == (False, 1, 4)
    assert status.twist == pytest.approx(FORWARD, abs=0.01)
    stand.motors.states = [SILENT] * 4
    out = stand.cycle()
    assert (out.trace.measured, out.trace.residual, out.trace.residuals) == (None, None, None)
    stand = Stand("omni4")
    assert stand.out.status is not None
    assert (stand.out.status.winner, stand.out.status.winner_age_s) == (None, None)


# emergency stop


def test_an_emergency_stop_takes_every_brake_there_is() -> None:
    stand = Stand("omni4")
    stand.drive()
    stand.engine._health.latch(Fault(FaultKind.FROZEN, "front_right", "frozen", latched=True))
    for index, latched in enumerate((False, True)):
        stand.motors.states[index] = MotorState.FAULT
        stand.motors.faults[index] = DriverFault("hot", "hot", latched=latched)
    stand.cycle(FORWARD, RequestKind.ESTOP)
    assert stand.setpoints == (None, 0.0, 0.0, None)
    kinds = [command.kind for command in stand.motors.commands]
    assert kinds == [CommandKind.COAST, CommandKind.BRAKE, CommandKind.BRAKE, CommandKind.COAST]


@pytest.mark.parametrize("category", [1, 2])
def test_what_an_emergency_stop_ends_in(category: int) -> None:
    stand = Stand("omni4", lambda text: f"{text}\n[stop]\ncategory = {category}\n")
    stand.drive(ZERO_TWIST)
    stand.motors.measured[0] = 0.3
    stand.cycle(None, RequestKind.ESTOP)
    stand.run(1.0)
    assert not stand.is_released()
    stand.motors.measured.clear()
    stand.run(0.248)
    assert not stand.is_released()
    stand.run(0.008)
    assert stand.is_released() is (category == 1)
    stand.motors.measured[0] = 1.0
    stand.run(0.096)
    assert stand.is_released() is (category == 1)
    stand.run(0.008)
    assert not stand.is_released()
    stand.motors.measured.clear()
    stand.run(1.0)
    assert not stand.is_released(), "what rolled is held"
    assert not stand.out.finished
    assert stand.cycle(None, RequestKind.SHUTDOWN).finished
    assert stand.is_released()


def test_a_robot_that_rolled_once_is_released_after_the_next_emergency_stop() -> None:
    stand = Stand("omni4")
    stand.cycle(None, RequestKind.ESTOP)
    assert stand.is_released()
    stand.motors.measured[0] = 1.0
    stand.run(0.2)
    assert not stand.is_released()
    stand.motors.measured.clear()
    stand.run(0.1)
    assert stand.reply(RequestKind.RESET) is None
    assert stand.is_released()
    stand.drive(ZERO_TWIST)
    stand.cycle(None, RequestKind.ESTOP)
    stand.run(0.5)
    assert stand.is_released()


def test_what_rolls_in_idle_is_not_energised() -> None:
    stand = Stand("omni4")
    stand.motors.measured[0] = 1.0
    stand.run(0.3)
    assert stand.is_released()


def test_a_motor_released_in_a_fault_is_not_driven_before_rest() -> None:
    stand = Stand("moby")
    stand.drive()
    stand.motors.states[0] = SILENT
    assert stand.cycle(FORWARD).mode is FAULT
    stand.motors.states[0] = OPERATIONAL
    seen = [stand.cycle(FORWARD) for _ in range(100)]
    assert {out.trace.wheel_setpoints[0] for out in seen} == {None}
    assert None not in {out.trace.wheel_setpoints[1] for out in seen}


# one by one


@pytest.mark.parametrize("mode", Mode)
def test_resets_belong_to_modes_that_hold_nothing(mode: Mode) -> None:
    stand = Stand("omni4")
    stand.engine._mode = mode
    assert stand.engine.mode is mode
    refusal = stand.engine._refusal_of_reset(stand.now_ns, estop=False)
    held = mode in {STARTING, DRIVE, DEGRADED, STOPPING}
    assert refusal == (f"nothing to reset in mode {mode.value}" if held else None)


@pytest.mark.parametrize("mode", Mode)
def test_rest_stop_and_failure_ask_every_source_for_a_new_zero(mode: Mode) -> None:
    stand = Stand("omni4")
    stand.drive(seconds=0.1)
    stand.engine._enter(mode, stand.now_ns)
    stand.cycle(FORWARD)
    assert (stand.engine._arbiter.select(stand.now_ns).command is None) is (mode in {IDLE, ESTOP, FAULT})


def test_reasons_not_to_drive() -> None:
    stand = Stand("omni4")
    for _ in range(300):
        out = stand.cycle(FORWARD)
        if out.status is not None and out.status.cycle:
            reason = out.status.reason
    assert reason == "waiting for a zero command from teleop"
    stand.drive()
    stand.run(0.304)
    out = stand.cycle(FORWARD, source="autonomy")
    assert out.mode is STOPPING
    while out.status is None:
        out = stand.cycle(FORWARD, source="autonomy")
    assert out.status.reason == "no fresh command"


def test_status_comes_at_its_rate_and_with_every_event_and_odometry_at_its_own() -> None:
    stand = Stand("omni4")
    outs = [stand.cycle() for _ in range(250)]
    assert 1 <= sum(out.status is not None for out in outs) <= 50
    assert 1 <= sum(out.odometry is not None for out in outs) <= 200
    outs = [stand.cycle(ZERO_TWIST), stand.cycle(ZERO_TWIST), stand.cycle(None, RequestKind.ESTOP)]
    assert all(out.events and out.status is not None for out in outs)


def test_frames_are_handed_on() -> None:
    stand = Stand("omni4")
    stand.engine.step(Inputs(1, stand.now_ns, frames=(CanFrame("can0", 7, b""),)))
    stand.engine.at_rest([CanFrame("can0", 8, b"")], now_ns=stand.now_ns)
    assert stand.motors.heard == [7, 8]


def test_a_shutdown_waits_for_rest_in_an_emergency_stop_too_and_is_not_forgotten() -> None:
    stand = Stand("omni4")
    stand.drive(ZERO_TWIST, seconds=0.1)
    stand.motors.measured[0] = 0.3
    assert not stand.cycle(None, RequestKind.ESTOP, RequestKind.SHUTDOWN).finished
    stand = Stand("omni4")
    stand.drive()
    stand.cycle(FORWARD, RequestKind.SHUTDOWN)
    assert stand.cycle(FORWARD, RequestKind.RESET).mode is STOPPING
    assert stand.run(3.0, FORWARD).finished


def test_a_joint_that_jumps_is_a_fault() -> None:
    stand = Stand("moby")
    stand.drive(ZERO_TWIST, seconds=0.1)
    stand.motors.positions[2] += 2.0
    assert stand.cycle(ZERO_TWIST).mode is FAULT


def test_wheels_that_do_not_fit_are_slip_and_one_that_does_not_follow_is_a_fault() -> None:
    stand = Stand("omni4")
    stand.drive(Twist(1.0, 0.0, 0.0), seconds=1.5)
    assert stand.out.trace.pose.x == pytest.approx(1.0, abs=0.3)
    place = max(range(4), key=lambda index: abs(stand.setpoints[index] or 0.0))
    stand.motors.measured[place] = -15.0 if (stand.setpoints[place] or 0.0) > 0.0 else 15.0
    codes = {event.code for _ in range(150) for event in stand.cycle(Twist(1.0, 0.0, 0.0)).events}
    assert {"slip", "fault_following"} <= codes


def test_three_wheels_are_enough_to_know_that_it_stands() -> None:
    stand = Stand("omni4")
    stand.motors.states[0] = SILENT
    stand.cycle()
    assert stand.engine._standstill.standing is True


def test_with_several_steered_joints_a_reference_names_one() -> None:
    stand = Stand("moby", incremental)
    stand.engine._kinematics.steered = (1, 2)
    assert stand.reference() == "motor = 'right': must be one of the steered joints: right, platform"
    assert stand.reference("platform") is None


def test_a_motor_lost_for_a_moment_is_not_back_when_the_drive_is_resumed() -> None:
    stand = Stand("omni4")
    stand.drive()
    stand.motors.states[0] = SILENT
    assert stand.cycle(FORWARD).mode is DEGRADED
    stand.motors.states[0] = OPERATIONAL
    stand.run(0.32)
    assert stand.is_in(STOPPING)
    assert stand.cycle(FORWARD).mode is DEGRADED


def test_a_fault_that_takes_no_motor_is_waited_for_at_the_start_only() -> None:
    stand = Stand("omni4")
    stand.engine._buses_down["can9"] = "off"
    assert stand.cycle(ZERO_TWIST).mode is IDLE
    assert stand.cycle(ZERO_TWIST, ms=3000.0).mode is STARTING
    assert stand.cycle(ZERO_TWIST).mode is DRIVE


def test_one_latched_fault_among_others_is_enough() -> None:
    stand = Stand("omni4")
    stand.motors.states[0] = SILENT
    stand.engine._health.latch(Fault(FaultKind.STALL, "front_right", "stands still", latched=True))
    assert stand.cycle().mode is FAULT


@pytest.mark.parametrize("why", ["stop", "bus"])
def test_only_arming_that_takes_too_long_is_blamed_on_who_did_not_arm(why: str) -> None:
    stand = Stand("omni4", states=[READY] * 4)
    stand.cycle(ZERO_TWIST)
    if why == "stop":
        assert stand.cycle(ZERO_TWIST, RequestKind.ESTOP, ms=3001.0).mode is ESTOP
    else:
        stand.engine._health.latch(Fault(FaultKind.RUNAWAY, "front_left", "runs", latched=True))
        stand.engine._health.latch(Fault(FaultKind.RUNAWAY, "rear_left", "runs", latched=True))
        assert stand.cycle(ZERO_TWIST).mode is FAULT
    kinds = {fault.kind for fault in stand.engine._judge(stand.engine._measured).faults}
    assert FaultKind.ARMING not in kinds


def health(*, obeying: Sequence[bool] = (True,) * 4) -> Health:
    return Health((True,) * 4, tuple(obeying), (True,) * 4, ())


@pytest.mark.parametrize(
    ("estimate", "obeying", "setpoint"),
    [
        (None, False, 1.0),
        (Estimate(Twist(0.2, 0.0, 0.0), None), False, 0.96),
        (Estimate(Twist(1.0, 0.0, 0.0), None), False, 1.0),
        (Estimate(Twist(1.0, 0.0, 0.0), None), True, 1.0 - 15.0 * 0.004**2),  # jerk
    ],
)
def test_a_setpoint_on_its_way_to_rest(estimate: Estimate | None, obeying: bool, setpoint: float) -> None:
    engine = Stand("omni4").engine
    engine._limiter.reset(Twist(1.0, 0.0, 0.0))
    engine._brake(engine._measured._replace(estimate=estimate, dt=0.004), health(obeying=(obeying,) * 4))
    assert engine._limiter.setpoint.vx == pytest.approx(setpoint, rel=1e-6)


def test_who_follows() -> None:
    stand = Stand("omni4", states=[READY, READY, OPERATIONAL, OPERATIONAL])
    assert stand.engine._followed(health())
    assert stand.engine._followed(health(obeying=(True, True, False, True)))
    assert not stand.engine._followed(health(obeying=(True, True, False, False)))


def test_what_nobody_can_reach_or_measure_is_released_after_four_seconds() -> None:
    stand = Stand("omni4")
    stand.drive()
    stand.motors.states = [SILENT] * 4
    stand.cycle()
    stand.cycle(ms=3990.0)
    assert stand.engine._energised
    stand.cycle(ms=20.0)
    assert not stand.engine._energised


def test_a_stalled_motor_may_go_on_with_the_ramp_but_is_not_driven() -> None:
    fault = Fault(FaultKind.STALL, "left", "stands still", latched=True)
    stand = Stand("moby")
    stand.drive()
    stand.engine._health.latch(fault)
    assert stand.cycle(FORWARD).mode is FAULT
    assert None not in stand.setpoints
    stand = Stand("omni4")
    stand.drive()
    stand.engine._health.latch(fault._replace(subject="front_left"))
    outs = [*(stand.cycle(FORWARD) for _ in range(10)), *(stand.cycle() for _ in range(90))]
    assert {DEGRADED, STOPPING} <= {out.mode for out in outs}
    place = stand.names.index("front_left")
    assert {out.trace.wheel_setpoints[place] for out in outs} == {None}


def test_category_2_holds_after_an_emergency_stop_only() -> None:
    stand = Stand("omni4", lambda text: f"{text}\n[stop]\ncategory = 2\n")
    stand.drive()
    stand.cycle(FORWARD, bus=BusEventKind.DOWN)
    stand.run(3.0, FORWARD)
    assert stand.is_in(FAULT)
    assert not stand.engine._energised


def test_nothing_starts_while_a_motor_is_waited_for_that_was_out_of_reach() -> None:
    stand = Stand("moby")
    stand.cycle(ms=3000.0)
    stand.motors.states = [SILENT] * 3
    stand.cycle(bus=BusEventKind.DOWN)
    stand.motors.states[0] = OPERATIONAL
    assert stand.cycle(ZERO_TWIST, bus=BusEventKind.UP).mode is IDLE
    assert stand.engine._other_faults(stand.engine._measured) == []
    stand.motors.states = [OPERATIONAL] * 3
    assert stand.cycle(ZERO_TWIST).mode is STARTING


def test_a_reset_on_the_way_to_rest_gives_no_motor_back() -> None:
    stand = Stand("moby")
    stand.drive()
    stand.engine._health.latch(Fault(FaultKind.RUNAWAY, "left", "runs away", latched=True))
    assert stand.cycle(FORWARD).mode is FAULT
    assert stand.is_released()
    stand.run(0.02)
    assert stand.reply(RequestKind.RESET, twist=ZERO_TWIST) is None
    stand.run(0.1)
    assert stand.is_in(FAULT), "it has not rested long enough"
    while stand.is_in(FAULT):
        assert stand.is_released()
        stand.cycle()
    assert stand.is_in(IDLE)


@pytest.mark.parametrize("name", NAMES)
def test_a_region_that_the_chassis_has_not_is_refused_in_words_and_moves_nothing(name: str) -> None:
    """moby might, with a section of its robot file that it does not have."""
    stand = Stand(name)
    stand.drive()
    zero = TwistCommand("teleop", ZERO_TWIST, TwistFrame.BODY, None, stand.now_ns, "teleop", stamped=True)
    asked = zero._replace(twist=FORWARD, region=Region.PULL)
    out = stand.engine.step(Inputs(1, stand.now_ns + 4 * MS, commands=(asked,)))
    (event,) = [event for event in out.events if event.code == "refused_unsupported"]
    hint = {"moby": ": [robot.manoeuvre] in the robot file allows others"}.get(name, "")
    assert event.text == f"teleop: region = 'pull': must be 'any' on this chassis{hint}"
    assert out.status is not None
    assert out.status.refused == 1

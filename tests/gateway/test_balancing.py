"""A chassis that falls when it is let go: the core honours what its drive law says of stop, rest and release."""

from collections.abc import Mapping

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.contract import DriverFault, MotorState
from drivers.setpoint import CommandKind
from gateway.control.drive_law import TWISTS, Features, JointCommand, Measured, Motion
from gateway.control.posture import Posture
from gateway.types import ZERO_TWIST, Facts, Mode, Rates, Region, RequestKind, Twist
from tests.gateway.test_engine_rules import FORWARD, Stand

pytestmark = pytest.mark.pure_python  # a law of the test in place of that which the engine builds

SWAY = 0.5  # rad/s, with which its wheels keep it upright at rest
STOPPED, DRIVEN, RELEASED = -0.25, 0.5, None  # N m: what the law tells the joints, by which the test knows it
ENERGISED = {Mode.STARTING, Mode.DRIVE, Mode.DEGRADED, Mode.STOPPING}


class Balance:
    """Torques of its own, told apart by their size. `upright`: it would fall if it were let go."""

    def __init__(self, size: int) -> None:
        self.upright = True
        self.asked = 0
        self._size = size

    @property
    def facts(self) -> Facts:
        self.asked += 1
        return {"upright": self.upright}

    @property
    def features(self) -> Features:
        return TWISTS

    @property
    def posture(self) -> Posture | None:
        return None

    @property
    def settings(self) -> Mapping[str, float]:
        return {}

    def set(self, name: str, value: float) -> str | None:
        return name

    @property
    def unready(self) -> str | None:
        """Nothing."""
        return None

    def width_rate(self, width: float) -> float:
        """It knows no width."""
        return 0.0

    def aim(self, target: Rates, measured: Measured, *, region: Region, path_rate: float | None, whole: bool) -> Rates:
        return target

    def ground(self, *, whole: bool) -> None:
        return None

    def motion(self, setpoint: Rates, measured: Measured, *, braking: bool, path_rate: float | None = None) -> Motion:
        return Motion((JointCommand(CommandKind.TORQUE, DRIVEN),) * self._size)

    def stop(self, measured: Measured) -> Motion:
        return Motion((JointCommand(CommandKind.TORQUE, STOPPED),) * self._size)

    def moves(self, measured: Measured, *, turning: bool | None) -> bool | None:
        return turning and any(speed is not None and abs(speed) > SWAY for speed in measured.speeds)

    def may_release(self, measured: Measured) -> bool:
        return not self.upright

    def forget_told(self) -> None:
        """Its torques follow from nothing."""


class Robot:
    """omni4 with that law; its wheels sway as they do at rest."""

    def __init__(self) -> None:
        self.stand = Stand("omni4")
        self.law = Balance(4)
        self.stand.engine._law = self.law
        self.sway(SWAY)

    def sway(self, speed: float) -> None:
        self.stand.motors.measured = dict.fromkeys(range(4), speed)

    def fail(self, *, latched: bool) -> None:
        """The first two motors refuse."""
        self.stand.motors.states[:2] = [MotorState.FAULT] * 2
        self.stand.motors.faults = dict.fromkeys(range(2), DriverFault("hot", "too hot", latched=latched))

    def recover(self) -> None:
        self.stand.motors.states[:2] = [MotorState.OPERATIONAL] * 2
        self.stand.motors.faults = {}

    def told(self) -> list[float | None]:
        commands = self.stand.motors.commands
        return [None if command.kind is CommandKind.COAST else command.value for command in commands]

    def start(self) -> None:
        self.stand.cycle(ZERO_TWIST)
        self.stand.cycle(ZERO_TWIST)
        assert self.stand.is_in(Mode.DRIVE)
        assert self.told() == [DRIVEN] * 4


def test_at_rest_it_stays_upright_until_it_may_be_let_go() -> None:
    robot = Robot()
    robot.start()
    for _ in range(5 * 250):
        robot.stand.cycle()
        assert robot.told() == [DRIVEN] * 4
    assert robot.stand.is_in(Mode.STOPPING)
    robot.law.upright = False
    robot.stand.run(0.1)
    assert robot.stand.is_in(Mode.IDLE)
    assert robot.told() == [RELEASED] * 4


def test_it_drives_on_from_there_when_it_is_commanded_again() -> None:
    robot = Robot()
    robot.start()
    robot.stand.run(5.0)
    robot.stand.cycle(ZERO_TWIST)
    assert robot.stand.is_in(Mode.DRIVE)


def test_swaying_is_rest_and_more_is_not() -> None:
    robot = Robot()
    robot.start()
    robot.law.upright = False
    robot.sway(1.01 * SWAY)
    robot.stand.run(5.0)
    assert robot.stand.is_in(Mode.STOPPING)
    robot.sway(SWAY)
    robot.stand.run(0.3)
    assert robot.stand.is_in(Mode.IDLE)


def test_an_emergency_stop_keeps_it_upright_and_nothing_else_moves_it() -> None:
    robot = Robot()
    robot.start()
    robot.stand.run(1.0, FORWARD)
    robot.stand.cycle(FORWARD, RequestKind.ESTOP)
    for _ in range(10 * 250):
        out = robot.stand.cycle(FORWARD)
        assert robot.told() == [STOPPED] * 4
        assert (out.mode, out.trace.setpoint, out.trace.target) == (Mode.ESTOP, ZERO_TWIST, ZERO_TWIST)
    robot.law.upright = False
    robot.stand.run(0.3)
    assert robot.told() == [RELEASED] * 4, "stop category 1"


def test_a_reset_that_would_let_it_fall_is_refused() -> None:
    robot = Robot()
    robot.start()
    robot.stand.cycle(ZERO_TWIST, RequestKind.ESTOP)
    robot.stand.run(1.0)
    assert "would fall: support it first" in (robot.stand.reply(RequestKind.RESET) or "")
    assert (robot.stand.out.mode, robot.told()) == (Mode.ESTOP, [STOPPED] * 4)
    robot.law.upright = False
    assert robot.stand.reply(RequestKind.RESET) is None
    assert robot.stand.is_in(Mode.IDLE)


def test_a_shutdown_waits_for_somebody_to_take_it() -> None:
    robot = Robot()
    robot.start()
    robot.stand.cycle(ZERO_TWIST, RequestKind.SHUTDOWN)
    assert not robot.stand.run(10.0, ZERO_TWIST).finished
    assert robot.told() == [DRIVEN] * 4
    robot.law.upright = False
    assert robot.stand.run(0.3).finished


def test_a_motor_with_a_fault_is_released_and_the_others_go_on() -> None:
    robot = Robot()
    robot.start()
    robot.fail(latched=True)
    robot.stand.run(5.0, ZERO_TWIST)
    assert robot.stand.is_in(Mode.FAULT)
    assert robot.told() == [RELEASED, RELEASED, DRIVEN, DRIVEN]
    robot.stand.cycle(ZERO_TWIST, RequestKind.ESTOP)
    assert robot.told()[2:] == [STOPPED] * 2


STEPS = st.sampled_from([ZERO_TWIST, FORWARD, None, RequestKind.ESTOP, RequestKind.RESET, "fault", "well", "sway"])


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(STEPS, st.integers(1, 60)), max_size=25))
def test_whatever_happens_it_is_never_let_go_and_never_moves_by_itself(steps: list[tuple[object, int]]) -> None:
    robot = Robot()
    robot.start()
    for step, cycles in steps:
        twist = step if isinstance(step, Twist) else None
        if step == "fault":
            robot.fail(latched=False)
        elif step in ("well", "sway"):
            robot.recover()
            robot.sway(SWAY if step == "well" else 2.0 * SWAY)
        for number in range(cycles):
            before = robot.stand.out
            asked = (step,) if isinstance(step, RequestKind) and number == 0 else ()
            out = robot.stand.cycle(twist, *asked)
            assert robot.told()[2:] == [STOPPED if out.mode is Mode.ESTOP else DRIVEN] * 2, "two well motors"
            assert out.mode is not Mode.IDLE
            if out.mode not in (Mode.DRIVE, Mode.DEGRADED):
                grown = zip(before.trace.setpoint, out.trace.setpoint, strict=True)
                assert all(abs(new) <= abs(old) for old, new in grown)
                assert out.trace.target == ZERO_TWIST


def test_what_it_knows_of_itself_is_asked_where_a_status_is_made() -> None:
    robot = Robot()
    robot.start()
    robot.law.asked = 0
    told = [robot.stand.cycle(FORWARD).status for _ in range(250)]
    assert {str(status.chassis) for status in told if status} == {"{'upright': True}"}
    assert robot.law.asked == len([status for status in told if status]) < 50

"""One ODrive axis on a bench, and the frames of its bring-up as text (node 3)."""

from drivers.contract import CanFrame, MotorFeedback, MotorState
from drivers.odrive.group import OdriveDriver
from drivers.setpoint import CommandKind, MotorCommand
from tests.drivers.rig import BUS, Bench, FakeOdrive, can_text, odrive_setpoints, spec, watched

VELOCITY = MotorCommand(CommandKind.VELOCITY, 10.0)
TORQUE = MotorCommand(CommandKind.TORQUE, 0.5)
ZERO = "06D#0000000000000000"

VERSION = "060#R"
WRITES = ["064#01BD0000CDCCCC3D", "064#01BC000001000000"]
READS = ["064#00BD000000000000", "064#00BC000000000000"]
CLEAR_06, CLEAR_05 = "078#00", "078#"
VELOCITY_MODE, TORQUE_MODE = "06B#0200000001000000", "06B#0100000001000000"
LIMITS = "06F#DDA57E410000A041"  # 100 rad/s = 15.915 rev/s, 20 A
ARM, IDLE = "067#0800000000000000", "067#0100000000000000"


def stand_of(variant: str = "0.6", *, watchdog: bool = True) -> tuple[Bench, FakeOdrive]:
    motor = watched() if watchdog and variant == "0.6" else spec(variant)
    device = FakeOdrive(3, variant)
    return Bench(OdriveDriver(BUS, [motor]), [device]), device


def operational(variant: str = "0.6", *, command: MotorCommand = VELOCITY) -> tuple[Bench, FakeOdrive]:
    stand, device = stand_of(variant)
    stand.run(command, ms=1000)
    assert only(stand).state is MotorState.OPERATIONAL
    stand.sent.clear()
    return stand, device


def only(stand: Bench) -> MotorFeedback:
    (feedback,) = stand.feedback()
    return feedback


def story(stand: Bench) -> list[str]:
    """Everything sent but setpoints."""
    return [can_text(frame) for _, frame in stand.sent if not odrive_setpoints(frame)]


def times(stand: Bench, text: str) -> list[int]:
    """When this was sent, ms since it was sent first."""
    at = [now_ns // 1_000_000 for now_ns, frame in stand.sent if can_text(frame) == text]
    return [ms - at[0] for ms in at]


def fault(stand: Bench) -> tuple[str, str]:
    """Code and text of the latched fault."""
    given = only(stand).fault
    assert given is not None
    assert given.latched
    return given.code, given.text


def feed(stand: Bench, frame: CanFrame) -> None:
    assert stand.driver.receive(frame._replace(received_ns=stand.now_ns))

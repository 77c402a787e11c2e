"""Small parts of the core: commands, health, reporter, speed loop, transmission, sd_notify."""

import os
import socket
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from drivers.contract import DriverFault, MotorFeedback, MotorState
from gateway.config import Source
from gateway.control.speed_loop import SpeedLoop
from gateway.control.transmission import Transmission
from gateway.core.arbiter import Arbiter
from gateway.core.detectors import Limits, Sample
from gateway.core.health import RETURN_GRACE_NS, FaultKind, Health, HealthMonitor
from gateway.core.reporter import Due
from gateway.edges.systemd import Notifier
from gateway.types import ZERO_TWIST, TwistCommand, TwistFrame

WELL = MotorFeedback(MotorState.OPERATIONAL, 0.0, 0.0)
SILENT = MotorFeedback(MotorState.SILENT, age_ns=400_000_000)
BROKEN = MotorFeedback(MotorState.FAULT, fault=DriverFault("over_temperature", "INVERTER_OVER_TEMP", latched=True))


def command(source: str, received_ns: int) -> TwistCommand:
    return TwistCommand(source, ZERO_TWIST, TwistFrame.BODY, None, received_ns)


def test_the_timeout_of_a_source_counts_from_arrival_and_is_inclusive() -> None:
    arbiter = Arbiter([Source(name="low", priority=1, timeout=0.1), Source(name="high", priority=2, timeout=0.05)])
    arbiter.receive(command("low", 0))
    arbiter.receive(command("high", 0))
    arbiter.receive(command("stranger", 0))
    winners = [arbiter.select(now_ns).command for now_ns in (0, 50_000_000, 50_000_001, 100_000_000, 100_000_001)]
    assert [winner and winner.source for winner in winners] == ["high", "high", "low", "low", None]


RESTING = Sample(0.0, 0.0, 0.0, 0.0, fresh=True, driving=False, dt=0.004, expected=lambda: None)


def monitor() -> HealthMonitor:
    return HealthMonitor(["left", "right"], limits=[Limits(20.0, 10.0)] * 2)


def assess(health: HealthMonitor, *feedback: MotorFeedback, energised: bool = True, now_ns: int = 0) -> Health:
    return health.assess(feedback, [RESTING] * len(feedback), energised=energised, now_ns=now_ns)


def test_silence_and_faults_are_told_apart_and_latched_ones_stay() -> None:
    health = monitor()
    assert assess(health, WELL, WELL, energised=False) == ((True, True),) * 3 + ((),)
    silent = assess(health, SILENT, WELL, energised=False)
    assert silent.usable == (False, True)
    assert [(fault.kind, fault.latched, str(fault)) for fault in silent.faults] == [
        (FaultKind.SILENT, False, "left: silent for 0.40 s")
    ]
    assert assess(health, WELL, BROKEN, energised=False).usable == (True, False)
    assert assess(health, WELL, WELL, energised=False).usable == (True, False)
    health.reset()
    assert assess(health, WELL, WELL, energised=False).usable == (True, True)


def test_a_motor_heard_in_part_is_told_in_the_words_of_its_driver() -> None:
    half = SILENT._replace(silence="heartbeats arrive, but Get_Encoder_Estimates never came")
    found = assess(monitor(), half, WELL, energised=False)
    assert [str(fault) for fault in found.faults] == [f"left: {half.silence}"]


def test_a_motor_lost_while_energised_is_not_taken_back_before_rest() -> None:
    health = monitor()
    assess(health, SILENT, WELL)
    back = assess(health, WELL, WELL, now_ns=1)
    assert (back.usable, back.obeying, back.faults) == ((False, True), (False, True), ())
    assert back.brakable == (True, True), "an emergency stop takes every brake there is"
    health.forgive()
    assert assess(health, WELL, WELL, now_ns=2).usable[0]


def test_a_motor_that_was_released_while_energised_is_lost() -> None:
    health = monitor()
    health.lose([1])
    assert assess(health, WELL, WELL).obeying == (True, False)


def test_a_motor_out_of_reach_is_waited_for_and_lost_only_if_it_no_longer_obeys() -> None:
    for after, obeying in ((WELL, True), (MotorFeedback(MotorState.STARTING, 0.0, 0.0), False)):
        health = monitor()
        assess(health, WELL, WELL)
        away = health.assess([SILENT, WELL], [RESTING] * 2, out_of_reach={0}, energised=True, now_ns=1)
        assert (away.usable, away.obeying) == ((False, True), (True, True))
        assert assess(health, SILENT, WELL, now_ns=1 + RETURN_GRACE_NS - 1).obeying == (True, True)
        assert assess(health, after, WELL, now_ns=1 + RETURN_GRACE_NS - 1).obeying == (obeying, True)
    health = monitor()
    health.assess([SILENT, WELL], [RESTING] * 2, out_of_reach={0}, energised=True, now_ns=1)
    assert assess(health, SILENT, WELL, now_ns=1 + RETURN_GRACE_NS).obeying == (False, True)


def test_leaving_operation_while_driving_is_a_fault_even_without_an_error_code() -> None:
    health = monitor()
    assess(health, WELL, WELL)
    assert assess(health, MotorFeedback(MotorState.IDLE, 0.0, 0.0), WELL).usable == (False, True)


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=1, max_size=60))
def test_the_speed_loop_never_exceeds_its_torque(samples: list[tuple[float, float]]) -> None:
    loop = SpeedLoop(kp=2.0, ki=4.0, max_torque=4.5)
    assert all(abs(loop.torque(setpoint, speed, 0.004)) <= 4.5 for setpoint, speed in samples)


def test_the_speed_loop_does_not_wind_up() -> None:
    """Blocked at full torque for ten seconds, it lets go within a few cycles of the setpoint's return."""
    loop = SpeedLoop(kp=2.0, ki=4.0, max_torque=4.5)
    for _ in range(2500):
        assert loop.torque(10.0, 0.0, 0.004) == 4.5
    assert loop.torque(0.0, 0.0, 0.004) < 4.5
    assert loop.torque(0.0, None, 0.004) == 0.0


def test_transmission_applies_ratio_sign_and_zero_once() -> None:
    gear = Transmission(ratio=-50.0, zero=0.5)
    assert gear.motor_speed(2.0) == -100.0
    assert gear.motor_torque(75.0) == -1.5
    assert gear.output(-100.0, -75.0) == (2.0, 1.0)
    assert gear.output(None, None) == (None, None)
    assert gear.output_torque(-1.5) == 75.0


def test_due_keeps_its_rate_and_does_not_burst() -> None:
    due = Due(10.0)
    period = 100_000_000
    assert [due(now) for now in (0, 1, period - 1, period, 5 * period + 1, 5 * period + 2, 6 * period)] == [
        True,
        False,
        False,
        True,
        True,
        False,
        True,
    ]


def test_systemd_is_told_and_its_variables_do_not_leak(tmp_path: Path) -> None:
    path = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(path))
        manager.settimeout(5.0)
        environment = {"NOTIFY_SOCKET": str(path), "WATCHDOG_USEC": "3000000", "WATCHDOG_PID": str(os.getpid())}
        notifier = Notifier(environment)
        assert environment == {}
        notifier.ready("idle")
        assert manager.recv(100) == b"READY=1\nSTATUS=idle"
        second = 1_000_000_000
        for now_ns in (2 * second, 2 * second + 1, 3 * second):
            notifier.feed_watchdog(now_ns)
        notifier.stopping()
        assert [manager.recv(100) for _ in range(3)] == [b"WATCHDOG=1", b"WATCHDOG=1", b"STOPPING=1"]
        notifier.close()


def test_without_systemd_nothing_happens() -> None:
    notifier = Notifier({"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "1"})
    notifier.ready("idle")
    notifier.feed_watchdog(1)


def test_a_service_manager_that_is_gone_does_not_stop_the_robot(tmp_path: Path) -> None:
    path = tmp_path / "notify"
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.bind(str(path))
    notifier = Notifier({"NOTIFY_SOCKET": str(path)})
    manager.close()
    notifier.status("still here")
    notifier.close()

"""Which motors may be driven, may ramp down and may brake, and which faults say why not."""

from collections.abc import Iterable

import pytest

from drivers.contract import DriverFault, MotorFeedback, MotorState
from gateway.core.detectors import Limits, Sample
from gateway.core.health import Fault, FaultKind, Health, HealthMonitor

RETURN_GRACE_NS = 150_000_000

WELL = MotorFeedback(MotorState.OPERATIONAL, 0.0, 0.0)
SILENT = MotorFeedback(MotorState.SILENT, age_ns=400_000_000)
BROKEN = MotorFeedback(MotorState.FAULT, fault=DriverFault("over_temperature", "INVERTER_OVER_TEMP", latched=True))


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


DT = 1 / 64


def sample(setpoint: float, speed: float, position: float, torque: float, *, driving: bool = True) -> Sample:
    return Sample(setpoint, speed, position, torque, fresh=True, driving=driving, dt=DT, expected=lambda: None)


STALL = [sample(10.0, 0.0, 0.001 * cycle, 9.0) for cycle in range(16)]  # 0.25 s
SAMPLES = {
    FaultKind.STALL: STALL,
    FaultKind.FOLLOWING: [sample(10.0, 3.0, 3.0 * DT * cycle, 5.0) for cycle in range(32)],
    FaultKind.FROZEN: [sample(10.0, 0.0, 0.0, 3.0)] * 11,
    FaultKind.RUNAWAY: [sample(0.0, cycle**2 / 4, cycle**3 * DT / 12, -5.0, driving=False) for cycle in range(7)],
}


def look(health: HealthMonitor, samples: Iterable[Sample], *, feedback: MotorFeedback = WELL) -> Health:
    """Samples of the left motor, one per cycle, while the robot is energised."""
    for x in samples:
        found = health.assess([feedback, WELL], [x, RESTING], energised=True, now_ns=0)
    return found


@pytest.mark.parametrize(
    ("kind", "usable", "obeying", "brakable"),
    [
        (FaultKind.STALL, (False, True), (True, True), (True, True)),
        (FaultKind.FOLLOWING, (False, True), (True, True), (True, True)),
        (FaultKind.FROZEN, (False, True), (False, True), (False, True)),
        (FaultKind.RUNAWAY, (False, False), (False, False), (False, False)),
    ],
)
def test_what_each_detector_takes_from_a_motor(
    kind: FaultKind, usable: tuple[bool, ...], obeying: tuple[bool, ...], brakable: tuple[bool, ...]
) -> None:
    health = monitor()
    assert look(health, SAMPLES[kind][:-1]).faults == ()
    found = look(health, SAMPLES[kind][-1:])
    assert [(fault.kind, fault.subject, fault.latched) for fault in found.faults] == [(kind, "left", True)]
    assert found[:3] == (usable, obeying, brakable)
    assert look(health, [RESTING])[:3] == found[:3], "latched"


def test_a_motor_whose_torque_does_not_arrive_is_none_that_runs_away() -> None:
    """The robot drags its wheel along, in an emergency stop too, in which the others must go on braking."""
    health = monitor()
    lost = (0, "the robot does not move by its torque")
    health.assess([WELL, WELL], [RESTING] * 2, energised=True, powerless=lost, now_ns=0)
    found = look(health, SAMPLES[FaultKind.RUNAWAY])
    assert [fault.kind for fault in found.faults] == [FaultKind.TORQUE_LOST]
    assert found[:3] == ((False, True), (False, True), (True, True))
    health.reset()
    assert FaultKind.RUNAWAY in {fault.kind for fault in look(health, SAMPLES[FaultKind.RUNAWAY]).faults}


def test_a_twin_that_a_driver_tells_cannot_brake_its_motor() -> None:
    health = monitor()
    assess(health, WELL, WELL)
    told = DriverFault("id_twin", "two controllers answer as id 1", latched=True)
    found = assess(health, MotorFeedback(MotorState.FAULT, 0.0, 0.0, fault=told), WELL)
    assert [(fault.kind, fault.subject, fault.latched) for fault in found.faults] == [(FaultKind.TWIN, "left", True)]
    assert found[:3] == ((False, True), (False, True), (False, True))


def test_a_wheel_that_moves_against_its_torque_is_named_where_the_others_tell() -> None:
    wrong = [sample(10.0, 10.0 - 20.0 * DT * cycle, 0.1 * cycle, 9.0) for cycle in range(8)]
    right = Sample(10.0, 10.0, None, 1.0, fresh=True, driving=True, dt=DT, expected=lambda: None)
    for redundant, kinds in ((True, [FaultKind.REVERSED]), (False, [])):
        health = HealthMonitor(["left", "right"], limits=[Limits(20.0, 10.0)] * 2)
        for x in wrong:
            found = health.assess([WELL, WELL], [x, right], energised=True, redundant=redundant, now_ns=0)
        assert [fault.kind for fault in found.faults] == kinds
    assert found.brakable == (True, True)


@pytest.mark.parametrize("pause", ["reset", "forgive", "look_anew", "out of operation", "out of reach"])
def test_after_a_pause_a_motor_is_judged_anew(pause: str) -> None:
    health = monitor()
    look(health, STALL[:15])
    if pause == "out of operation":
        assess(health, MotorFeedback(MotorState.IDLE), WELL, energised=False)
    elif pause == "out of reach":
        health.assess([WELL, WELL], [RESTING] * 2, out_of_reach={0}, energised=True, now_ns=-1)
    else:
        getattr(health, pause)()
    assert look(health, STALL[:15]).faults == ()


def test_a_motor_on_a_bus_that_is_down_is_not_driven_though_it_was_just_heard() -> None:
    health = monitor()
    away = health.assess([WELL, WELL], [RESTING] * 2, out_of_reach={0}, energised=True, now_ns=5)
    assert (away.usable, away.obeying) == ((False, True), (True, True))
    assert assess(health, WELL, WELL, now_ns=6).usable == (True, True)


def test_only_a_motor_that_obeyed_can_leave_operation() -> None:
    idle = MotorFeedback(MotorState.IDLE)
    health = monitor()
    assert assess(health, idle, WELL).faults == (), "not brought up yet"
    assess(health, WELL, WELL)
    assert assess(health, idle, WELL, energised=False).faults == ()
    left = Fault(FaultKind.MOTOR, "left", "stopped obeying (is idle)", latched=False)
    assert assess(health, idle, WELL).faults == (left,)
    assert assess(health, idle, WELL).faults == (), "lost is lost: told once"
    health = monitor()
    assess(health, WELL, WELL)
    health.forgive()
    assert assess(health, idle, WELL).faults == (), "released at rest"


def test_faults_found_elsewhere_are_told_with_the_others() -> None:
    bus = Fault(FaultKind.BUS, "can0", "bus off", latched=False)
    joint = Fault(FaultKind.POSITION_UNKNOWN, "right", "unknown", latched=True)
    health = monitor()
    found = health.assess([WELL, WELL], [RESTING] * 2, others=[bus, joint], energised=False, now_ns=0)
    assert found == ((True, False), (True, True), (True, True), (bus, joint))
    assert assess(health, WELL, WELL, energised=False).faults == (joint,)

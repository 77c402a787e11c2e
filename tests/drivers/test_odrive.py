"""ODrive once armed: release, change of mode, reboot, faults and measurements."""

from math import pi
from struct import pack, unpack

import pytest

from drivers.contract import Capabilities, MotorFeedback, MotorState, Traffic
from drivers.odrive.firmware import FIRMWARES
from drivers.odrive.group import OdriveDriver
from drivers.setpoint import BRAKE, COAST, CommandKind, MotorCommand
from tests.drivers.odrive_stand import (
    ARM,
    CLEAR_06,
    IDLE,
    LIMITS,
    READS,
    TORQUE,
    TORQUE_MODE,
    VELOCITY,
    VELOCITY_MODE,
    VERSION,
    WRITES,
    ZERO,
    fault,
    feed,
    only,
    operational,
    stand_of,
    story,
    times,
)
from tests.drivers.rig import BUS, MS, Bench, FakeOdrive, can_frame, can_text, odrive_setpoints, spec

# --- while armed ---


def test_brake_is_velocity_zero_in_closed_loop() -> None:
    stand, device = operational()
    frames = stand.run(BRAKE, ms=200)
    assert {can_text(frame) for frame in frames} == {ZERO}
    assert device.axis_state == 8
    assert only(stand).state is MotorState.OPERATIONAL


def test_coast_releases_at_once_and_repeats_until_the_heartbeat_says_idle() -> None:
    stand, device = operational()
    device.deaf = lambda frame: frame.id == 0x067
    frames = stand.cycle([COAST])
    assert [can_text(frame) for frame in frames] == [IDLE, ZERO]
    stand.run(COAST, ms=996)
    assert story(stand) == [IDLE] * 10
    assert only(stand).state is MotorState.STARTING
    device.deaf = lambda _frame: False
    stand.run(COAST, ms=1000)
    assert 1 <= story(stand)[10:].count(IDLE) <= 2
    assert only(stand).state is MotorState.IDLE
    assert only(stand).fault is None


def test_coast_during_arming_is_not_overtaken_by_it() -> None:
    stand, device = stand_of("0.5")
    stand.run(VELOCITY, ms=1000, until=lambda: device.axis_state == 8)
    stand.run(COAST, ms=300)
    assert story(stand)[-1] == IDLE
    assert device.axis_state == 1
    assert only(stand).state is MotorState.IDLE


def test_another_control_mode_is_set_in_idle() -> None:
    stand, _ = operational(command=VELOCITY)
    stand.run(TORQUE, ms=500)
    assert story(stand) == [IDLE, CLEAR_06, *[TORQUE_MODE] * 3, *[LIMITS] * 3, ARM]
    assert unpack("<ff", stand.cycle([TORQUE])[0].data) == (0.5, 0.0)
    stand.sent.clear()
    stand.run(VELOCITY, ms=500)
    assert story(stand) == [IDLE, CLEAR_06, *[VELOCITY_MODE] * 3, *[LIMITS] * 3, ARM]


def test_reboot_starts_over_with_the_watchdog() -> None:
    stand, device = operational()
    device.powered = False
    stand.run(VELOCITY, ms=200)
    assert only(stand).state is MotorState.SILENT
    stand.run(VELOCITY, ms=800)
    assert only(stand).fault is None
    assert set(story(stand)) == {IDLE}
    stand.sent.clear()
    device.reboot()
    device.powered = True
    stand.run(VELOCITY, ms=1000)
    assert [text for text in story(stand) if text != IDLE] == [
        *(VERSION, *WRITES, *READS),
        *(CLEAR_06, *[VELOCITY_MODE] * 3, *[LIMITS] * 3, ARM),
    ]
    assert only(stand).state is MotorState.OPERATIONAL


def test_a_controller_that_says_it_is_booting_starts_over_without_a_fault() -> None:
    stand, device = operational()
    device.reboot()
    device.errors = 0x1
    feed(stand, device.heartbeat())
    stand.run(VELOCITY, ms=500)
    assert ARM not in story(stand)
    assert only(stand).state is MotorState.STARTING
    assert only(stand).fault is None
    device.errors = 0
    stand.run(VELOCITY, ms=500)
    assert VERSION in story(stand)
    assert only(stand).state is MotorState.OPERATIONAL


def test_what_was_read_back_before_a_reboot_does_not_count_after_it() -> None:
    stand, device = operational()
    device.powered = False
    stand.run(VELOCITY, ms=1000)
    device.reboot()
    device.powered = True
    device.deaf = lambda frame: frame.id == 0x064  # neither written nor read back
    stand.run(VELOCITY, ms=2000)
    assert READS[1] in story(stand)
    assert ARM not in story(stand)


def test_release_does_not_wait_for_the_period_of_the_last_one() -> None:
    stand, device = operational()
    for _ in range(12):  # 48 ms, heartbeats in every cycle: released and armed again well within 100 ms
        stand.cycle([TORQUE])
        feed(stand, device.heartbeat())
    assert device.axis_state == 8
    assert can_text(stand.cycle([COAST])[0]) == IDLE


def test_missing_estimates_are_silence_that_heals() -> None:
    stand, device = operational()
    device.encoder = False
    stand.run(VELOCITY, ms=60)
    assert only(stand).state is MotorState.SILENT
    assert [can_text(frame) for frame in stand.cycle([VELOCITY])] == [ZERO]
    device.encoder = True
    stand.run(VELOCITY, ms=8)
    assert only(stand).state is MotorState.OPERATIONAL
    assert only(stand).fault is None


def test_missing_heartbeats_are_silence_although_estimates_come() -> None:
    stand, device = operational()
    device.next_heartbeat_ns = stand.now_ns + 1000 * MS
    stand.run(VELOCITY, ms=320)
    assert only(stand).state is MotorState.SILENT
    assert [can_text(frame) for frame in stand.cycle([VELOCITY])][-1] == ZERO
    stand.run(VELOCITY, ms=1500)
    assert VERSION in story(stand)
    assert only(stand).state is MotorState.OPERATIONAL


# --- faults ---


def test_armed_drop_without_error_bit_is_a_latched_fault() -> None:
    stand, device = operational()
    device.axis_state, device.result, device.disarm_reason = 1, 3, 0x0400_0000
    feed(stand, device.heartbeat())
    assert only(stand).state is MotorState.FAULT
    assert fault(stand) == ("disarmed", "left CLOSED_LOOP_CONTROL on its own, procedure result DISARMED")
    assert not any(any(odrive_setpoints(frame)) for frame in stand.run(VELOCITY, ms=1000))
    assert story(stand) == ["063#R"]
    assert fault(stand)[1].endswith("disarm reason: SPINOUT_DETECTED")
    stand.driver.clear_faults()
    assert only(stand).fault is None
    stand.run(COAST, ms=1000)
    assert ARM not in story(stand)
    assert only(stand).state is MotorState.IDLE
    stand.run(VELOCITY, ms=500)
    assert only(stand).state is MotorState.OPERATIONAL


@pytest.mark.parametrize(
    ("errors", "code", "words"),
    [
        (0x4000, "over_temperature", "INVERTER_OVER_TEMP"),
        (0x200, "under_voltage", "DC_BUS_UNDER_VOLTAGE"),
        (0x0100_0002, "watchdog", "SYSTEM_LEVEL, WATCHDOG_TIMER_EXPIRED"),
        (0x8000_0010, "device_error", "BAD_CONFIG, unknown 0x80000000"),
    ],
)
def test_error_bits_of_06_in_the_words_of_the_vendor(errors: int, code: str, words: str) -> None:
    stand, device = operational()
    device.errors, device.axis_state = errors, 1
    feed(stand, device.heartbeat())
    assert fault(stand) == (code, words)
    device.errors = 0
    stand.run(COAST, ms=1000)
    assert fault(stand)[0] == code
    assert CLEAR_06 not in story(stand)


WATCHDOG_EXPIRED = 0x0100_0000


def test_the_watchdog_of_the_controller_is_a_fault_until_the_host_lets_go() -> None:
    """It missed our frames; nothing is broken, but nothing is armed again by itself either."""
    stand, device = operational()
    device.errors, device.axis_state = WATCHDOG_EXPIRED, 1
    stand.run(VELOCITY, ms=1000)
    assert only(stand).fault == ("watchdog", "WATCHDOG_TIMER_EXPIRED", False)
    assert device.axis_state == 1
    assert {can_text(frame) for frame in stand.cycle([VELOCITY])} == {ZERO}
    stand.run(COAST, ms=300)
    assert only(stand).fault is None
    assert only(stand).state is MotorState.IDLE
    stand.run(VELOCITY, ms=1000)
    assert only(stand).state is MotorState.OPERATIONAL
    assert device.errors == 0


def test_a_watchdog_left_by_a_former_host_does_not_hinder_arming() -> None:
    stand, device = stand_of()
    device.errors = WATCHDOG_EXPIRED
    stand.run(COAST, ms=500)
    assert only(stand).fault is None
    stand.run(VELOCITY, ms=1000)
    assert only(stand).state is MotorState.OPERATIONAL


def test_error_bits_before_arming_are_latched_too() -> None:
    stand, device = stand_of()
    device.errors = 0x200
    stand.run(VELOCITY, ms=1000)
    assert fault(stand)[0] == "under_voltage"
    assert CLEAR_06 not in story(stand)
    stand.driver.clear_faults()
    stand.run(VELOCITY, ms=1000)
    assert only(stand).state is MotorState.OPERATIONAL


def test_a_heartbeat_on_its_way_does_not_bring_a_cleared_fault_back() -> None:
    stand, device = operational()
    device.errors, device.axis_state = 0x200, 1
    stale = device.heartbeat()
    feed(stand, stale)
    stand.run(COAST, ms=500)
    stand.driver.clear_faults()
    stand.cycle([COAST])
    feed(stand, stale)
    assert only(stand).fault is None
    stand.run(COAST, ms=500)
    assert only(stand).state is MotorState.IDLE


def test_a_cause_that_persists_comes_back() -> None:
    stand, device = operational()
    device.errors, device.axis_state = 0x200, 1
    device.deaf = lambda frame: frame.id == 0x078
    stand.run(COAST, ms=500)
    stand.driver.clear_faults()
    stand.sent.clear()
    stand.run(COAST, ms=1000)
    assert 3 <= story(stand).count(CLEAR_06) <= 6
    assert fault(stand)[0] == "under_voltage"


def test_clear_leaves_a_well_axis_alone() -> None:
    stand, _ = operational()
    stand.driver.clear_faults()
    stand.run(VELOCITY, ms=200)
    assert story(stand) == []
    assert stand.states == [MotorState.OPERATIONAL]


def test_arming_in_vain_asks_why_and_says_so() -> None:
    stand, device = stand_of()
    device.arms, device.disarm_reason, device.result = False, 0x40, 14
    stand.run(VELOCITY, ms=3000)
    assert 1 <= story(stand).count(ARM) <= 4
    assert story(stand).index("063#R") > story(stand).index(ARM)
    code, text = fault(stand)
    assert code == "arming_failed"
    assert text.endswith("within 1 s, procedure result NOT_CALIBRATED; disarm reason: MISSING_INPUT")
    assert IDLE in story(stand)[story(stand).index(ARM) :]
    device.arms, device.result = True, 0
    stand.driver.clear_faults()
    stand.run(VELOCITY, ms=1000)
    assert only(stand).state is MotorState.OPERATIONAL


def test_arming_in_vain_with_no_answer_to_why_is_a_fault_all_the_same() -> None:
    stand, device = stand_of()
    device.arms = False
    device.deaf = lambda frame: frame.id == 0x063
    stand.run(VELOCITY, ms=3000)
    assert fault(stand)[0] == "arming_failed"


def test_05_is_asked_for_its_sub_errors() -> None:
    stand, device = operational("0.5")
    device.errors, device.axis_state, device.disarm_reason = 0x40, 1, 0x8_0000_0008
    stand.run(VELOCITY, ms=500)
    assert story(stand) == ["063#R", "064#R", "07D#R"]
    assert fault(stand) == ("motor", "MOTOR_FAILED; motor: DRV_FAULT, UNBALANCED_PHASES")


def test_05_flags_alone_are_a_fault() -> None:
    stand, _ = operational("0.5")
    feed(stand, can_frame("061#0000000008000100"))
    assert fault(stand) == ("encoder", "encoder error flag")


def test_a_latched_fault_outlives_silence() -> None:
    stand, device = operational()
    device.errors, device.axis_state = 0x200, 1
    stand.run(COAST, ms=500)
    device.powered = False
    stand.run(COAST, ms=500)
    assert only(stand).state is MotorState.SILENT
    assert fault(stand)[0] == "under_voltage"
    device.reboot()
    device.powered = True
    stand.run(COAST, ms=500)
    assert only(stand).state is MotorState.FAULT


def test_why_is_asked_for_ten_times_a_second_and_only_what_is_still_missing() -> None:
    stand, device = operational("0.5")
    device.errors, device.axis_state, device.disarm_reason = 0x40, 1, 0x8
    device.deaf = lambda frame: frame.id == 0x064
    feed(stand, device.heartbeat())
    for _ in range(100):
        stand.cycle([VELOCITY])
        feed(stand, device.heartbeat())  # one that comes meanwhile begins nothing anew
    assert story(stand) == ["063#R", "064#R", "07D#R", "064#R", "064#R"]
    assert times(stand, "064#R") == [0, 100, 200]


def test_a_reason_told_late_is_told_all_the_same_and_not_again() -> None:
    stand, device = operational()
    device.errors, device.axis_state, device.disarm_reason = 0x200, 1, 0x40
    device.deaf = lambda frame: frame.id == 0x063
    feed(stand, device.heartbeat())
    stand.run(COAST, ms=60)
    device.deaf = lambda _frame: False
    stand.run(COAST, ms=100)
    assert fault(stand)[1] == "DC_BUS_UNDER_VOLTAGE; disarm reason: MISSING_INPUT"
    stand.driver.clear_faults()
    stand.run(VELOCITY, ms=1000)
    device.errors, device.axis_state, device.deaf = 0x4000, 1, lambda frame: frame.id == 0x063
    feed(stand, device.heartbeat())
    stand.run(COAST, ms=500)
    assert fault(stand)[1] == "INVERTER_OVER_TEMP"


def test_a_fault_outlives_a_controller_that_goes_off_with_it() -> None:
    stand, device = operational()
    device.errors, device.axis_state = 0x200, 1
    feed(stand, device.heartbeat())
    device.powered = False
    stand.run(COAST, ms=500)
    assert fault(stand)[0] == "under_voltage"


def test_a_clear_while_why_is_asked_counts() -> None:
    stand, device = stand_of()
    device.arms, device.deaf = False, lambda frame: frame.id == 0x063
    stand.run(VELOCITY, ms=3000, until=lambda: "063#R" in story(stand))
    assert only(stand).fault is None
    stand.driver.clear_faults()
    device.arms = True
    stand.run(VELOCITY, ms=1000)
    assert only(stand).state is MotorState.OPERATIONAL


def test_a_clear_takes_a_fault_that_is_not_latched_too() -> None:
    stand, device = operational()
    device.errors, device.axis_state = WATCHDOG_EXPIRED, 1
    stand.run(VELOCITY, ms=200)
    assert only(stand).fault is not None
    stand.driver.clear_faults()
    assert only(stand).fault is None


def test_clearing_is_asked_for_ten_times_a_second_for_half_a_second() -> None:
    stand, device = operational()
    device.errors, device.axis_state, device.deaf = 0x200, 1, lambda frame: frame.id == 0x078
    stand.run(COAST, ms=500)
    stand.driver.clear_faults()
    stand.run(COAST, ms=1000)
    assert times(stand, CLEAR_06) == [0, 100, 200, 300, 400]


def test_release_is_asked_for_ten_times_a_second() -> None:
    stand, device = operational()
    device.deaf = lambda frame: can_text(frame) == IDLE
    stand.run(TORQUE, ms=1000)
    assert set(story(stand)) == {IDLE}, "the mode is only ever changed in IDLE"
    assert times(stand, IDLE) == list(range(0, 1000, 100))


# --- measurements ---


def test_silence_begins_300_ms_after_a_heartbeat_and_50_ms_after_an_estimate() -> None:
    driver = OdriveDriver(BUS, [spec("0.6")])
    heartbeat, estimates = can_frame("061#0000000001000000"), can_frame("069#0000000000000000")
    assert driver.feedback(now_ns=0)[0] == MotorFeedback(MotorState.SILENT)
    driver.receive(heartbeat._replace(received_ns=1000 * MS))
    for heard, silent in ((1000 * MS, 1050 * MS), (1250 * MS, 1300 * MS)):
        driver.receive(estimates._replace(received_ns=heard))
        assert driver.feedback(now_ns=heard)[0].age_ns == 0
        for now_ns, state in ((silent - 1, MotorState.STARTING), (silent, MotorState.SILENT)):
            assert driver.feedback(now_ns=now_ns)[0].state is state
    driver.receive(estimates._replace(received_ns=1260 * MS))
    assert driver.feedback(now_ns=1300 * MS - 1)[0].silence is None
    assert driver.feedback(now_ns=1300 * MS)[0].state is MotorState.SILENT
    words = driver.feedback(now_ns=1300 * MS)[0].silence or ""
    assert words.startswith("estimates arrive, but Heartbeat has not come for 0.30 s")
    driver.receive(heartbeat._replace(received_ns=1300 * MS))
    words = driver.feedback(now_ns=1310 * MS)[0].silence or ""
    assert words.startswith("heartbeats arrive, but Get_Encoder_Estimates has not come for 0.05 s: check supply, ")


@pytest.mark.parametrize("ms", [50, 300])
def test_an_armed_axis_gets_setpoints_only_while_it_is_heard(ms: int) -> None:
    """A setpoint in the last nanosecond, and zero from the next on."""
    stand, device = operational()
    last_ns = stand.now_ns
    feed(stand, device.heartbeat())
    feed(stand, can_frame("069#0000000000000000"))
    if ms == 300:
        estimates = can_frame("069#0000000000000000")
        stand.driver.receive(estimates._replace(received_ns=last_ns + 290 * MS))
    for now_ns, driven in ((last_ns + ms * MS - 1, True), (last_ns + ms * MS, False)):
        frames = stand.driver.command([VELOCITY], now_ns=now_ns)
        assert (can_text(frames[-1]) != ZERO) is driven


def test_each_half_of_a_message_counts_for_itself() -> None:
    stand, device = operational()
    device.encoder = False
    feed(stand, can_frame("07C#0000C07F0000803E"))
    feed(stand, can_frame("077#0000C0410000C07F"))
    assert (only(stand).torque, only(stand).voltage) == (0.25, 24.0)


def test_a_parameter_nobody_asked_for_is_taken_and_dropped() -> None:
    stand, _ = stand_of(watchdog=False)
    feed(stand, can_frame("065#00BC000001000000"))


def test_what_it_sends_and_hears() -> None:
    driver = OdriveDriver(BUS, [spec("0.6", name="m")])
    assert driver.capabilities == (
        Capabilities(velocity=True, torque=True, brake=True, feed_forward=True, device_watchdog=True),
    )
    assert driver.receive_filters() == ((0x060, 0x7E0, False),)
    assert driver.ids() == (("odrive node 3 of motor m", 0x060, 0x7E0, False),)
    assert driver.traffic(loop_rate_hz=200.0) == (
        Traffic("m setpoint", False, 8, 200.0),
        Traffic("m Get_Encoder_Estimates", False, 8, 250.0),
        Traffic("m Heartbeat", False, 8, 10.0),
    )
    assert [can_text(frame) for frame in driver.coast_frames()] == [IDLE, ZERO]
    assert [can_text(frame) for frame in driver.stop_frames(now_ns=0)] == [ZERO]


def test_a_feed_forward_is_in_the_frame_of_the_velocity() -> None:
    """Bytes of a worked example: 2.5 rev/s and 0.1 N m."""
    for variant in ("0.5", "0.6"):
        stand, _ = operational(variant)
        command = MotorCommand(CommandKind.VELOCITY, 5.0 * pi, 0.1)
        assert [can_text(frame) for frame in stand.cycle([command])] == ["06D#00002040CDCCCC3D"]


def test_numbers_that_are_none_are_dropped() -> None:
    stand, device = operational()
    feed(stand, can_frame("075#0000224200007442"))
    feed(stand, can_frame("07C#0000003F0000803E"))
    feed(stand, can_frame("077#0000C0410000003F"))
    device.encoder = False
    before = only(stand)
    assert (before.voltage, before.torque, before.temperature_c) == (24.0, 0.25, 61.0)
    for bad in ("0000C07F", "0000807F", "000080FF"):
        for frame in (f"069#{bad}00000000", f"069#00000000{bad}", f"075#{bad * 2}", f"07C#{bad * 2}", f"077#{bad * 2}"):
            feed(stand, can_frame(frame))
    assert only(stand) == before
    feed(stand, can_frame("075#00002242" + "0000C07F"))
    assert only(stand).temperature_c == 40.5


def test_two_axes_are_independent() -> None:
    driver = OdriveDriver(BUS, [spec("0.5", id=0), spec("0.6", id=62)])
    assert [able.device_watchdog for able in driver.capabilities] == [False, True]
    stand = Bench(driver, [FakeOdrive(0, "0.5"), FakeOdrive(62, "0.6", powered=False)])
    for _ in range(200):
        stand.cycle([VELOCITY, BRAKE])
    assert stand.states == [MotorState.OPERATIONAL, MotorState.SILENT]
    assert max(time for time, _ in stand.sent) < 2_000 * MS


# --- half silent ---


@pytest.mark.parametrize(
    ("variant", "setting"), [("0.5", "can.encoder_rate_ms to 4 "), ("0.6", "can.encoder_msg_rate_ms to 4 ")]
)
def test_missing_estimates_are_named_with_the_setting_that_turns_them_on(variant: str, setting: str) -> None:
    stand, device = stand_of(variant)
    device.encoder = False
    stand.run(COAST, ms=500)
    motor = only(stand)
    assert motor.state is MotorState.SILENT
    assert motor.silence is not None
    assert motor.silence.startswith("heartbeats arrive, but Get_Encoder_Estimates never came: set ")
    assert setting in motor.silence
    device.encoder = True
    stand.run(COAST, ms=8)
    assert only(stand).silence is None
    device.encoder = False
    stand.run(COAST, ms=500)
    assert "heartbeats arrive, but Get_Encoder_Estimates has not come for 0.50 s" in (only(stand).silence or "")


@pytest.mark.parametrize(
    ("variant", "setting"), [("0.5", "can.heartbeat_rate_ms to 100 "), ("0.6", "can.heartbeat_msg_rate_ms to 100 ")]
)
def test_missing_heartbeats_are_named_with_the_setting_that_turns_them_on(variant: str, setting: str) -> None:
    stand, device = stand_of(variant)
    device.next_heartbeat_ns = stand.now_ns + 10_000 * MS
    stand.run(COAST, ms=500)
    motor = only(stand)
    assert motor.state is MotorState.SILENT
    assert motor.silence is not None
    assert motor.silence.startswith("estimates arrive, but Heartbeat never came: set ")
    assert setting in motor.silence


def test_one_that_says_nothing_at_all_is_told_nothing_of_its_settings() -> None:
    stand, device = stand_of()
    stand.run(COAST, ms=500)
    device.powered = False
    stand.run(COAST, ms=500)
    assert only(stand).state is MotorState.SILENT
    assert only(stand).silence is None


# --- estimates of 0.5 before the first closed loop ---


def test_05_measures_nothing_until_its_first_closed_loop() -> None:
    stand, device = stand_of("0.5")
    stand.run(COAST, ms=500)
    motor = only(stand)
    assert (motor.state, motor.position, motor.velocity) == (MotorState.IDLE, None, None)
    assert motor.age_ns is not None  # it is heard all the same
    stand.run(VELOCITY, ms=500, until=lambda: device.axis_state == 8)
    assert only(stand).position is None
    device.estimates = (3.25, 0.0)  # the real position
    stand.run(VELOCITY, ms=8)
    assert only(stand).position == pytest.approx(6.5 * pi)
    assert only(stand).velocity == 0.0
    stand.run(COAST, ms=500)
    assert only(stand).position == pytest.approx(6.5 * pi)


def test_05_at_exactly_zero_is_believed_once_the_closed_loop_is_sure() -> None:
    stand, device = stand_of("0.5")
    stand.run(VELOCITY, ms=1000, until=lambda: device.axis_state == 8)
    stand.run(VELOCITY, ms=100, until=lambda: only(stand).state is MotorState.OPERATIONAL)
    stand.run(VELOCITY, ms=40)
    assert only(stand).position is None  # may still be one that the heartbeat has overtaken
    stand.run(VELOCITY, ms=20)
    assert (only(stand).position, only(stand).velocity) == (0.0, 0.0)


def test_05_that_rebooted_unseen_measures_nothing_again() -> None:
    stand, device = operational("0.5")
    device.estimates = (3.25, 0.5)
    stand.run(VELOCITY, ms=20)
    assert only(stand).position is not None
    device.powered = False
    stand.run(COAST, ms=400)
    device.reboot()
    device.powered, device.estimates = True, (0.0, 0.0)
    device.next_heartbeat_ns = stand.now_ns + 90 * MS
    for _ in range(100):
        stand.cycle([COAST])
        assert only(stand).position is None
    assert only(stand).state is MotorState.IDLE


def test_06_at_zero_is_measured() -> None:
    stand, _ = stand_of()
    stand.run(COAST, ms=500)
    assert (only(stand).position, only(stand).velocity) == (0.0, 0.0)


@pytest.mark.parametrize(("variant", "whole"), [("0.5", 8), ("0.6", 7)])
def test_a_heartbeat_that_is_short_tells_nothing(variant: str, whole: int) -> None:
    """Least of all that what it was asked for ended well."""
    heartbeat = pack("<IB3x", 0x20, 1)
    assert [FIRMWARES[variant].heard(heartbeat[:size]) for size in range(whole)] == [None] * whole
    assert FIRMWARES[variant].heard(heartbeat[:whole]) == (0x20, 1, 0)

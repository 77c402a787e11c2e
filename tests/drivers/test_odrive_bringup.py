"""ODrive bring-up, frame by frame, against a device that answers by the book or fails to."""

import math
from struct import pack, unpack

import pytest

from drivers.contract import CanFrame, MotorState
from drivers.odrive.group import OdriveDriver
from drivers.setpoint import BRAKE, COAST
from tests.drivers.odrive_stand import (
    ARM,
    CLEAR_05,
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
    stand_of,
    story,
    times,
)
from tests.drivers.rig import (
    BUS,
    MS,
    ODRIVE_OPTIONS,
    Bench,
    FakeOdrive,
    can_frame,
    can_text,
    odrive_setpoints,
    watched,
)


def test_bringup_of_06_with_watchdog() -> None:
    stand, device = stand_of()
    stand.run(VELOCITY, ms=500)
    assert story(stand) == [VERSION, *WRITES, *READS, CLEAR_06, *[VELOCITY_MODE] * 3, *[LIMITS] * 3, ARM]
    assert only(stand).state is MotorState.OPERATIONAL
    assert device.endpoints == {188: pack("<I", 1), 189: pack("<f", 0.1)}


def test_bringup_of_06_without_watchdog() -> None:
    stand, _ = stand_of(watchdog=False)
    stand.run(TORQUE, ms=500)
    assert story(stand) == [VERSION, CLEAR_06, *[TORQUE_MODE] * 3, *[LIMITS] * 3, ARM]
    assert only(stand).state is MotorState.OPERATIONAL


def test_bringup_of_05() -> None:
    stand, _ = stand_of("0.5")
    stand.run(BRAKE, ms=500)
    assert story(stand) == [CLEAR_05, *[VELOCITY_MODE] * 3, *[LIMITS] * 3, ARM]
    assert only(stand).state is MotorState.OPERATIONAL


def test_every_cycle_has_one_setpoint_and_it_is_zero_until_operational() -> None:
    stand, _ = stand_of()
    for _ in range(100):
        setpoints = [can_text(frame) for frame in stand.cycle([VELOCITY]) if odrive_setpoints(frame)]
        assert len(setpoints) == 1
        assert setpoints == [ZERO] or stand.states == [MotorState.OPERATIONAL]
    assert unpack("<ff", stand.cycle([VELOCITY])[0].data) == (pytest.approx(10.0 / (2.0 * math.pi)), 0.0)


def test_coast_checks_but_neither_clears_nor_arms() -> None:
    stand, _ = stand_of()
    frames = stand.run(COAST, ms=1000)
    assert story(stand) == [VERSION, *WRITES, *READS]
    assert {can_text(frame) for frame in frames if odrive_setpoints(frame)} == {ZERO}
    assert only(stand).state is MotorState.IDLE
    stand.run(VELOCITY, ms=500)
    assert story(stand)[5:] == [CLEAR_06, *[VELOCITY_MODE] * 3, *[LIMITS] * 3, ARM]


def test_nobody_there_is_asked_nothing() -> None:
    stand, device = stand_of()
    device.powered = False
    stand.run(VELOCITY, ms=5000)
    assert story(stand) == []
    assert only(stand).state is MotorState.SILENT


def test_an_axis_without_estimates_is_not_armed() -> None:
    stand, device = stand_of("0.5")
    device.encoder = False
    stand.run(VELOCITY, ms=2000)
    assert story(stand) == []
    assert only(stand).state is MotorState.SILENT


def test_lost_version_replies_are_asked_for_again_in_moderation_and_heal() -> None:
    stand, device = stand_of()
    device.deaf = lambda frame: frame.remote
    stand.run(VELOCITY, ms=3000)
    assert set(story(stand)) == {VERSION}
    assert 25 <= len(story(stand)) <= 35
    given = only(stand).fault
    assert given is not None
    assert (given.code, given.latched) == ("no_version", False)
    assert only(stand).state is MotorState.FAULT
    device.deaf = lambda _frame: False
    stand.run(VELOCITY, ms=500)
    assert only(stand)[0] is MotorState.OPERATIONAL
    assert only(stand).fault is None


def test_a_fault_that_is_not_latched_ends_with_silence() -> None:
    stand, device = stand_of()
    device.deaf = lambda frame: frame.remote
    stand.run(COAST, ms=2000)
    device.powered = False
    stand.run(COAST, ms=500)
    assert only(stand).state is MotorState.SILENT
    assert only(stand).fault is None


def test_lost_read_back_replies_are_asked_for_again_in_moderation_and_heal() -> None:
    stand, device = stand_of()
    device.deaf = lambda frame: frame.id == 0x064 and frame.data[0] == 0
    stand.run(VELOCITY, ms=3000)
    assert story(stand).count(READS[0]) <= 30
    assert CLEAR_06 not in story(stand)
    faults = set()
    for _ in range(50):
        stand.cycle([VELOCITY])
        faults.add(only(stand).fault)
    (given,) = faults  # steady, although the check starts over again and again
    assert given is not None
    assert (given.code, given.latched) == ("watchdog_unverified", False)
    device.deaf = lambda _frame: False
    stand.run(VELOCITY, ms=500)
    assert only(stand).state is MotorState.OPERATIONAL


def test_a_lost_write_is_written_again() -> None:
    stand, device = stand_of()
    lost: list[CanFrame] = []

    def lose_first_write(frame: CanFrame) -> bool:
        if frame.data[:1] == b"\x01" and frame.id == 0x064 and not lost:
            lost.append(frame)
            return True
        return False

    device.deaf = lose_first_write
    stand.run(VELOCITY, ms=1000)
    assert story(stand)[:9] == [VERSION, *WRITES, *READS, *WRITES, *READS]
    assert only(stand).state is MotorState.OPERATIONAL


@pytest.mark.parametrize(
    ("firmware", "text"), [((0, 6, 11), "firmware 0.6.11, but"), ((0, 5, 6), "firmware 0.5.6, but")]
)
def test_endpoints_of_another_firmware_are_never_written(firmware: tuple[int, int, int], text: str) -> None:
    stand, device = stand_of()
    device.firmware = firmware
    stand.run(VELOCITY, ms=2000)
    assert story(stand) == [VERSION]
    code, words = fault(stand)
    assert code == "watchdog_unverified"
    assert text in words


def stand_with(**options: str | int) -> tuple[Bench, FakeOdrive]:
    """The device has firmware 0.6.10 and hardware 4.4.58."""
    device = FakeOdrive(3, "0.6")
    motor = watched()._replace(options={**ODRIVE_OPTIONS, **options})
    return Bench(OdriveDriver(BUS, [motor]), [device]), device


def test_endpoints_that_were_read_for_this_firmware_and_hardware_are_written() -> None:
    stand, device = stand_with(endpoints_of="0.6.10 4.4.58")
    stand.run(VELOCITY, ms=500)
    assert only(stand).state is MotorState.OPERATIONAL
    assert device.endpoints == {188: pack("<I", 1), 189: pack("<f", 0.1)}


def test_endpoints_of_another_hardware_are_never_written() -> None:
    stand, _ = stand_with(endpoints_of="0.6.10 5.2.0")
    stand.run(VELOCITY, ms=2000)
    assert story(stand) == [VERSION]
    assert fault(stand) == (
        "watchdog_unverified",
        "hardware 4.4.58, but the watchdog endpoints are those of 5.2.0: not written",
    )


def test_endpoints_do_not_go_to_another_firmware_by_an_edit_of_its_version() -> None:
    with pytest.raises(ValueError, match=r"188 and 189 were read for firmware 0.6.10, and options.firmware is 0.6.8"):
        stand_with(firmware="0.6.8", endpoints_of="0.6.10 4.4.58")


@pytest.mark.parametrize("proof", ["", "0.6.10", "0.6.10 4.4", "4.4.58 0.6", "0.6.10 4.4.58 188", 610])
def test_what_endpoints_were_read_for_is_two_versions(proof: str | int) -> None:
    with pytest.raises(ValueError, match=r"options.endpoints_of = .*: must be firmware and hardware"):
        stand_with(endpoints_of=proof)


def test_both_endpoints_cannot_be_the_same() -> None:
    with pytest.raises(ValueError, match=r"options.watchdog_timeout_endpoint = 188: must be another one"):
        stand_with(watchdog_timeout_endpoint=188)


def test_without_watchdog_any_06_will_do_but_no_other() -> None:
    stand, device = stand_of(watchdog=False)
    device.firmware = (0, 6, 3)
    stand.run(VELOCITY, ms=500)
    assert only(stand).state is MotorState.OPERATIONAL
    stand, device = stand_of(watchdog=False)
    device.firmware = (0, 7, 0)
    stand.run(VELOCITY, ms=500)
    assert fault(stand)[0] == "wrong_firmware"


@pytest.mark.parametrize("confirms", [False, True])
@pytest.mark.parametrize(
    ("stuck", "text"), [(188, "reads back off with 0.1 s"), (189, "reads back on with 0 s instead of on with 0.1 s")]
)
def test_a_watchdog_that_stays_off_or_different_refuses(stuck: int, text: str, *, confirms: bool) -> None:
    stand, device = stand_of()
    device.stuck, device.confirms_writes = {stuck}, confirms
    stand.run(VELOCITY, ms=3000)
    assert ARM not in story(stand)
    assert fault(stand)[0] == "watchdog_unverified"
    assert text in fault(stand)[1]
    sent = len(story(stand))
    stand.run(VELOCITY, ms=1000)
    assert len(story(stand)) == sent
    device.stuck = set()
    stand.driver.clear_faults()
    stand.run(VELOCITY, ms=1000)
    assert only(stand).state is MotorState.OPERATIONAL
    assert story(stand)[sent:] == [
        CLEAR_06,
        VERSION,
        *WRITES,
        *READS,
        CLEAR_06,
        *[VELOCITY_MODE] * 3,
        *[LIMITS] * 3,
        ARM,
    ]


def test_a_start_that_finds_the_axis_armed_releases_it_first() -> None:
    for command in (COAST, VELOCITY):
        stand, device = stand_of()
        device.axis_state = 8
        stand.run(command, ms=1000)
        assert story(stand)[0] == IDLE
        assert (story(stand).count(ARM) == 1) is (command is VELOCITY)
        assert only(stand).state is (MotorState.IDLE if command is COAST else MotorState.OPERATIONAL)


def test_a_late_confirmation_of_a_write_is_not_a_read_back() -> None:
    stand, device = stand_of()
    device.stuck = {188}
    stand.run(VELOCITY, ms=500, until=lambda: WRITES[1] in story(stand))
    stand.cycle([VELOCITY])
    stand.cycle([VELOCITY])
    feed(stand, can_frame("065#00BC000001000000"))
    stand.run(VELOCITY, ms=100)
    assert READS[1] in story(stand)
    assert ARM not in story(stand)


WATCHDOG_EXPIRED = 0x0100_0000


def test_the_version_is_asked_for_ten_times_a_second_and_missed_after_one() -> None:
    stand, device = stand_of()
    device.deaf = lambda frame: frame.remote
    stand.run(VELOCITY, ms=3000, until=lambda: only(stand).fault is not None)
    assert times(stand, VERSION) == list(range(0, 1001, 100))
    assert stand.states == [MotorState.FAULT]


def test_until_it_is_checked_an_axis_is_starting() -> None:
    stand, device = stand_of()
    device.deaf = lambda frame: frame.remote
    stand.run(COAST, ms=500)
    assert stand.states == [MotorState.STARTING]
    stand, _ = stand_of()
    states = set()
    for _ in range(125):
        stand.cycle([VELOCITY])
        states |= set(stand.states)
    assert states == {MotorState.SILENT, MotorState.STARTING, MotorState.OPERATIONAL}


def test_the_watchdog_is_read_back_after_20_ms_and_written_five_times() -> None:
    stand, device = stand_of()
    device.stuck = {188}
    for _ in range(2):
        stand.run(COAST, ms=3000)
        assert fault(stand)[0] == "watchdog_unverified"
        assert times(stand, WRITES[0]) == [0, 120, 240, 360, 480]
        assert times(stand, READS[1]) == [0, 120, 240, 360, 480]
        sent = {text: min(at for at, frame in stand.sent if can_text(frame) == text) for text in (WRITES[0], READS[1])}
        assert sent[READS[1]] - sent[WRITES[0]] == 20 * MS
        stand.sent.clear()
        stand.driver.clear_faults()


@pytest.mark.parametrize("endpoint", [188, 189])
@pytest.mark.parametrize("confirms", [False, True])
def test_half_a_read_back_is_none(endpoint: int, *, confirms: bool) -> None:
    stand, device = stand_of()
    device.confirms_writes = confirms
    device.deaf = lambda frame: frame.id == 0x064 and frame.data[:2] == bytes((0, endpoint))
    stand.run(VELOCITY, ms=2000)
    assert ARM not in story(stand)
    given = only(stand).fault
    assert given == ("watchdog_unverified", "does not answer the read-back of its watchdog", False)


def test_a_reboot_with_another_firmware_is_not_taken_for_the_old_one() -> None:
    stand, device = stand_of()
    stand.run(COAST, ms=500)
    device.powered = False
    stand.run(COAST, ms=500)
    stand.sent.clear()
    device.reboot()
    device.powered, device.deaf = True, lambda frame: frame.remote
    stand.run(COAST, ms=500)
    assert set(story(stand)) == {VERSION}
    assert only(stand).fault is None


def test_arming_is_tried_every_300_ms_for_a_second() -> None:
    stand, device = stand_of()
    device.arms = False
    device.deaf = lambda frame: frame.id == 0x063
    stand.run(VELOCITY, ms=3000, until=lambda: only(stand).fault is not None)
    assert times(stand, ARM) == [0, 300, 600, 900]
    assert times(stand, "063#R") == [0, 100, 200]
    first = min(at for at, frame in stand.sent if can_text(frame) == ARM)
    assert stand.now_ns - 4 * MS - first == 1300 * MS, "the fault is told once the controller was asked why"


def test_errors_of_a_former_host_are_cleared_ten_times_a_second_for_half_a_second() -> None:
    stand, device = stand_of()
    device.errors, device.deaf = WATCHDOG_EXPIRED, lambda frame: frame.id == 0x078
    stand.run(COAST, ms=500)
    assert story(stand) == [VERSION, *WRITES, *READS], "nobody asked for more"
    assert only(stand).fault is None
    for _ in range(200):
        stand.cycle([VELOCITY])
        if times(stand, CLEAR_06) and times(stand, CLEAR_06)[-1] < 400:
            feed(stand, device.heartbeat())
            assert only(stand).fault is None
    assert times(stand, CLEAR_06) == [0, 100, 200, 300, 400]
    assert fault(stand)[0] == "watchdog"


def test_coast_while_errors_are_cleared_arms_nothing() -> None:
    stand, device = stand_of()
    device.errors, device.deaf = WATCHDOG_EXPIRED, lambda frame: frame.id == 0x078
    stand.run(VELOCITY, ms=1000, until=lambda: CLEAR_06 in story(stand))
    device.deaf = lambda _frame: False
    stand.run(COAST, ms=1000)
    assert ARM not in story(stand)


def test_the_first_estimate_of_a_loop_that_was_closed_before_is_not_believed() -> None:
    stand, device = stand_of("0.5")
    device.powered = False
    feed(stand, can_frame("061#0000000008000000"))
    feed(stand, can_frame("069#0000000000000000"))
    assert only(stand).position is None
    for ms, position in ((49, None), (1, 0.0)):
        stand.now_ns += ms * MS
        feed(stand, can_frame("061#0000000008000000"))
        feed(stand, can_frame("069#0000000000000000"))
        assert only(stand).position == position


@pytest.mark.parametrize(("text", "lost"), [(VELOCITY_MODE, 1), (VELOCITY_MODE, 2), (LIMITS, 1), (LIMITS, 2)])
def test_what_nobody_confirms_is_sent_again_so_that_a_lost_frame_leaves_no_motor_without(text: str, lost: int) -> None:
    stand, device = stand_of()
    heard: list[str] = []

    def loses(frame: CanFrame) -> bool:
        if can_text(frame) == text:
            heard.append(text)
        return can_text(frame) == text and len(heard) <= lost

    device.deaf = loses
    stand.run(VELOCITY, ms=500)
    assert len(heard) == 3
    assert story(stand)[5:] == [CLEAR_06, *[VELOCITY_MODE] * 3, *[LIMITS] * 3, ARM]
    assert only(stand).state is MotorState.OPERATIONAL

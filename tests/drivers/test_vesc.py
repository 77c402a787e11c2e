"""VESC: what must be heard before it is driven, its command timeout seen to expire, counts into a position."""

from math import pi
from struct import pack, unpack

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.contract import CanFrame, Capabilities, MotorFeedback, MotorSpec, MotorState
from drivers.setpoint import BRAKE, COAST, CommandKind, MotorCommand
from drivers.vesc import VescDriver
from tests.drivers.rig import BUS, MS, NEEDED_OPTIONS, WATCHDOG_S, Bench, FakeVesc, can_text, spec, vesc_frame

COUNT = 2.0 * pi / 42  # rad, of 7 pole pairs
FORWARD = MotorCommand(CommandKind.VELOCITY, 10.0)


def watched(timeout: float | None = WATCHDOG_S) -> MotorSpec:
    return spec("vesc", watchdog_s=timeout, options=NEEDED_OPTIONS["vesc"])


def stand(device: FakeVesc | None = None, motor: MotorSpec | None = None) -> tuple[Bench, FakeVesc]:
    """One VESC of id 3; without a watchdog unless said otherwise."""
    fake = FakeVesc(3) if device is None else device
    return Bench(VescDriver(BUS, [spec("vesc") if motor is None else motor]), [fake]), fake


def driven(command: MotorCommand = FORWARD, motor: MotorSpec | None = None) -> tuple[Bench, FakeVesc]:
    bench, fake = stand(motor=motor)
    bench.run(command, ms=400)
    assert told(bench).state is MotorState.OPERATIONAL
    return bench, fake


def told(bench: Bench) -> MotorFeedback:
    return bench.feedback()[0]


def setpoints(frames: list[CanFrame]) -> list[str]:
    """Without the questions."""
    return [can_text(frame) for frame in frames if frame.id >> 8 != 8]


# -- setpoints --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "text"),
    [
        (MotorCommand(CommandKind.VELOCITY, 10.0), "00000303#0000029C"),  # 668.45 ERPM
        (MotorCommand(CommandKind.VELOCITY, -10.0), "00000303#FFFFFD64"),
        (MotorCommand(CommandKind.VELOCITY, 0.3), "00000303#00000014"),  # 20.05 ERPM, the minimum
        (MotorCommand(CommandKind.VELOCITY, 0.29), "00000003#00000000"),  # below it the phases are shorted
        (MotorCommand(CommandKind.VELOCITY, -0.29), "00000003#00000000"),
        (MotorCommand(CommandKind.VELOCITY, 0.0), "00000003#00000000"),
        (MotorCommand(CommandKind.TORQUE, 0.5), "00000103#00001388"),  # 5 A
        (MotorCommand(CommandKind.TORQUE, -0.00019), "00000103#FFFFFFFF"),  # 1.9 mA
        (MotorCommand(CommandKind.VOLTAGE, 6.0), "00000003#000061A8"),  # of 24 V
        (MotorCommand(CommandKind.VOLTAGE, -6.0001), "00000003#FFFF9E58"),
        (MotorCommand(CommandKind.VOLTAGE, 1e9), "00000003#000186A0"),
        (BRAKE, "00000203#00004E20"),  # 20 A
        (COAST, "00000103#00000000"),
    ],
)
def test_setpoints_are_truncated_toward_zero(command: MotorCommand, text: str) -> None:
    bench, _ = driven()
    assert setpoints(bench.cycle([command])) == [text]
    assert setpoints(bench.cycle([command])) == [text]


def test_a_voltage_is_a_share_of_the_voltage_that_was_told_last() -> None:
    volts = MotorCommand(CommandKind.VOLTAGE, 5.0)
    bench, fake = driven(volts)
    for supply, share in ((24.0, 20833), (20.0, 25000), (50.0, 10000), (4.0, 100000)):
        fake.voltage = supply
        bench.cycle([volts])
        (text,) = setpoints(bench.cycle([volts]))
        assert text == f"00000003#{share:08X}"


@pytest.mark.parametrize(("supply", "voltage", "given"), [(24.0, 11.9, False), (24.0, 12.1, True), (None, 0.1, True)])
def test_far_less_than_the_supply_of_the_robot_file_is_no_voltage(
    supply: float | None, voltage: float, given: bool
) -> None:
    """One broken message would else give full duty."""
    volts = MotorCommand(CommandKind.VOLTAGE, 5.0)
    bench, fake = driven(volts, spec("vesc")._replace(supply=supply))
    fake.voltage = voltage
    bench.run(volts, ms=8)
    frames = set(setpoints(bench.run(volts, ms=20)))
    assert all(frame.startswith("00000003#") for frame in frames) is given
    assert (told(bench).state is MotorState.OPERATIONAL) is given


def test_without_an_input_voltage_no_voltage_is_given_and_the_reason_told() -> None:
    bench, fake = driven(MotorCommand(CommandKind.VOLTAGE, 5.0))
    fake.voltage = 0.0
    bench.run(MotorCommand(CommandKind.VOLTAGE, 5.0), ms=8)
    assert set(setpoints(bench.run(MotorCommand(CommandKind.VOLTAGE, 5.0), ms=20))) == {"00000103#00000000"}
    fault = told(bench).fault
    assert fault is not None
    assert (told(bench).state, fault.code, fault.latched) == (MotorState.FAULT, "no_voltage", False)
    bench.run(FORWARD, ms=8)
    assert told(bench).state is MotorState.OPERATIONAL, "a speed needs none"


def test_what_it_can_what_it_hears_and_which_ids_it_takes() -> None:
    driver = VescDriver(BUS, [spec("vesc", id=4, name="d"), spec("vesc", id=126, name="e")])
    able = Capabilities(velocity=True, torque=True, voltage=True, brake=True, device_watchdog=True)
    assert [one._replace(least_speed=0.0) for one in driver.capabilities] == [able] * 2
    least = 20 / 7 * pi / 30  # min_erpm and pole_pairs of the rig
    assert [one.least_speed for one in driver.capabilities] == pytest.approx([least] * 2)
    assert driver.receive_filters() == (
        (4, 0x1FFF00FF, True),
        (126, 0x1FFF00FF, True),
        (0x800, 0x1FFFFF00, True),
    )
    assert driver.ids() == (
        ("vesc 4 of motor d and who asks it", 4, 0x1FFF007F, True),
        ("vesc 126 of motor e and who asks it", 126, 0x1FFF007F, True),
        ("vesc commands to all", 255, 0x1FFF00FF, True),
        ("vesc answers", 0x800, 0x1FFFFF00, True),
    )


def test_ids_beyond_16_bits_are_nobodys() -> None:
    """The firmware compares all of the id above the lowest byte with the command."""
    driver = VescDriver(BUS, [spec("vesc")])
    assert driver.receive(CanFrame(BUS, 0x903, bytes(8), extended=True, received_ns=0))
    for bit in range(16, 29):
        assert not driver.receive(CanFrame(BUS, 0x903 | 1 << bit, bytes(8), extended=True, received_ns=0))
        assert driver.decode(CanFrame(BUS, 0x903 | 1 << bit, bytes(8), extended=True)) is None


# -- the robot file ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"max_speed": 0.2}, r"max_speed = 0.2: must be 0.299199 to 14960 rad/s .*: from min_erpm = 20 up to 1e\+06"),
        ({"max_speed": 15000.0}, r"max_speed = 15000: must be"),
        (
            {"max_current": 0.04},
            r"max_current = 0.04: must be 0.05 .*: with less than 0.05 A a VESC releases its motor",
        ),
        ({"watchdog_s": 0.04}, r"watchdog.timeout = 0.04: must be 0.05 to 1 s: a shorter one cannot be seen to expire"),
        ({"watchdog_s": 1.1}, r"watchdog.timeout = 1.1: must be"),
        ({"options": {"pole_pairs": 7}}, r"options.min_erpm is missing: must be 1 to 65535, the minimum ERPM"),
        ({"options": {"min_erpm": 7}}, r"options.pole_pairs is missing: must be 1 to 100, pole pairs"),
        ({"options": {"pole_pairs": 101, "min_erpm": 7}}, r"options.pole_pairs = 101: must be 1 to 100"),
    ],
)
def test_what_a_vesc_cannot_work_with_is_refused_with_the_reason(change: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=rf"motor_3: {text}"):
        VescDriver(BUS, [MotorSpec(**spec("vesc")._asdict() | change)])


# -- what must be heard -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("statuses", "answering", "silence"),
    [
        ((9, 16), True, "STATUS arrives, but STATUS_5 never came: turn it on in CAN Status Messages, 250 Hz"),
        ((16, 27), True, "STATUS_5 arrives, but STATUS never came: turn it on in CAN Status Messages, 250 Hz"),
        ((16,), True, None),
        (
            (9, 27),
            False,
            "STATUS arrives, but an answer to what it is asked never came: CAN Mode must be VESC, firmware 6 or newer",
        ),
    ],
)
def test_a_vesc_heard_in_part_is_silent_and_never_driven(
    statuses: tuple[int, ...], answering: bool, silence: str | None
) -> None:
    bench, _ = stand(FakeVesc(3, statuses=statuses, answering=answering))
    assert set(setpoints(bench.run(FORWARD, ms=1000))) == {"00000103#00000000"}
    assert (told(bench).state, told(bench).silence) == (MotorState.SILENT, silence)


def test_a_vesc_that_no_longer_answers_is_silent_after_half_a_second() -> None:
    bench, fake = driven()
    fake.answering = False
    bench.run(FORWARD, ms=400)
    assert told(bench).state is MotorState.OPERATIONAL
    bench.run(FORWARD, ms=160)
    assert told(bench).state is MotorState.SILENT
    assert told(bench).silence is not None
    assert told(bench).silence != ""
    fake.answering = True
    bench.run(FORWARD, ms=100)
    assert told(bench).state is MotorState.OPERATIONAL


def test_temperatures_are_no_condition_and_the_hotter_one_counts() -> None:
    bench, fake = driven()
    assert told(bench).temperature_c is None
    fake.statuses = (9, 16, 27)
    bench.cycle([FORWARD])
    assert told(bench).temperature_c == 30.0


# -- faults -----------------------------------------------------------------------------------------------------------


def test_it_asks_for_fault_and_status_in_turn_often_enough_for_a_fault_that_is_there_for_half_a_second() -> None:
    bench, _ = driven()
    bench.sent.clear()
    bench.run(FORWARD, ms=1000)
    asked = [(at_ns, unpack(">BBBI", frame.data)) for at_ns, frame in bench.sent if frame.id == 0x803]
    assert {question[:3] for _, question in asked} == {(0x83, 0, 50)}
    masks = [question[3] for _, question in asked]
    assert set(masks[::2]) | set(masks[1::2]) == {1 << 15, 1 << 21}
    assert len({*masks[::2]}) == len({*masks[1::2]}) == 1
    assert all(later - earlier <= 56 * MS for (earlier, _), (later, _) in zip(asked, asked[2:], strict=False))


@pytest.mark.parametrize(("code", "word"), [(1, "OVER_VOLTAGE"), (5, "OVER_TEMP_FET"), (33, "ABS_OVERSPEED")])
def test_a_fault_that_a_vesc_forgets_is_remembered(code: int, word: str) -> None:
    bench, fake = driven()
    fake.fault = code
    bench.run(FORWARD, ms=60)
    fake.fault = 0
    assert set(setpoints(bench.run(FORWARD, ms=2000))) == {"00000103#00000000"}
    fault = told(bench).fault
    assert fault is not None
    assert (told(bench).state, fault.text, fault.latched) == (MotorState.FAULT, f"fault {code}, {word}", True)
    bench.run(COAST, ms=500)
    assert told(bench).state is MotorState.FAULT
    bench.driver.clear_faults()
    bench.run(FORWARD, ms=8)
    assert told(bench).state is MotorState.OPERATIONAL


def test_the_first_fault_is_the_one_that_is_told() -> None:
    bench, fake = driven()
    for code in (5, 4):
        fake.fault = code
        bench.run(FORWARD, ms=100)
    fault = told(bench).fault
    assert fault is not None
    assert fault.text == "fault 5, OVER_TEMP_FET"


def test_a_fault_that_is_still_there_comes_back_after_a_reset() -> None:
    bench, fake = driven()
    fake.fault = 200
    bench.run(COAST, ms=100)
    bench.driver.clear_faults()
    bench.run(COAST, ms=100)
    fault = told(bench).fault
    assert fault is not None
    assert fault.text == "fault 200, not known here"


def test_a_kill_switch_is_a_fault_until_it_is_off_and_coast_is_asked_for() -> None:
    bench, fake = driven()
    fake.killed = True
    bench.run(FORWARD, ms=60)
    assert told(bench).state is MotorState.FAULT
    bench.run(COAST, ms=60)
    assert told(bench).state is MotorState.FAULT
    fake.killed = False
    assert set(setpoints(bench.run(FORWARD, ms=500))) == {"00000103#00000000"}
    bench.run(COAST, ms=60)
    assert told(bench).state is MotorState.IDLE


# -- the command timeout ----------------------------------------------------------------------------------------------


def test_a_timeout_is_seen_to_expire_before_the_motor_is_driven() -> None:
    bench, _ = stand(motor=watched())
    bench.run(FORWARD, ms=1000, until=lambda: MotorState.STARTING in bench.states)
    bench.sent.clear()
    bench.run(FORWARD, ms=1000, until=lambda: MotorState.OPERATIONAL in bench.states)
    checked = [can_text(frame) for _, frame in bench.sent]
    assert [text for text in checked if text[:6] != "000008"] == ["00000303#0000029C"], "fed by nothing but its end"
    assert 90 * MS < bench.sent[-1][0] - bench.sent[0][0] < 140 * MS  # begun a cycle before


@pytest.mark.parametrize("timeout_ms", [0, 160, 1000])
def test_a_timeout_that_is_off_or_too_long_is_a_latched_fault(timeout_ms: int) -> None:
    bench, fake = stand(FakeVesc(3, timeout_ns=timeout_ms * MS), watched())
    frames = bench.run(FORWARD, ms=2000)
    assert set(setpoints(frames)) == {"00000103#00000000"}
    fault = told(bench).fault
    assert fault is not None
    assert (told(bench).state, fault.code, fault.latched) == (MotorState.FAULT, "watchdog_unverified", True)
    assert fault.text.startswith("its command timeout has not expired 0.1")
    assert fault.text.endswith("s after the last command: it must be 100 ms, and nobody else may command it")
    fake.timeout_ns = 100 * MS
    bench.driver.clear_faults()
    bench.run(FORWARD, ms=400)
    assert told(bench).state is MotorState.OPERATIONAL


def test_a_timeout_that_somebody_else_feeds_is_a_latched_fault() -> None:
    bench, fake = stand(motor=watched())
    for _ in range(250):
        bench.cycle([FORWARD])
        fake.fed_ns = bench.now_ns
    fault = told(bench).fault
    assert fault is not None
    assert (fault.code, fault.latched) == ("watchdog_unverified", True)


@pytest.mark.parametrize("timeout_ms", [50, 90, 130])
def test_a_timeout_that_is_not_longer_will_do(timeout_ms: int) -> None:
    """The firmware looks every 10 ms, so that 0.13 s is as good as 0.1 s."""
    bench, _ = stand(FakeVesc(3, timeout_ns=timeout_ms * MS), watched())
    bench.run(FORWARD, ms=400)
    assert told(bench).state is MotorState.OPERATIONAL


def test_what_expired_before_the_check_proves_nothing() -> None:
    """The zero current that begins the check does not arrive: the VESC says all the while that it has timed out."""
    bench, fake = stand(motor=watched())
    fake.deaf = lambda frame: frame.id >> 8 == 1
    bench.run(FORWARD, ms=1000)
    assert told(bench).state is MotorState.STARTING
    bench.run(FORWARD, ms=400)
    fault = told(bench).fault
    assert fault is not None
    assert (told(bench).state, fault.code, fault.latched) == (MotorState.FAULT, "watchdog_unverified", False)
    fake.deaf = lambda _frame: False
    bench.run(FORWARD, ms=1400)
    assert told(bench).state is MotorState.OPERATIONAL, "it goes on asking"
    assert told(bench).fault is None


def checking() -> tuple[Bench, FakeVesc]:
    """Its check has begun, and its timeout has not expired."""
    bench, fake = stand(motor=watched())
    bench.run(FORWARD, ms=1000, until=lambda: MotorState.STARTING in bench.states)
    bench.run(FORWARD, ms=40)
    assert told(bench).state is MotorState.STARTING
    return bench, fake


def test_a_check_that_silence_broke_off_says_nothing() -> None:
    """Meanwhile zero currents are sent, which feed it: that it has not expired is no wonder then."""
    bench, fake = checking()
    fake.statuses = ()
    bench.run(FORWARD, ms=300)
    assert told(bench).state is MotorState.SILENT
    fake.statuses = (9, 27)
    bench.run(FORWARD, ms=30)
    assert told(bench).fault is None
    bench.run(FORWARD, ms=200)
    assert told(bench).state is MotorState.OPERATIONAL


def test_a_reset_right_after_the_verdict_checks_anew() -> None:
    bench, fake = stand(FakeVesc(3, timeout_ns=0), watched())
    bench.run(FORWARD, ms=1000, until=lambda: MotorState.FAULT in bench.states)
    fake.timeout_ns = 100 * MS
    bench.driver.clear_faults()
    bench.run(FORWARD, ms=200)
    assert told(bench).state is MotorState.OPERATIONAL


def status_answer(*, expired: bool, at: int) -> CanFrame:
    return vesc_frame(0x83, 8, pack(">BBBIB", 3, 1, 50, 1 << 21, expired))._replace(received_ns=at)


def test_an_answer_from_before_the_check_proves_nothing() -> None:
    """It waited in an adapter: what it says of a timeout that has not expired is of another time."""
    bench, fake = stand(motor=watched())
    fake.deaf = lambda frame: frame.id >> 8 == 1
    bench.run(FORWARD, ms=1000, until=lambda: MotorState.STARTING in bench.states)
    begun_ns = bench.now_ns - 4 * MS
    bench.driver.receive(status_answer(expired=False, at=begun_ns - 1))
    bench.run(FORWARD, ms=400)
    assert told(bench).state is MotorState.STARTING


def test_a_check_that_begins_again_begins_with_nothing() -> None:
    bench, fake = checking()
    fake.deaf = lambda frame: frame.id >> 8 == 1 or frame.data[3:] == bytes.fromhex("00200000")
    bench.run(FORWARD, ms=1100)
    fake.deaf = lambda frame: frame.id >> 8 == 1
    bench.run(FORWARD, ms=400)
    assert told(bench).state is MotorState.FAULT, "the second zero current did not arrive"


@pytest.mark.parametrize("lost", [2, 3])
def test_lost_frames_give_no_wrong_verdict(lost: int) -> None:
    """Of each so many frames to it one arrives."""
    bench, fake = stand(motor=watched())
    counted = iter(range(10**6))
    fake.deaf = lambda _frame: next(counted) % lost != 0
    bench.run(FORWARD, ms=3000, until=lambda: MotorState.OPERATIONAL in bench.states)
    fault = told(bench).fault
    assert fault is None or not fault.latched


def test_it_is_checked_again_after_a_second_of_silence_and_not_after_less() -> None:
    bench, fake = driven(motor=watched())
    for silent_ms, state in ((900, MotorState.OPERATIONAL), (1100, MotorState.STARTING)):
        fake.powered = False
        bench.run(FORWARD, ms=silent_ms)
        assert told(bench).state is MotorState.SILENT
        fake.powered = True
        bench.run(FORWARD, ms=60)
        assert told(bench).state is state
        bench.run(FORWARD, ms=400)
        assert told(bench).state is MotorState.OPERATIONAL


def test_a_host_that_stood_still_for_longer_is_a_fault_until_it_asks_for_coast() -> None:
    bench, _ = driven(motor=watched())
    bench.now_ns += 90 * MS
    bench.run(FORWARD, ms=200)
    assert told(bench).state is MotorState.OPERATIONAL
    bench.now_ns += 100 * MS
    assert set(setpoints(bench.run(FORWARD, ms=200))) == {"00000103#00000000"}
    fault = told(bench).fault
    assert fault is not None
    assert (told(bench).state, fault.code, fault.latched) == (MotorState.FAULT, "host_silent", False)
    bench.run(COAST, ms=8)
    assert (told(bench).state, told(bench).fault) == (MotorState.IDLE, None)


def test_a_released_motor_may_stand_still_as_long_as_it_likes() -> None:
    bench, _ = driven(motor=watched())
    bench.run(COAST, ms=8)
    bench.now_ns += 500 * MS
    bench.run(FORWARD, ms=20)
    assert told(bench).fault is None


# -- position ---------------------------------------------------------------------------------------------------------


def fed(driver: VescDriver, counts: int, erpm: int, at: int) -> float:
    """The position after a status of each kind."""
    for command, data in ((9, pack(">ihh", erpm, 0, 0)), (27, pack(">ihxx", counts, 240))):
        assert driver.receive(vesc_frame(3, command, data)._replace(received_ns=at))
    position = driver.feedback(now_ns=at)[0].position
    assert position is not None
    return position


@pytest.mark.parametrize("speed", [0.5, 3.0, 90.0, -0.5, -3.0, -90.0])
def test_a_slow_wheel_is_seen_moving_and_never_further_than_its_count(speed: float) -> None:
    """At 0.5 rad/s a count takes 0.3 s, 75 samples; after the first ones the position follows within a hundredth."""
    driver = VescDriver(BUS, [spec("vesc")])
    before, repeated = 0.0, 0
    for index in range(2000):
        true = 0.2 + speed * index * 4e-3
        counts = int(true // COUNT)
        position = fed(driver, counts, int(speed * 30 / pi * 7), index * 4 * MS)
        assert counts * COUNT - 1e-9 <= position <= (counts + 1) * COUNT + 1e-9
        if index > 200:
            repeated = repeated + 1 if position == before else 0
            assert repeated < 2
            assert position == pytest.approx(true, abs=0.02 + abs(speed) * 4e-3)
        before = position


def test_a_wheel_that_stands_stays_where_it_is() -> None:
    driver = VescDriver(BUS, [spec("vesc")])
    assert len({fed(driver, 12, 0, at * MS) for at in range(0, 1000, 4)}) == 1


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(-(2**31) + 1, 2**31 - 1), min_size=1, max_size=30), st.integers(-(2**31), 2**31 - 1))
def test_counts_add_up_beyond_32_bits(steps: list[int], start: int) -> None:
    driver = VescDriver(BUS, [spec("vesc")])
    fed(driver, start, 0, 0)
    total = start
    for index, step in enumerate(steps, 1):
        total += step
        position = fed(driver, (total + 2**31) % 2**32 - 2**31, 0, index * MS)
        assert total * COUNT * (1 - 1e-9) - COUNT <= position or total < 0
        assert position == pytest.approx(total * COUNT, rel=1e-9, abs=1.001 * COUNT)


def test_the_age_is_that_of_the_older_of_both_measurements() -> None:
    driver = VescDriver(BUS, [spec("vesc")])
    fed(driver, 0, 0, 10 * MS)
    driver.receive(vesc_frame(3, 9, bytes(8))._replace(received_ns=14 * MS))
    assert driver.feedback(now_ns=15 * MS)[0].age_ns == 5 * MS

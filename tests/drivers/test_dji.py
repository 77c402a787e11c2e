"""DJI: turns counted across gaps, shared command frames, silence."""

from math import nan, pi
from struct import pack, unpack

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.contract import CanFrame, Capabilities, MotorSpec, MotorState, OptionValue
from drivers.dji import DjiDriver
from drivers.setpoint import BRAKE, COAST, CommandKind, MotorCommand
from tests.drivers.rig import BUS, MS, can_text, spec

TICK = 2.0 * pi / 8192


def fed(driver: DjiDriver, *, id: int = 1, angle: int, rpm: int = 0, at: int) -> bool:
    data = pack(">HhhBB", angle, rpm, 0, 25, 0)
    return driver.receive(CanFrame(BUS, 0x200 + id, data, received_ns=at))


def position_ticks(driver: DjiDriver) -> int:
    position = driver.feedback(now_ns=0)[0].position
    assert position is not None
    return round(position / TICK)


@pytest.mark.parametrize("step", [1, 700, 4095, -1, -700, -4095])
def test_turns_add_up_without_gaps(step: int) -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    rpm = round(step / 8192 * 60_000)  # one frame per ms
    for index in range(3000):
        assert fed(driver, angle=(100 + index * step) % 8192, rpm=max(-32768, min(32767, rpm)), at=index * MS)
    assert position_ticks(driver) == 100 + 2999 * step


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.integers(1, 200), st.integers(-9000, 9000)), min_size=1, max_size=20),
    st.integers(0, 8191),
)
def test_turns_across_gaps_follow_the_speed(gaps: list[tuple[int, int]], start: int) -> None:
    """Speed changes evenly in each gap, so its ends tell the mean; the rpm field is rounded as the controller does."""
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    rpm, total, now = 0, float(start), 0
    fed(driver, angle=start, rpm=rpm, at=now)
    for milliseconds, faster in gaps:
        total += 0.5 * (rpm + faster) / 60_000 * milliseconds * 8192
        rpm, now = faster, now + milliseconds * MS
        fed(driver, angle=round(total) % 8192, rpm=rpm, at=now)
    assert position_ticks(driver) == round(total)


def test_a_second_at_9000_rpm_unheard_is_150_turns() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    fed(driver, angle=0, rpm=9000, at=0)
    fed(driver, angle=40, rpm=9000, at=1000 * MS)
    assert position_ticks(driver) == 150 * 8192 + 40


def test_a_stamp_that_goes_back_counts_as_no_gap() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    fed(driver, angle=0, rpm=9000, at=1000 * MS)
    fed(driver, angle=8000, rpm=9000, at=0)
    assert position_ticks(driver) == -192


def test_an_angle_no_encoder_has_is_not_taken() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    assert not fed(driver, angle=8192, at=0)
    assert driver.feedback(now_ns=0)[0].state is MotorState.SILENT
    assert driver.decode(CanFrame(BUS, 0x201, pack(">HhhBB", 8192, 0, 0, 25, 0))) is None
    assert driver.decode(CanFrame(BUS, 0x201, pack(">HhhBB", 8191, 0, 0, 25, 0))) is not None


def test_a_command_too_short_commands_nothing() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    assert [driver.decode(CanFrame(BUS, 0x200, bytes(length))) is None for length in (0, 1, 6, 7, 8)] == [
        *(True, True, True, True),
        False,
    ]


@pytest.mark.parametrize(
    ("max_speed", "slowest"),  # half a turn of the rotor, of which the speed foretells nine tenths of its top speed
    [(48.0 * 3591 / 187, 29.4), (52.0 * 36, 59.6), (400.0, 12.8)],
)
def test_the_slowest_feedback_at_which_turns_are_counted(max_speed: float, slowest: float) -> None:
    motor = spec("c620", id=1)._replace(max_speed=max_speed, feedback_rate=slowest)
    DjiDriver(BUS, [motor])
    with pytest.raises(
        ValueError, match=rf"motor_1: feedback_rate = .*: must be {slowest} to 1000 Hz: the rotor's turns"
    ):
        DjiDriver(BUS, [motor._replace(feedback_rate=slowest - 0.1)])


def test_a_rotor_too_fast_for_any_feedback_is_refused() -> None:
    with pytest.raises(ValueError, match=r"motor_1: max_speed = 31416: must be 0 to 31415\.9 rad/s at the rotor"):
        DjiDriver(BUS, [spec("c620", id=1)._replace(max_speed=31_416.0, feedback_rate=1000.0)])


def test_limits_that_leave_no_current_are_refused() -> None:
    with pytest.raises(ValueError, match=r"motor_1: max_current or max_torque allows less than 1.2 mA, one step"):
        DjiDriver(BUS, [spec("c620", id=1)._replace(max_torque=1e-6)])


@pytest.mark.parametrize("doubt", [-0.09, 0.09])
def test_turns_are_right_at_the_slowest_feedback_if_the_speed_tells_nine_tenths(doubt: float) -> None:
    """The rotor runs at another speed between the frames than it says at both of them: by 9 % of its top speed."""
    max_speed, rate = 900.0, 28.7
    driver = DjiDriver(BUS, [spec("c620", id=1)._replace(max_speed=max_speed, feedback_rate=rate)])
    told, true = 0.5 * max_speed, (0.5 + doubt) * max_speed
    for index in range(100):
        ticks = int(true * index / rate / TICK)
        fed(driver, angle=ticks % 8192, rpm=round(told * 60 / (2 * pi)), at=round(index / rate * 1e9))
    assert position_ticks(driver) == int(true * 99 / rate / TICK)


def test_one_frame_per_four_ids_and_unused_slots_are_zero() -> None:
    driver = DjiDriver(BUS, [spec("c610", id=6), spec("c620", id=1), spec("c620", id=4)])
    for id in (1, 4, 6):
        fed(driver, id=id, angle=0, at=0)
    constant = 0.3 * 187 / 3591
    commands = [MotorCommand(CommandKind.TORQUE, torque) for torque in (0.005, 10 * constant, -20 * constant)]
    assert [can_text(frame) for frame in driver.command(commands, now_ns=1)] == [
        "200#200000000000C000",
        "1FF#000003E800000000",
    ]
    assert [frame.id for frame in DjiDriver(BUS, [spec("c620", id=5)]).coast_frames()] == [0x1FF]
    assert [frame.id for frame in DjiDriver(BUS, [spec("c620", id=4)]).stop_frames(now_ns=0)] == [0x200]


@pytest.mark.parametrize(("torque", "current", "raw"), [(0.1, 20.0, 5243), (9.0, 3.0, 2457), (9.0, 99.0, 16384)])
def test_the_tightest_limit_holds(torque: float, current: float, raw: int) -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)._replace(max_torque=torque, max_current=current)])
    fed(driver, angle=0, at=0)
    (frame,) = driver.command([MotorCommand(CommandKind.TORQUE, 50.0)], now_ns=1)
    assert frame.data == pack(">4h", raw, 0, 0, 0)


def test_the_limit_of_the_controller_holds() -> None:
    driver = DjiDriver(BUS, [spec("c610", id=1)._replace(max_current=99.0)])
    fed(driver, angle=0, at=0)
    for torque, raw in ((50.0, 10000), (-50.0, -10000)):
        (frame,) = driver.command([MotorCommand(CommandKind.TORQUE, torque)], now_ns=1)
        assert frame.data == pack(">4h", raw, 0, 0, 0)


def test_silent_after_50_ms_and_current_zero() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)._replace(feedback_rate=1000.0)])
    fed(driver, angle=0, at=0)
    pull = [MotorCommand(CommandKind.TORQUE, 0.1)]
    assert any(driver.command(pull, now_ns=50 * MS - 1)[0].data)
    assert driver.feedback(now_ns=50 * MS - 1)[0].state is MotorState.OPERATIONAL
    assert driver.feedback(now_ns=50 * MS)[0].state is MotorState.SILENT
    assert not any(driver.command(pull, now_ns=50 * MS)[0].data)
    assert not any(driver.command([COAST], now_ns=1)[0].data)
    assert driver.feedback(now_ns=1)[0].state is MotorState.IDLE


def stop_raw(driver: DjiDriver, *, at: int) -> int:
    (frame,) = driver.stop_frames(now_ns=at)
    raw: int = unpack(">4h", frame.data)[0]
    return raw


@pytest.mark.parametrize(
    ("max_speed", "rpm", "raw"),  # of a quarter of top speed (239 and 716 rpm) all 20 A brake
    [
        (100.0, 0, 0),
        (100.0, 1, 0),
        (40.0, 1, 0),
        (100.0, 2, -137),
        (100.0, -2, 137),
        (100.0, 100, -6863),
        (100.0, -100, 6863),
        (100.0, 239, -16384),
        (100.0, -5000, 16384),
        (300.0, 5, 0),  # 0.002 of top speed are 5.7 rpm
        (300.0, 6, -137),
        (300.0, 600, -13726),
    ],
)
def test_a_stop_frame_brakes_in_proportion_to_the_speed(max_speed: float, rpm: int, raw: int) -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)._replace(max_speed=max_speed)])
    fed(driver, angle=0, rpm=rpm, at=1000 * MS)
    assert stop_raw(driver, at=1000 * MS) == raw


@pytest.mark.parametrize(
    ("command_rate", "times", "share"),  # of what 5 ms may have
    [
        (250.0, (0,), 1.0),
        (200.0, (0,), 1.0),
        (50.0, (0,), 0.25),
        (250.0, (10,), 0.5),  # since the measurement
        (250.0, (-5, 0), 1.0),  # since the last frame
        (250.0, (-20, 0), 0.25),
        (250.0, (-60, -20, 0), 0.25),
        (250.0, (49.999999,), 0.1),
        (250.0, (50,), 0.0),
    ],
)
def test_a_stop_frame_is_weaker_the_longer_it_may_be_held(
    command_rate: float, times: tuple[float, ...], share: float
) -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)._replace(feedback_rate=1000.0, command_rate=command_rate)])
    for ms in times[:-1]:
        assert stop_raw(driver, at=round((1000 + ms) * MS)) == 0, "not heard yet"
    fed(driver, angle=0, rpm=200, at=1000 * MS)
    assert stop_raw(driver, at=round((1000 + times[-1]) * MS)) == pytest.approx(-13726 * share, abs=1)


def test_a_motor_never_heard_gets_no_current() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    for now_ns in (0, 1000 * MS):
        assert not any(driver.command([MotorCommand(CommandKind.TORQUE, 0.1)], now_ns=now_ns)[0].data)
        assert stop_raw(driver, at=now_ns) == 0


def test_coasting_is_no_current_whatever_value_it_carries() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    fed(driver, angle=0, at=0)
    first = driver.feedback(now_ns=0)[0]
    assert (first.state, first.age_ns) == (MotorState.IDLE, 0)
    assert not any(driver.command([MotorCommand(CommandKind.COAST, 0.1)], now_ns=0)[0].data)


def test_a_stamp_that_goes_back_far_counts_as_no_gap_either() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    fed(driver, angle=0, rpm=9000, at=200_000 * MS)
    fed(driver, angle=8000, rpm=9000, at=0)
    assert position_ticks(driver) == -192


def test_limits_of_one_step_of_current_are_enough() -> None:
    DjiDriver(BUS, [spec("c620", id=1)._replace(max_current=1.5 / 819.2)])


def test_what_it_can_what_it_hears_and_which_ids_it_takes() -> None:
    driver = DjiDriver(BUS, [spec("c620", id=4, name="d"), spec("c610", id=5, name="e")])
    assert driver.capabilities == (Capabilities(torque=True, speed_step=2.0 * pi / 60.0),) * 2  # whole rpm
    assert driver.receive_filters() == ((0x204, 0x7FF, False), (0x205, 0x7FF, False))
    assert driver.ids() == (
        ("dji command of motor d", 0x200, 0x7FF, False),
        ("dji command of motor e", 0x1FF, 0x7FF, False),
        ("dji feedback of motor d", 0x204, 0x7FF, False),
        ("dji feedback of motor e", 0x205, 0x7FF, False),
        ("dji setting of ids", 0x700, 0x7FF, False),
    )
    frame = CanFrame(BUS, 0x1FF, pack(">4h", 1, 2, 3, 4))
    numbered = tuple((f"current_raw_{number}", number - 4) for number in range(5, 9))
    assert driver.decode(frame) == (None, "command", numbered, ("e", None, None, None))
    assert driver.decode(frame._replace(bus="can1")) is None


# -- GM6020 -----------------------------------------------------------------------------------------------------------


def gm(mode: str, *, id: int, name: str = "") -> MotorSpec:
    return spec(f"gm6020 {mode}", id=id, name=name)


def test_every_id_and_mode_has_its_command_frame_its_slot_and_its_answer() -> None:
    for mode, kind, first, second in (
        ("voltage", CommandKind.VOLTAGE, 0x1FF, 0x2FF),
        ("current", CommandKind.TORQUE, 0x1FE, 0x2FE),
    ):
        for id in range(1, 8):
            driver = DjiDriver(BUS, [gm(mode, id=id)])
            assert driver.receive_filters() == ((0x204 + id, 0x7FF, False),)
            assert driver.receive(CanFrame(BUS, 0x204 + id, bytes(8), received_ns=0))
            (frame,) = driver.command([MotorCommand(kind, 1e9)], now_ns=0)
            slots = unpack(">4h", frame.data)
            assert (frame.id, [place for place, raw in enumerate(slots) if raw]) == (
                first if id <= 4 else second,
                [(id - 1) % 4],
            )


def test_a_volt_is_a_share_of_the_supply() -> None:
    for supply, raw in ((24.0, 12500), (20, 15000), (28.0, 10714)):
        motor = gm("voltage", id=1)._replace(supply=supply, max_speed=25.0)
        driver = DjiDriver(BUS, [motor])
        driver.receive(CanFrame(BUS, 0x205, bytes(8), received_ns=0))
        (frame,) = driver.command([MotorCommand(CommandKind.VOLTAGE, 12.0)], now_ns=1)
        assert frame.data == pack(">4h", raw, 0, 0, 0)


def test_without_a_voltage_its_windings_brake_so_that_is_what_stops_and_releases_it() -> None:
    driver = DjiDriver(BUS, [gm("voltage", id=3)])
    driver.receive(CanFrame(BUS, 0x207, pack(">HhhBx", 0, 300, 0, 30), received_ns=0))
    assert driver.capabilities == (Capabilities(voltage=True, brake=True, coast=False, speed_step=pi / 30),)
    for command, state in ((BRAKE, MotorState.OPERATIONAL), (COAST, MotorState.IDLE)):
        assert driver.command([command], now_ns=0) == [CanFrame(BUS, 0x1FF, bytes(8))]
        assert driver.feedback(now_ns=0)[0].state is state
    assert driver.stop_frames(now_ns=0) == driver.coast_frames() == [CanFrame(BUS, 0x1FF, bytes(8))]


def test_in_current_mode_a_stop_frame_brakes_against_the_speed() -> None:
    """A quarter of 100 rad/s are 239 rpm, of which 100 brake with 42 % of what 2 N m need: raw 14741."""
    driver = DjiDriver(BUS, [gm("current", id=2)])
    driver.receive(CanFrame(BUS, 0x206, pack(">HhhBx", 0, 100, 0, 30), received_ns=0))
    assert driver.capabilities == (Capabilities(torque=True, speed_step=pi / 30),)
    (frame,) = driver.stop_frames(now_ns=0)
    assert (frame.id, unpack(">4h", frame.data)) == (0x1FE, (0, -6174, 0, 0))
    with pytest.raises(ValueError, match=r"motor_2: .*BRAKE.*: must be a torque in N m alone, or coast"):
        driver.command([BRAKE], now_ns=0)


def test_turns_of_its_one_shaft_are_counted_from_its_absolute_angle() -> None:
    driver = DjiDriver(BUS, [gm("voltage", id=1)])
    for index in range(1000):
        data = pack(">HhhBx", (6000 + 43 * index) % 8192, 315, 0, 30)
        driver.receive(CanFrame(BUS, 0x205, data, received_ns=index * MS))
    assert position_ticks(driver) == 6000 + 43 * 999
    anew = DjiDriver(BUS, [gm("voltage", id=1)])
    anew.receive(CanFrame(BUS, 0x205, pack(">HhhBx", (6000 + 43 * 999) % 8192, 0, 0, 30), received_ns=0))
    assert position_ticks(anew) == (6000 + 43 * 999) % 8192


@pytest.mark.parametrize(
    ("gimbal", "wheel"), [(("voltage", 1), ("c620", 5)), (("voltage", 4), ("c610", 8)), (("current", 2), ("c620", 6))]
)
def test_a_gm6020_that_answers_as_another_is_refused_in_words(gimbal: tuple[str, int], wheel: tuple[str, int]) -> None:
    mode, id = gimbal
    variant, other = wheel
    motors = [gm(mode, id=id, name="yaw"), spec(variant, id=other, name="wheel")]
    words = (
        rf"motor wheel: id = {other}: a {variant} of this id answers as 0x{0x204 + id:X}, and so does motor yaw, "
        rf"a gm6020 of id {id}: give one of them another id, or another bus"
    )
    with pytest.raises(ValueError, match=words):
        DjiDriver(BUS, motors)
    with pytest.raises(ValueError, match=rf"motor yaw: id = {id}: a gm6020 .*, and so does motor wheel, a {variant}"):
        DjiDriver(BUS, motors[::-1])


def test_controllers_of_every_kind_share_a_bus_where_no_two_answer_alike() -> None:
    """A GM6020 in voltage mode and a C620 even share a frame, of which each has slots of its own."""
    motors = [
        *(spec("c620", id=1, name="a"), spec("c610", id=6, name="b"), gm("voltage", id=1, name="c")),
        *(gm("current", id=3, name="d"), gm("voltage", id=6, name="e"), gm("current", id=7, name="f")),
    ]
    driver = DjiDriver(BUS, motors)
    for at in (0x201, 0x206, 0x205, 0x207, 0x20A, 0x20B):
        assert driver.receive(CanFrame(BUS, at, bytes(8), received_ns=0))
    torques, volts = (0.3 * 187 / 3591, 0.005, 0.741), MotorCommand(CommandKind.VOLTAGE, 2.4)
    one, two, three = [MotorCommand(CommandKind.TORQUE, torque) for torque in torques]
    commands = [one, two, volts, three, volts, three]
    frames = driver.command(commands, now_ns=1)
    assert [can_text(frame) for frame in frames] == [
        "200#0333000000000000",
        "1FF#09C403E800000000",
        "2FF#000009C400000000",
        "1FE#0000000015550000",
        "2FE#0000000015550000",
    ]
    words = [driver.decode(frame) for frame in frames]
    assert [word.owners for word in words if word is not None] == [
        *(("a", None, None, None), ("c", "b", None, None), (None, "e", None, None)),
        *((None, None, "d", None), (None, None, "f", None)),
    ]
    shared = words[1]
    assert shared is not None
    assert [name for name, _ in shared.fields] == ["voltage_raw_1", "current_raw_6", "current_raw_7", "current_raw_8"]
    assert driver.ids()[1] == ("dji command of motor c, b", 0x1FF, 0x7FF, False)


def test_what_it_has_to_be_told() -> None:
    def made(**options: OptionValue) -> DjiDriver:
        return DjiDriver(BUS, [gm("voltage", id=1)._replace(options=options)])

    made(mode="voltage")
    made(mode="current")
    DjiDriver(BUS, [gm("current", id=1)._replace(supply=None)])
    for options, words in (
        ({}, r"motor_1: options.mode is missing: must be 'current' or 'voltage', as it is set in DJI's tool"),
        ({"mode": "speed"}, r"motor_1: options.mode = 'speed': must be 'current' or 'voltage'"),
        ({"mode": "current", "supply": 24.0}, r"options.supply = 24.0: no such option; a gm6020 has mode$"),
    ):
        with pytest.raises(ValueError, match=words):
            made(**options)
    for supply, words in (
        (
            None,
            r"motor_1: winding is missing: a gm6020 in voltage mode gives a share of its supply, which is winding.v",
        ),
        (48.0, r"motor_1: winding.voltage = 48: must be 18 to 28 V: a gm6020 in voltage mode gives a share"),
        (nan, r"motor_1: winding.voltage = nan: must be"),
    ):
        with pytest.raises(ValueError, match=words):
            DjiDriver(BUS, [gm("voltage", id=1)._replace(supply=supply)])


def test_no_motor_turns_faster_than_its_supply_lets_it() -> None:
    motor = gm("voltage", id=1)
    DjiDriver(BUS, [motor._replace(max_speed=33.5)])
    words = r"motor_1: max_speed = 33.6: must be 0 to 33.5019 rad/s: a gm6020 turns 13.33 rpm per volt .*voltage = 24"
    with pytest.raises(ValueError, match=words):
        DjiDriver(BUS, [motor._replace(max_speed=33.6)])

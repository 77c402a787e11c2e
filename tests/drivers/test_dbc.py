"""Our layouts against an independent reader: cantools with the vendor's DBC files, and a small DBC of DJI."""

from math import isclose, isnan, pi
from pathlib import Path

import odrive_can
import pytest
from cantools.database import load_file, load_string
from cantools.database.can import Database, Message
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.contract import CanFrame
from drivers.dji import DjiDriver
from drivers.odrive.firmware import (
    CONTROLLER_ERRORS_05,
    ENCODER_ERRORS_05,
    ERRORS_05,
    ERRORS_06,
    FIRMWARES,
    MOTOR_ERRORS_05,
    PROCEDURE_RESULTS_06,
    Bit,
)
from drivers.odrive.group import OdriveDriver
from drivers.setpoint import CommandKind, MotorCommand
from drivers.vesc import SETPOINTS, STATUSES, VescDriver
from tests.drivers.rig import BUS, MS, Bench, FakeOdrive, spec


def database(text: str | Path) -> Database:
    """A DBC from its file or text."""
    loaded = load_file(text) if isinstance(text, Path) else load_string(text, database_format="dbc")
    assert isinstance(loaded, Database)
    return loaded


FOLDER = Path(odrive_can.__file__).parent / "dbc"
DATABASES = {
    "0.5": database(FOLDER / "odrive-cansimple-0.5.6.dbc"),
    "0.6": database(FOLDER / "odrive-cansimple-0.6.10.dbc"),
}
# Of ids 5 to 8, of a GM6020 in each mode, and what one of its ids says: public drivers (taproot, OneMotor).
DJI_DBC = """VERSION ""
BS_:
BU_: HOST ESC
BO_ 512 Command: 8 HOST
 SG_ current_raw_1 : 7|16@0- (1,0) [0|0] "" ESC
 SG_ current_raw_2 : 23|16@0- (1,0) [0|0] "" ESC
 SG_ current_raw_3 : 39|16@0- (1,0) [0|0] "" ESC
 SG_ current_raw_4 : 55|16@0- (1,0) [0|0] "" ESC
BO_ 767 Voltage_5_to_7: 8 HOST
 SG_ voltage_raw_5 : 7|16@0- (0.00096,0) [0|0] "V" ESC
 SG_ voltage_raw_6 : 23|16@0- (0.00096,0) [0|0] "V" ESC
 SG_ voltage_raw_7 : 39|16@0- (0.00096,0) [0|0] "V" ESC
BO_ 510 Current_1_to_4: 8 HOST
 SG_ current_raw_1 : 7|16@0- (0.00018310546875,0) [0|0] "A" ESC
 SG_ current_raw_2 : 23|16@0- (0.00018310546875,0) [0|0] "A" ESC
 SG_ current_raw_3 : 39|16@0- (0.00018310546875,0) [0|0] "A" ESC
 SG_ current_raw_4 : 55|16@0- (0.00018310546875,0) [0|0] "A" ESC
BO_ 521 Feedback_5: 8 ESC
 SG_ position : 7|16@0+ (0.0439453125,0) [0|0] "deg" HOST
 SG_ speed : 23|16@0- (1,0) [0|0] "rpm" HOST
 SG_ current : 39|16@0- (0.00018310546875,0) [0|0] "A" HOST
 SG_ temperature : 55|8@0+ (1,0) [0|0] "degC" HOST
BO_ 513 Feedback: 8 ESC
 SG_ angle_ticks : 7|16@0+ (1,0) [0|0] "" HOST
 SG_ speed_rpm : 23|16@0- (1,0) [0|0] "rpm" HOST
 SG_ current_raw : 39|16@0- (1,0) [0|0] "" HOST
 SG_ temperature_c : 55|8@0+ (1,0) [0|0] "degC" HOST
"""
DJI_DATABASE = database(DJI_DBC)
# Of VESC 10: ids with bit 31, as a DBC tells extended ones; scales and units of documentation/comm_can.md.
VESC_DBC = """VERSION ""
BS_:
BU_: HOST VESC
BO_ 2147483658 SET_DUTY: 4 HOST
 SG_ duty : 7|32@0- (0.00001,0) [0|0] "" VESC
BO_ 2147483914 SET_CURRENT: 4 HOST
 SG_ current : 7|32@0- (0.001,0) [0|0] "A" VESC
BO_ 2147484170 SET_CURRENT_BRAKE: 4 HOST
 SG_ current : 7|32@0- (0.001,0) [0|0] "A" VESC
BO_ 2147484426 SET_RPM: 4 HOST
 SG_ erpm : 7|32@0- (1,0) [0|0] "rpm" VESC
BO_ 2147486218 SET_CURRENT_REL: 4 HOST
 SG_ share : 7|32@0- (0.00001,0) [0|0] "" VESC
BO_ 2147485962 STATUS: 8 VESC
 SG_ erpm : 7|32@0- (1,0) [0|0] "rpm" HOST
 SG_ current : 39|16@0- (0.1,0) [0|0] "A" HOST
 SG_ duty : 55|16@0- (0.001,0) [0|0] "" HOST
BO_ 2147487754 STATUS_4: 8 VESC
 SG_ t_fet : 7|16@0- (0.1,0) [0|0] "degC" HOST
 SG_ t_motor : 23|16@0- (0.1,0) [0|0] "degC" HOST
 SG_ i_in : 39|16@0- (0.1,0) [0|0] "A" HOST
 SG_ pid_pos : 55|16@0- (0.02,0) [0|0] "deg" HOST
BO_ 2147490570 STATUS_5: 8 VESC
 SG_ tacho : 7|32@0- (1,0) [0|0] "" HOST
 SG_ v_in : 39|16@0- (0.1,0) [0|0] "V" HOST
"""
VESC_DATABASE = database(VESC_DBC)

NODE = 3
IN_DBC = [
    pytest.param(variant, message, id=f"{variant} {message.name.partition('_')[2]}")
    for variant in DATABASES
    for message in DATABASES[variant].messages
    if message.name.startswith(f"Axis{NODE}_")
]


def numbers(message: Message, data: bytes) -> dict[str, float]:
    """What the DBC reads in a frame, choices as numbers."""
    values = message.decode(data, decode_choices=False)
    assert isinstance(values, dict)
    return {name: value for name, value in values.items() if isinstance(value, int | float)}


def choices(variant: str, message: str, signal: str) -> dict[int, str]:
    """The words that the DBC has for the values of a signal."""
    words = DATABASES[variant].get_message_by_name(f"Axis{NODE}_{message}").get_signal_by_name(signal).choices
    assert words is not None
    return {value: str(word) for value, word in words.items()}


def same(ours: float, theirs: float, bits: int) -> bool:
    """Integers are compared as bit patterns: the DBC of 0.5 halves Motor_Error and takes counts as unsigned."""
    if isinstance(ours, int) and isinstance(theirs, int):
        return (ours - theirs) % (1 << bits) == 0
    return isclose(ours, theirs, rel_tol=1e-12) or (isnan(ours) and isnan(theirs))


@pytest.mark.parametrize(("variant", "message"), IN_DBC)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_odrive_layouts(variant: str, message: Message, data: st.DataObject) -> None:
    payload = data.draw(st.binary(min_size=message.length, max_size=message.length))
    decoded = OdriveDriver(BUS, [spec(variant)]).decode(CanFrame(BUS, message.frame_id, payload))
    assert decoded is not None
    assert f"Axis{NODE}_{decoded.message}" == message.name
    theirs = numbers(message, payload)
    assert {name for name, _ in decoded.fields} == set(theirs)
    lengths = {signal.name: signal.length for signal in message.signals}
    assert all(same(value, theirs[name], lengths[name]) for name, value in decoded.fields)


@pytest.mark.parametrize("variant", DATABASES)
def test_no_message_is_missing_or_extra(variant: str) -> None:
    firmware = FIRMWARES[variant]
    ours = {message.name for message in (*firmware.to_device.values(), *firmware.from_device.values())}
    theirs = {param.values[1].name.partition("_")[2] for param in IN_DBC if param.values[0] == variant}  # type: ignore[union-attr]
    assert ours - theirs == ({"Estop"} if variant == "0.5" else set())
    assert theirs <= ours
    assert not set(firmware.to_device) & set(firmware.from_device)


@pytest.mark.parametrize("variant", DATABASES)
def test_what_bringup_sends_is_what_the_dbc_reads(variant: str) -> None:
    driver = OdriveDriver(BUS, [spec(variant)])
    stand = Bench(driver, [FakeOdrive(NODE, variant)])
    stand.run(MotorCommand(CommandKind.VELOCITY, -10.0 * pi), ms=500)
    stand.run(MotorCommand(CommandKind.TORQUE, 0.75), ms=500)
    read = [
        (message.name.partition("_")[2], numbers(message, frame.data))
        for _, frame in stand.sent
        if not frame.remote
        for message in [DATABASES[variant].get_message_by_frame_id(frame.id)]
    ]
    assert ("Set_Controller_Mode", {"Control_Mode": 2, "Input_Mode": 1}) in read
    assert ("Set_Controller_Mode", {"Control_Mode": 1, "Input_Mode": 1}) in read
    assert ("Set_Axis_State", {"Axis_Requested_State": 8}) in read
    assert ("Set_Axis_State", {"Axis_Requested_State": 1}) in read
    assert ("Set_Input_Vel", {"Input_Vel": -5.0, "Input_Torque_FF": 0.0}) in read
    assert ("Set_Input_Torque", {"Input_Torque": 0.75}) in read
    (limits, *_) = [values for name, values in read if name == "Set_Limits"]
    assert limits == pytest.approx({"Velocity_Limit": 100.0 / (2.0 * pi), "Current_Limit": 20.0})


@pytest.mark.parametrize("variant", DATABASES)
def test_what_the_dbc_writes_is_what_we_measure(variant: str) -> None:
    driver = OdriveDriver(BUS, [spec(variant)])

    def feed(name: str, **values: float) -> None:
        message = DATABASES[variant].get_message_by_name(f"Axis{NODE}_{name}")
        everything = {signal.name: 0 for signal in message.signals} | values
        assert driver.receive(CanFrame(BUS, message.frame_id, message.encode(everything), received_ns=5 * MS))

    feed("Heartbeat", Axis_State=1)
    feed("Get_Encoder_Estimates", Pos_Estimate=-10.5, Vel_Estimate=0.25)
    feed("Get_Bus_Voltage_Current", Bus_Voltage=47.5, Bus_Current=1.0)
    if variant == "0.6":
        feed("Get_Temperature", FET_Temperature=40.5, Motor_Temperature=61.0)
        feed("Get_Torques", Torque_Target=9.0, Torque_Estimate=-0.125)
    (feedback,) = driver.feedback(now_ns=7 * MS)
    assert feedback.position == pytest.approx(-21.0 * pi)
    assert feedback.velocity == pytest.approx(0.5 * pi)
    assert (feedback.voltage, feedback.age_ns) == (47.5, 2 * MS)
    expected = (-0.125, 61.0) if variant == "0.6" else (None, None)
    assert (feedback.torque, feedback.temperature_c) == expected


@pytest.mark.parametrize(
    ("variant", "message", "signal", "table"),
    [
        ("0.6", "Heartbeat", "Axis_Error", ERRORS_06),
        ("0.6", "Get_Error", "Disarm_Reason", ERRORS_06),
        ("0.5", "Heartbeat", "Axis_Error", ERRORS_05),
        ("0.5", "Get_Motor_Error", "Motor_Error", MOTOR_ERRORS_05),
        ("0.5", "Get_Encoder_Error", "Encoder_Error", ENCODER_ERRORS_05),
        ("0.5", "Get_Controller_Error", "Controller_Error", CONTROLLER_ERRORS_05),
    ],
)
def test_error_words(variant: str, message: str, signal: str, table: dict[int, Bit]) -> None:
    theirs = {mask: word for mask, word in choices(variant, message, signal).items() if mask}
    extra = {0x2_0000} if table is ERRORS_06 else {1 << 32, 1 << 33, 1 << 34} if table is ERRORS_05 else set()
    assert {mask: bit.word for mask, bit in table.items() if mask not in extra} == theirs


def test_procedure_results() -> None:
    theirs = choices("0.6", "Heartbeat", "Procedure_Result")
    assert theirs | {16: "REQUESTED_CURRENT_TOO_HIGH"} == PROCEDURE_RESULTS_06


@settings(max_examples=50, deadline=None)
@given(
    angle=st.integers(0, 8191),
    rpm=st.integers(-32768, 32767),
    current=st.integers(-32768, 32767),
    temperature=st.integers(0, 255),
)
def test_dji_feedback(angle: int, rpm: int, current: int, temperature: int) -> None:
    values = {"angle_ticks": angle, "speed_rpm": rpm, "current_raw": current, "temperature_c": temperature}
    data = DJI_DATABASE.encode_message("Feedback", values)
    driver = DjiDriver(BUS, [spec("c620", id=1)])
    frame = CanFrame(BUS, 0x201, data, received_ns=0)
    decoded = driver.decode(frame)
    assert decoded is not None
    assert dict(decoded.fields) == values
    assert driver.receive(frame)
    (feedback,) = driver.feedback(now_ns=0)
    assert feedback.position == pytest.approx(angle * 2 * pi / 8192)
    assert feedback.velocity == pytest.approx(rpm * 2 * pi / 60)
    assert feedback.torque == pytest.approx(current * 20 / 16384 * 0.3 * 187 / 3591)
    assert feedback.temperature_c == temperature


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-30.0, 30.0), min_size=4, max_size=4))
def test_dji_command(amperes: list[float]) -> None:
    driver = DjiDriver(BUS, [spec("c620", id=at) for at in range(1, 5)])
    for at in range(1, 5):
        driver.receive(CanFrame(BUS, 0x200 + at, bytes(8), received_ns=0))
    commands = [MotorCommand(CommandKind.TORQUE, ampere * 0.3 * 187 / 3591) for ampere in amperes]
    (frame,) = driver.command(commands, now_ns=1)
    raws = numbers(DJI_DATABASE.get_message_by_frame_id(frame.id), frame.data)
    for at, ampere in enumerate(amperes, 1):
        assert raws[f"current_raw_{at}"] == pytest.approx(max(-20.0, min(20.0, ampere)) * 16384 / 20, abs=0.51)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-30.0, 30.0), min_size=3, max_size=3))
def test_gm6020_voltage(volts: list[float]) -> None:
    driver = DjiDriver(BUS, [spec("gm6020 voltage", id=at) for at in (5, 6, 7)])
    for at in (5, 6, 7):
        driver.receive(CanFrame(BUS, 0x204 + at, bytes(8), received_ns=0))
    (frame,) = driver.command([MotorCommand(CommandKind.VOLTAGE, volt) for volt in volts], now_ns=1)
    read = numbers(DJI_DATABASE.get_message_by_frame_id(frame.id), frame.data)
    for at, volt in enumerate(volts, 5):
        assert read[f"voltage_raw_{at}"] == pytest.approx(max(-24.0, min(24.0, volt)), abs=0.00049)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-4.0, 4.0), min_size=4, max_size=4))
def test_gm6020_current(amperes: list[float]) -> None:
    driver = DjiDriver(BUS, [spec("gm6020 current", id=at)._replace(max_torque=2.3) for at in range(1, 5)])
    for at in range(1, 5):
        driver.receive(CanFrame(BUS, 0x204 + at, bytes(8), received_ns=0))
    commands = [MotorCommand(CommandKind.TORQUE, ampere * 0.741) for ampere in amperes]
    (frame,) = driver.command(commands, now_ns=1)
    read = numbers(DJI_DATABASE.get_message_by_frame_id(frame.id), frame.data)
    for at, ampere in enumerate(amperes, 1):
        assert read[f"current_raw_{at}"] == pytest.approx(max(-3.0, min(3.0, ampere)), abs=0.0001)


@settings(max_examples=50, deadline=None)
@given(
    angle=st.integers(0, 8191),
    rpm=st.integers(-400, 400),
    current=st.integers(-16384, 16384),
    temperature=st.integers(0, 255),
)
def test_gm6020_feedback(angle: int, rpm: int, current: int, temperature: int) -> None:
    values = {"position": angle * 360 / 8192, "speed": rpm, "current": current * 3 / 16384, "temperature": temperature}
    frame = CanFrame(BUS, 0x209, DJI_DATABASE.encode_message("Feedback_5", values), received_ns=0)
    for mode, torque in (("current", pytest.approx(current * 3 / 16384 * 0.741)), ("voltage", None)):
        driver = DjiDriver(BUS, [spec(f"gm6020 {mode}", id=5)])
        assert driver.receive(frame)
        (feedback,) = driver.feedback(now_ns=0)
        assert feedback.position == pytest.approx(angle * 2 * pi / 8192)
        assert feedback.velocity == pytest.approx(rpm * 2 * pi / 60)
        assert (feedback.torque, feedback.voltage, feedback.temperature_c) == (torque, None, temperature)


def vesc_driver() -> VescDriver:
    return VescDriver(BUS, [spec("vesc", id=10)])


@pytest.mark.parametrize("message", VESC_DATABASE.messages, ids=lambda message: message.name)
@settings(max_examples=50, deadline=None)
@given(data=st.data())
def test_vesc_layouts(message: Message, data: st.DataObject) -> None:
    assert message.is_extended_frame
    payload = data.draw(st.binary(min_size=message.length, max_size=message.length))
    decoded = vesc_driver().decode(CanFrame(BUS, message.frame_id, payload, extended=True))
    assert decoded is not None
    assert decoded.message == message.name
    assert dict(decoded.fields) == pytest.approx(numbers(message, payload))


def test_no_message_of_a_vesc_is_missing_or_extra() -> None:
    ours = {
        command << 8 | 10: (message.name, message.layout.size) for command, message in (SETPOINTS | STATUSES).items()
    }
    assert ours == {message.frame_id: (message.name, message.length) for message in VESC_DATABASE.messages}


@pytest.mark.parametrize(
    ("kind", "limit", "name", "scale"),  # 7 pole pairs, 2 N m at 20 A, 24 V
    [
        (CommandKind.VELOCITY, 100.0, "erpm", 7 * 30 / pi),
        (CommandKind.TORQUE, 2.0, "current", 10.0),
        (CommandKind.VOLTAGE, 24.0, "duty", 1 / 24),
    ],
)
@settings(max_examples=50, deadline=None)
@given(share=st.floats(-1.5, 1.5))
def test_what_a_vesc_is_told_is_what_the_dbc_reads(
    kind: CommandKind, limit: float, name: str, scale: float, share: float
) -> None:
    driver = vesc_driver()
    for status, values in (("STATUS", {"erpm": 0, "current": 0, "duty": 0}), ("STATUS_5", {"tacho": 0, "v_in": 24.0})):
        message = VESC_DATABASE.get_message_by_name(status)
        driver.receive(CanFrame(BUS, message.frame_id, message.encode(values), extended=True, received_ns=0))
    driver.receive(CanFrame(BUS, 0x88A, bytes.fromhex("0A01320000800000"), extended=True, received_ns=0))
    _, frame = driver.command([MotorCommand(kind, share * limit)], now_ns=1)
    message = VESC_DATABASE.get_message_by_frame_id(frame.id, force_extended_id=True)
    step = {"erpm": 1.0, "current": 1e-3, "duty": 1e-5}[name]
    wanted = max(-limit, min(limit, share * limit)) * scale
    if message.name == "SET_DUTY" and kind is CommandKind.VELOCITY:  # below the minimum of 20 ERPM
        assert numbers(message, frame.data) == {"duty": 0.0}
        assert abs(wanted) < 20.0
        return
    read = numbers(message, frame.data)[name]
    assert abs(wanted) - 1.001 * step <= abs(read) <= abs(wanted) + 1e-9


@settings(max_examples=50, deadline=None)
@given(
    erpm=st.integers(-100_000, 100_000),
    current=st.integers(-32768, 32767),
    tacho=st.integers(-(2**31), 2**31 - 1),
    v_in=st.integers(0, 1000),
    heat=st.tuples(st.integers(-400, 1500), st.integers(-400, 1500)),
)
def test_what_the_dbc_writes_is_what_a_vesc_measures(
    erpm: int, current: int, tacho: int, v_in: int, heat: tuple[int, int]
) -> None:
    driver = vesc_driver()
    for name, values in (
        ("STATUS", {"erpm": erpm, "current": current / 10, "duty": 0.5}),
        ("STATUS_4", {"t_fet": heat[0] / 10, "t_motor": heat[1] / 10, "i_in": 1.0, "pid_pos": 90.0}),
        ("STATUS_5", {"tacho": tacho, "v_in": v_in / 10}),
    ):
        message = VESC_DATABASE.get_message_by_name(name)
        assert driver.receive(CanFrame(BUS, message.frame_id, message.encode(values), extended=True, received_ns=0))
    (feedback,) = driver.feedback(now_ns=0)
    assert feedback.velocity == pytest.approx(erpm / 7 * 2 * pi / 60)
    assert feedback.position == pytest.approx(tacho / 42 * 2 * pi)
    assert feedback.torque == pytest.approx(current / 10 * 2.0 / 20.0)
    assert feedback.voltage == pytest.approx(v_in / 10)
    assert feedback.temperature_c == pytest.approx(max(heat) / 10)

"""Every line of tests/vectors: bytes <-> values."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from drivers.contract import MotorSpec
from drivers.dji import DjiDriver
from drivers.odrive.axis import Axis
from drivers.odrive.group import OdriveDriver
from drivers.setpoint import COAST, CommandKind, MotorCommand
from drivers.vesc import VescDriver
from tests.drivers.rig import BUS, can_frame, can_text, spec

VECTORS = Path(__file__).parent.parent / "vectors"


def load(name: str) -> list[dict[str, Any]]:
    """Vectors of one file."""
    vectors: list[dict[str, Any]] = tomllib.loads((VECTORS / f"{name}.toml").read_text(encoding="utf-8"))["vector"]
    return vectors


ODRIVE = [
    pytest.param(vector, variant, id=f"{vector['name']} ({variant})")
    for vector in load("odrive")
    for variant in vector["variants"]
]
DJI = [pytest.param(vector, id=vector["name"]) for vector in load("dji")]
DJI_COMMANDS = [pytest.param(vector, id=vector["name"]) for vector in load("dji") if {"amperes", "volts"} & set(vector)]
DJI_FEEDBACK = [pytest.param(vector, id=vector["name"]) for vector in load("dji") if "position" in vector]


@pytest.mark.parametrize(("vector", "variant"), ODRIVE)
def test_odrive_bytes_to_values(vector: dict[str, Any], variant: str) -> None:
    decoded = OdriveDriver(BUS, [spec(variant)]).decode(can_frame(vector["frame"]))
    assert decoded is not None
    assert (decoded.motor, decoded.message) == ("motor_3", vector["message"])
    assert list(dict(decoded.fields)) == list(vector["fields"])
    assert dict(decoded.fields) == pytest.approx(vector["fields"], rel=1e-7)


SENT = {"Set_Axis_State", "Set_Controller_Mode", "Set_Input_Vel", "Set_Input_Torque", "Set_Limits", "RxSdo"}
SENT |= {"Clear_Errors"}
ODRIVE_SENT = [
    param
    for param in ODRIVE
    if isinstance(param.values[0], dict) and param.values[0]["message"] in SENT and not param.values[0].get("short")
]


@pytest.mark.parametrize(("vector", "variant"), ODRIVE_SENT)
def test_odrive_values_to_bytes(vector: dict[str, Any], variant: str) -> None:
    frame = can_frame(vector["frame"])
    assert Axis(BUS, spec(variant)).frame(frame.id & 0x1F, *vector["fields"].values()) == frame


def test_every_message_that_bringup_sends_has_a_vector() -> None:
    assert {vector["message"] for vector in load("odrive")} >= SENT


NM_PER_A = {"c620": 0.3 * 187 / 3591, "c610": 0.18 / 36, "gm6020": 0.741}
FIRST_ANSWER = {"c620": 0x200, "c610": 0x200, "gm6020": 0x204}


def dji_spec(vector: dict[str, Any], motor: int) -> MotorSpec:
    """Of a motor of this vector."""
    variant, mode = vector["variant"], vector.get("mode")
    return spec(variant if mode is None else f"{variant} {mode}", id=motor)


def asked(vector: dict[str, Any]) -> dict[int, float]:
    """Amperes or volts by motor."""
    return {int(motor): value for motor, value in (vector.get("amperes") or vector.get("volts") or {}).items()}


@pytest.mark.parametrize("vector", DJI)
def test_dji_bytes_to_values(vector: dict[str, Any]) -> None:
    motor = vector.get("motor") or next(iter(asked(vector)))
    decoded = DjiDriver(BUS, [dji_spec(vector, motor)]).decode(can_frame(vector["frame"]))
    assert decoded is not None
    assert decoded.message == vector["message"]
    assert dict(decoded.fields) == vector["fields"]


@pytest.mark.parametrize("vector", DJI_COMMANDS)
def test_dji_values_to_bytes(vector: dict[str, Any]) -> None:
    values, variant = asked(vector), vector["variant"]
    # Those of a vector may ask for all that the controller can.
    driver = DjiDriver(BUS, [dji_spec(vector, motor)._replace(max_torque=2.3) for motor in values])
    for motor in values:
        assert driver.receive(can_frame(f"{FIRST_ANSWER[variant] + motor:03X}#0000000000000000", received_ns=0))
    kind, scale = (CommandKind.VOLTAGE, 1.0) if "volts" in vector else (CommandKind.TORQUE, NM_PER_A[variant])
    commands = [MotorCommand(kind, value * scale) for value in values.values()]
    assert [can_text(frame) for frame in driver.command(commands, now_ns=1)] == [vector["frame"]]


@pytest.mark.parametrize("vector", DJI_FEEDBACK)
def test_dji_feedback_in_si(vector: dict[str, Any]) -> None:
    driver = DjiDriver(BUS, [dji_spec(vector, vector["motor"])])
    driver.command([COAST], now_ns=0)
    assert driver.receive(can_frame(vector["frame"], received_ns=0))
    (feedback,) = driver.feedback(now_ns=7)
    assert feedback.position == pytest.approx(vector["position"], rel=1e-9)
    assert feedback.velocity == pytest.approx(vector["velocity"], rel=1e-9)
    torque = vector.get("torque")  # None where the controller does not say in what it counts
    assert feedback.torque == (None if torque is None else pytest.approx(torque, rel=1e-4))
    assert feedback.temperature_c == vector.get("temperature_c")
    assert (feedback.voltage, feedback.age_ns) == (None, 7)


VESC = [pytest.param(vector, id=vector["name"]) for vector in load("vesc")]
VESC_COMMANDS = [pytest.param(vector, id=vector["name"]) for vector in load("vesc") if "command" in vector]
VESC_SAID = [pytest.param(vector, id=vector["name"]) for vector in load("vesc") if "command" not in vector]


def vesc(motor: int) -> VescDriver:
    """The driver of the motor that the vectors are of."""
    return VescDriver(BUS, [spec("vesc", id=motor)._replace(max_current=100.0)])


@pytest.mark.parametrize("vector", VESC)
def test_vesc_bytes_to_values(vector: dict[str, Any]) -> None:
    decoded = vesc(vector["motor"]).decode(can_frame(vector["frame"]))
    assert decoded is not None
    assert (decoded.motor, decoded.message) == (f"motor_{vector['motor']}", vector["message"])
    assert list(dict(decoded.fields)) == list(vector["fields"])
    assert dict(decoded.fields) == pytest.approx(vector["fields"], rel=1e-12)


@pytest.mark.parametrize("vector", VESC_COMMANDS)
def test_vesc_values_to_bytes(vector: dict[str, Any]) -> None:
    at, command = vector["motor"], vector["command"]
    driver = vesc(at)
    for said in ("09{:02X}#0000000000000000", "1B{:02X}#0000000000F10000"):
        assert driver.receive(can_frame("0000" + said.format(at), received_ns=0))
    assert driver.receive(can_frame(f"000008{128 | at:02X}#{at:02X}01320000800000", received_ns=0))
    sent = driver.command([MotorCommand(CommandKind(command["kind"]), command["value"])], now_ns=1)
    assert [can_text(frame) for frame in sent] == [f"000008{at:02X}#{128 | at:02X}003200008000", vector["frame"]]


@pytest.mark.parametrize("vector", VESC_SAID)
def test_what_a_vesc_says_in_si(vector: dict[str, Any]) -> None:
    driver = vesc(vector["motor"])
    heard = driver.receive(can_frame(vector["frame"], received_ns=0))
    assert heard == (vector["message"] in {"STATUS", "STATUS_4", "STATUS_5", "GET_VALUES_SELECTIVE"})
    (feedback,) = driver.feedback(now_ns=7)
    for name in ("position", "velocity", "torque", "voltage", "temperature_c"):
        value = getattr(feedback, name)
        assert value is None if name not in vector else value == pytest.approx(vector[name], rel=1e-9)
    assert (feedback.fault.text if feedback.fault else None) == vector.get("fault")

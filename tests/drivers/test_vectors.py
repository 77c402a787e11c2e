"""Every line of tests/vectors: bytes <-> values."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from drivers.dji import VARIANTS, DjiDriver
from drivers.odrive.axis import Axis
from drivers.odrive.group import OdriveDriver
from drivers.setpoint import COAST, CommandKind, MotorCommand
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
DJI_COMMANDS = [pytest.param(vector, id=vector["name"]) for vector in load("dji") if "amperes" in vector]
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


@pytest.mark.parametrize("vector", DJI)
def test_dji_bytes_to_values(vector: dict[str, Any]) -> None:
    motor = vector.get("motor") or int(next(iter(vector["amperes"])))
    decoded = DjiDriver(BUS, [spec(vector["variant"], id=motor)]).decode(can_frame(vector["frame"]))
    assert decoded is not None
    assert decoded.message == vector["message"]
    assert dict(decoded.fields) == vector["fields"]


@pytest.mark.parametrize("vector", DJI_COMMANDS)
def test_dji_values_to_bytes(vector: dict[str, Any]) -> None:
    constant = VARIANTS[vector["variant"]].torque_constant
    amperes = {int(identifier): value for identifier, value in vector["amperes"].items()}
    driver = DjiDriver(BUS, [spec(vector["variant"], id=identifier) for identifier in amperes])
    for identifier in amperes:
        driver.receive(can_frame(f"{0x200 + identifier:03X}#0000000000000000", received_ns=0))
    commands = [MotorCommand(CommandKind.TORQUE, value * constant) for value in amperes.values()]
    assert [can_text(frame) for frame in driver.command(commands, now_ns=1)] == [vector["frame"]]


@pytest.mark.parametrize("vector", DJI_FEEDBACK)
def test_dji_feedback_in_si(vector: dict[str, Any]) -> None:
    driver = DjiDriver(BUS, [spec(vector["variant"], id=vector["motor"])])
    driver.command([COAST], now_ns=0)
    assert driver.receive(can_frame(vector["frame"], received_ns=0))
    (feedback,) = driver.feedback(now_ns=7)
    assert feedback.position == pytest.approx(vector["position"], rel=1e-9)
    assert feedback.velocity == pytest.approx(vector["velocity"], rel=1e-9)
    assert feedback.torque == pytest.approx(vector["torque"], rel=1e-4)
    assert feedback.temperature_c == vector.get("temperature_c")
    assert (feedback.voltage, feedback.age_ns) == (None, 7)

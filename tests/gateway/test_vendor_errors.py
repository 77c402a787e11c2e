"""Every error bit that a controller can tell, against the vendors' own listings; none of it comes from our tables."""

import tomllib
from collections.abc import Mapping
from pathlib import Path

import pytest

from drivers import vesc
from drivers.odrive import firmware
from drivers.odrive.firmware import Bit
from gateway.words import TABLES
from replay.sim.controllers import vesc as simulated_vesc
from replay.sim.controllers.odrive_tables import FIRMWARES as SIMULATED

LISTED = tomllib.loads((Path(__file__).parent.parent / "vectors" / "vendor_errors.toml").read_text(encoding="utf-8"))
OLD = LISTED["odrive_05"]
FLAGS = 0xFFFF_FFFF  # above it our own flags of the heartbeat of 0.5


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (firmware.ERRORS_06, LISTED["odrive_06"]),
        ({bit: word for bit, word in firmware.ERRORS_05.items() if bit <= FLAGS}, OLD["axis"]),
        (firmware.MOTOR_ERRORS_05, OLD["motor"]),
        (firmware.ENCODER_ERRORS_05, OLD["encoder"]),
        (firmware.CONTROLLER_ERRORS_05, OLD["controller"]),
    ],
    ids=["0.6", "0.5 axis", "0.5 motor", "0.5 encoder", "0.5 controller"],
)
def test_every_bit_of_an_odrive_has_the_vendors_number(ours: Mapping[int, Bit], theirs: Mapping[str, int]) -> None:
    assert {bit.word: number for number, bit in ours.items()} == theirs


def test_every_procedure_result_has_the_vendors_number() -> None:
    assert {word: number for number, word in firmware.PROCEDURE_RESULTS_06.items()} == LISTED["procedure_result"]


def test_every_fault_of_a_vesc_has_the_vendors_number() -> None:
    assert {word: number for number, word in enumerate(vesc.FAULTS)} == LISTED["vesc"]


def test_every_listed_word_is_explained() -> None:
    listed = [*LISTED["odrive_06"], *LISTED["procedure_result"], *(word for table in OLD.values() for word in table)]
    assert set(listed) <= set(TABLES["odrive"])
    assert set(LISTED["vesc"]) == set(TABLES["vesc"])


def test_the_simulated_controllers_tell_the_same_numbers() -> None:
    new, old = SIMULATED["0.6"], SIMULATED["0.5"]
    assert (new.watchdog_error, new.estop_error) == (
        LISTED["odrive_06"]["WATCHDOG_TIMER_EXPIRED"],
        LISTED["odrive_06"]["ESTOP_REQUESTED"],
    )
    assert (old.watchdog_error, old.estop_error, old.invalid_state_error) == (
        *(OLD["axis"]["WATCHDOG_TIMER_EXPIRED"], OLD["axis"]["ESTOP_REQUESTED"], OLD["axis"]["INVALID_STATE"]),
    )
    assert LISTED["vesc"]["UNDER_VOLTAGE"] == simulated_vesc.UNDER_VOLTAGE
    assert LISTED["vesc"]["OVER_TEMP_FET"] == simulated_vesc.OVER_TEMP_FET

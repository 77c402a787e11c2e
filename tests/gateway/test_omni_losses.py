"""A motor of omni4 that dies at full speed: a slice of `python -m tests.bench.losses omni4`, which drives all 128.

Each motor dies in each way, and each direction comes twice; the bounds are those of the bench.
"""

from typing import Any

import pytest

from gateway.config import parse
from gateway.types import Mode
from tests.omni_losses import BOUNDS, DIRECTIONS, WAYS, Death, Found, drive, missed
from tests.world import robot_text

OMNI4 = parse(robot_text("omni4"), "omni4")
MOTORS = OMNI4.robot.motor_names()
SLICE = [
    Death(DIRECTIONS[(2 * which + place) % 8], motor, way)
    for place, way in enumerate(WAYS)
    for which, motor in enumerate(MOTORS)
]


@pytest.mark.parametrize("death", SLICE, ids=lambda death: f"{death.way} {death.motor} {death.direction:g}")
def test_a_motor_that_dies_at_full_speed(death: Death) -> None:
    found = drive(OMNI4, death)
    assert missed(found, BOUNDS["omni4"][death.way]) == [], found


@pytest.mark.parametrize(("direction", "motor"), [(90.0, "rear_right"), (135.0, "front_left")])
def test_the_torque_of_a_motor_that_tells_none_is_what_its_voltage_was_meant_for(direction: float, motor: str) -> None:
    """GM6020 in voltage mode: the momentum is held against what each was asked for."""
    death = Death(direction, motor, "torque_lost")
    found = drive(parse(robot_text("omni4_gm6020"), "omni4_gm6020"), death)
    assert found.seconds is not None
    assert missed(found, BOUNDS["omni4_gm6020"][death.way]) == [], found


def test_every_direction_is_in_the_slice() -> None:
    assert {death.direction for death in SLICE} == set(DIRECTIONS)


GOOD = Found(SLICE[0], 0.05, Mode.DEGRADED, (SLICE[0].motor,), 1.0, 0.1, 0.05, 1.0, 0.97, True, 0.3)
BAD: list[dict[str, Any]] = [
    {"seconds": 0.06},
    {"seconds": None, "mode": Mode.DRIVE, "blamed": ()},
    {"mode": Mode.FAULT},
    {"blamed": ()},
    {"blamed": (*GOOD.blamed, "rear_right")},
    {"heading": 2.1},
    {"offset": 0.15},
    {"spin": 0.11},
    {"turned": 2.1},
    {"slowest": 0.94},
    {"step": 1.1},
    {"asked": False, "seconds": None, "mode": Mode.DRIVE, "blamed": GOOD.blamed},
]


@pytest.mark.parametrize("change", BAD, ids=str)
def test_each_bound_is_held(change: dict[str, Any]) -> None:
    bounds = BOUNDS["omni4"]["power_off"]
    assert missed(GOOD, bounds) == []
    assert missed(GOOD._replace(asked=False, seconds=None, mode=Mode.DRIVE, blamed=()), bounds) == []
    assert len(missed(GOOD._replace(**change), bounds)) == 1

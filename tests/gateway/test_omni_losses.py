"""A motor of omni4 that dies at full speed: a slice of `python -m tests.bench.losses omni4`, which drives all 128.

Each motor dies in each way, and each direction comes twice. Bounds are what the dead wheel can do:
- seen: silence counts from 50 ms on; a position that stands for three samples; a lost torque once its memory is full of
  it (0.2 s, as measured: at most 0.188 s);
- spin: at worst a frozen wheel is driven with all of 4.5 N m for 20 ms, 2.6 rad/s per rad/s of turning, 1.03 kg m^2:
  0.23 rad/s (measured 0.11); else 1.2 N m, twice a wheel's friction at full speed, that the speed loops of the other
  three (each 3.5 N m s/rad) hold against: 0.045 rad/s and their overshoot (measured 0.053);
- the turn that is left is not taken back, nobody measures it against the floor: 0.1 rad/s for 0.4 s, 2 degrees
  (measured 1.2), and 2 m/s for 2 s along it: 0.14 m (measured 0.076).
"""

import pytest

from gateway.config import parse
from gateway.types import Mode
from tests.omni_losses import DIRECTIONS, WAYS, Death, drive
from tests.world import robot_text

SEEN = {"power_off": 0.056, "cable_out": 0.056, "encoder_frozen": 0.02, "torque_lost": 0.25}  # s
SPIN = {"encoder_frozen": 0.23}  # rad/s
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
    assert found.mode is Mode.DEGRADED
    assert found.blamed == (death.motor,)
    assert found.seconds is not None
    assert found.seconds <= SEEN[death.way]
    assert found.step <= 1.0 + 1e-6
    assert found.spin <= SPIN.get(death.way, 0.1)
    assert found.heading <= 2.0
    assert found.turned <= 2.0
    assert found.offset <= 0.14
    assert found.slowest >= 0.95


def test_every_direction_is_in_the_slice() -> None:
    assert {death.direction for death in SLICE} == set(DIRECTIONS)

"""The laws over a slice of random drives; `python -m tests.bench.laws` drives as many as one likes."""

import pytest

from gateway.config import parse
from tests.random_drives import drive
from tests.world import NAMES, robot_text

WILD, KIND = range(4), range(100, 103)  # numbers of the drives


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("seed", "can_brake"), [(one, False) for one in WILD] + [(one, True) for one in KIND])
def test_no_random_drive_breaks_a_law(name: str, seed: int, can_brake: bool) -> None:
    found = drive(seed, parse(robot_text(name), name), can_brake=can_brake).violations
    assert {law: broken[0] for law, broken in found.items() if broken} == {}

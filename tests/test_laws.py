"""The laws over a slice of random drives; `python -m tests.bench.laws` drives as many as one likes."""

import pytest

from gateway.config import parse
from replay.inject.random_drives import drive
from tests.world import BUNDLED, NAMES, robot_text

WILD, KIND = range(4), range(100, 103)  # numbers of the drives


@pytest.mark.parametrize("name", BUNDLED)
@pytest.mark.parametrize(("seed", "can_brake"), [(one, False) for one in WILD] + [(one, True) for one in KIND])
def test_no_random_drive_breaks_a_law(name: str, seed: int, can_brake: bool) -> None:
    found = drive(seed, parse(robot_text(name), name), can_brake=can_brake).violations
    assert {law: broken[0] for law, broken in found.items() if broken} == {}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", range(4, 8))
def test_nor_does_one_of_a_robot_that_may_limp(name: str, seed: int) -> None:
    limp = '[degraded]\nmotor_lost = "limp"\nencoder_lost = "limp"\nspeed = 0.5\n\n[limits]'
    config = parse(robot_text(name).replace("[limits]", limp, 1), name)
    found = drive(seed, config, can_brake=False).violations
    assert {law: broken[0] for law, broken in found.items() if broken} == {}


@pytest.mark.parametrize("seed", range(8, 12))
def test_nor_does_one_that_is_kept_pulled_by_motors_with_limits(seed: int) -> None:
    text = robot_text("moby").replace("[robot.body]", "[robot.compensation]\nregion = 1.5\n\n[robot.body]", 1)
    limits = "motor_acceleration = { left = 60.0, right = 60.0, platform = 25.0 }\n\n[[bus]]"
    config = parse(text.replace("[[bus]]", limits, 1), "moby")
    found = drive(seed, config, can_brake=False).violations
    assert {law: broken[0] for law, broken in found.items() if broken} == {}


@pytest.mark.parametrize("form", ["arc", "closed"])
@pytest.mark.parametrize(("seed", "can_brake"), [(20, False), (21, False), (22, False), (120, True), (121, True)])
def test_nor_does_one_that_is_asked_for_regions(seed: int, can_brake: bool, form: str) -> None:
    section = f'[robot.compensation]\nregion = 1.5\n\n[robot.manoeuvre]\nform = "{form}"\nmax_footprint = 0.6\n\n'
    text = robot_text("moby").replace("[robot.body]", f"{section}[robot.body]", 1)
    limits = "motor_acceleration = { left = 60.0, right = 60.0, platform = 25.0 }\n\n[[bus]]"
    config = parse(text.replace("[[bus]]", limits, 1), "moby")
    found = drive(seed, config, can_brake=can_brake).violations
    assert {law: broken[0] for law, broken in found.items() if broken} == {}


@pytest.mark.parametrize("saturation", ["both", "translation", "rotation"])
@pytest.mark.parametrize(("seed", "can_brake"), [(30, False), (31, False), (130, True)])
def test_nor_does_one_whose_wheels_are_its_limit_whatever_is_kept(seed: int, can_brake: bool, saturation: str) -> None:
    """omni4 with wheels of 25 rad/s and 40 rad/s^2, where its limits of the body ask for more."""
    text = robot_text("omni4").replace('name = "omni4"', f'name = "omni4"\nsaturation = "{saturation}"', 1)
    wheels = ", ".join(f"{name} = 40.0" for name in ("front_left", "rear_left", "rear_right", "front_right"))
    text = text.replace(" = 45.0", " = 25.0").replace("\n[[bus]]", f"motor_acceleration = {{ {wheels} }}\n\n[[bus]]", 1)
    found = drive(seed, parse(text, "omni4"), can_brake=can_brake).violations
    assert {law: broken[0] for law, broken in found.items() if broken} == {}

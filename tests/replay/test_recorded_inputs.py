"""Samples and settings are recorded and replayed: without them the same software says something else."""

from pathlib import Path

import pytest

from gateway.types import Inputs, Request, RequestKind, Twist
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.gateway.test_sensors import all_of_them, with_sensors
from tests.recordings import write_drive
from tests.world import NAMES, World


@pytest.fixture(scope="module", params=NAMES)
def world(request: pytest.FixtureRequest) -> World:
    world = World(request.param, rate_hz=100.0, edit=with_sensors)
    world.start()
    velocity = world.config.limits.velocity
    for value in (0.5, 1.0, 9.0):
        asked = Request(RequestKind.SET, 1, world.now_ns, setting="speed_override", value=value)
        world.cycle(requests=[asked])
        world.run(0.5, Twist(velocity.vx, 0.0, 0.2), sensed=all_of_them)
    return world


def test_a_drive_with_samples_and_settings_is_identical(world: World, tmp_path: Path) -> None:
    session = open_session(write_drive(tmp_path, world))
    recorded = [inputs for inputs, _ in session.cycles()]
    assert recorded == [inputs for inputs, _ in world.records]
    assert sum(len(inputs.samples) for inputs in recorded) > 100
    assert verify(session).exit_code == 0


@pytest.mark.parametrize("left_out", ["samples", "requests"])
def test_what_is_left_out_is_missed(world: World, tmp_path: Path, left_out: str) -> None:
    poorer = World(world.config.robot.name, rate_hz=100.0, edit=with_sensors)
    poorer.records = [(without(inputs, left_out), outputs) for inputs, outputs in world.records]
    verdict = verify(open_session(write_drive(tmp_path, poorer)))
    assert verdict.exit_code == 1


def without(inputs: Inputs, what: str) -> Inputs:
    return inputs._replace(samples=()) if what == "samples" else inputs._replace(requests=())

"""Two drives of one course: what is told of their difference is what was driven differently."""

import json
from math import pi
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from gateway.cli.app import build
from gateway.types import ZERO_TWIST, Pose, Twist
from replay.compare.difference import asides, difference, line
from replay.compare.likeness import moments
from replay.drive.pieces import cut
from replay.sessions.reader import Session, open_session
from tests.recordings import write_drive
from tests.world import World

FORWARD = Twist(0.3, 0.0, 0.0)


def driven(directory: Path, *legs: tuple[float, Twist], name: str = "omni4", rate_hz: float = 100.0) -> Session:
    world = World(name, rate_hz=rate_hz)
    world.start()
    for seconds, twist in legs:
        world.run(seconds, twist)
    return open_session(write_drive(directory, world, batch=100, snapshots=True))


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return driven(tmp_path_factory.mktemp("s"), (3.0, FORWARD))


def asked(*arguments: object) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", "diff", *map(str, arguments)])


def test_a_drive_is_like_itself(reference: Session) -> None:
    found = difference(reference, open_session(reference.path))
    assert found.likeness.reasons == ()
    assert (found.likeness.largest_m, found.aside_m) == (0.0, 0.0)
    assert all(wheel.rms == wheel.largest == 0.0 for wheel in found.wheels)
    assert found.others == ()


def test_later_on_the_same_line_is_apart_and_not_aside(reference: Session, tmp_path: Path) -> None:
    found = difference(reference, driven(tmp_path, (1.0, ZERO_TWIST), (3.0, FORWARD)))
    assert found.likeness.largest_m == pytest.approx(0.3, abs=0.05)
    assert found.aside_m < 0.01
    assert found.likeness.reasons


def test_aside_is_told_and_when_they_were_furthest_apart(reference: Session, tmp_path: Path) -> None:
    found = difference(reference, driven(tmp_path, (2.0, FORWARD), (1.0, Twist(0.3, 0.2, 0.0))))
    assert found.aside_m == pytest.approx(0.2, abs=0.06)
    assert found.likeness.largest_m >= found.aside_m >= found.aside_rms_m > 0.0
    assert found.largest_t == pytest.approx(found.seconds, abs=0.5)
    apart = [wheel.rms for wheel in found.wheels if wheel.rms is not None]
    assert len(apart) == 4
    assert min(apart) > 0.01


def test_what_else_was_another_is_told(reference: Session, tmp_path: Path) -> None:
    found = difference(reference, driven(tmp_path, (3.0, FORWARD), rate_hz=125.0))
    assert found.others == ("the robot file",)
    assert found.likeness.reasons == ()


def test_a_piece_has_a_beginning_of_its_own(reference: Session, tmp_path: Path) -> None:
    piece = cut(reference, tmp_path, begin=2.1)
    found = moments(open_session(piece.session))
    whole = moments(reference)
    assert piece.first_cycle > 0
    assert [moment.pose for moment in found] == [moment.pose for moment in whole[-len(found) :]]
    assert len(found) > 100


def test_what_cannot_be_compared(reference: Session, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="different robots: omni4 and moby"):
        difference(reference, driven(tmp_path / "a", (0.1, FORWARD), name="moby"))
    world = World("omni4", rate_hz=100.0)
    for _ in range(10):
        world.cycle()
    with pytest.raises(ValueError, match="nothing was commanded"):
        difference(reference, open_session(write_drive(tmp_path / "b", world)))


def test_the_distance_from_a_line_against_a_search_of_many_points() -> None:
    rng = np.random.default_rng(3)
    corners = rng.uniform(-1.0, 1.0, (7, 2))
    fine = np.concatenate([a + np.linspace(0.0, 1.0, 4001)[:, None] * (b - a) for a, b in zip(corners, corners[1:])])  # noqa: B905, RUF007
    places = rng.uniform(-1.5, 1.5, (700, 2))
    expected = np.array([np.sqrt(np.min(np.sum((fine - place) ** 2, axis=1))) for place in places])
    assert np.abs(asides(places, corners) - expected).max() < 1e-3
    assert asides(places, np.array([[0.0, 0.0], [0.0, 0.0]])) == pytest.approx(np.hypot(*places.T))


def test_a_line_leaves_out_what_stands() -> None:
    poses = [Pose(0.0, 0.0, 0.0)] * 100 + [Pose(n * 0.01, 0.0, pi) for n in range(5)]
    assert len(line(poses)) == 6


def test_the_command(reference: Session, tmp_path: Path) -> None:
    result = asked(reference.path, reference.path, "--json")
    told = json.loads(result.stdout.splitlines()[-1])
    assert result.exit_code == 0
    assert told["likeness"]["similar"]
    assert told["complete"]
    other = driven(tmp_path, (3.0, Twist(0.3, 0.2, 0.0)))
    assert asked(reference.path, other.path).exit_code == 1
    assert asked(reference.path, tmp_path / "nothing", "--json").exit_code == 2

"""When two drives are alike, and what a re-drive refuses; the drive itself needs a CAN kernel (tests/vm)."""

from pathlib import Path

import msgspec
import pytest

from gateway.config import load, parse
from gateway.types import ZERO_TWIST, Mode, Twist
from replay.compare.likeness import Comparison, Moment, compare, moments
from replay.drive.closed_loop import ClosedLoop
from replay.drive.recorded_drive import RedriveError, plant_told
from replay.drive.recording import SessionRecording
from replay.drive.redrive import as_toml, redrive
from replay.sessions.reader import Session, open_session
from replay.sim.plants.contract import PlantName
from tests.recordings import write_drive
from tests.world import NAMES, ROBOTS, World


def drive(directory: Path, vx: float, *, seconds: float = 1.5, waiting: float = 0.0) -> Session:
    """A drive in the simulated world, recorded; the robot waited before the first command."""
    world = World("moby")
    world.run(0.3 + waiting)
    world.run(3.0, ZERO_TWIST, until=lambda outputs: outputs.mode is Mode.DRIVE)
    world.run(seconds, Twist(vx, 0.0, 0.0))
    world.run(1.5, ZERO_TWIST)
    world.run(0.5)
    return open_session(write_drive(directory, world))


def comparison(first: list[Moment], second: list[Moment]) -> Comparison:
    return compare(first, second, load(ROBOTS / "moby.toml")[0], "second")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> list[Moment]:
    return moments(drive(tmp_path_factory.mktemp("first"), 0.3))


def test_the_same_drive_at_another_time_is_alike(recorded: list[Moment], tmp_path: Path) -> None:
    found = comparison(recorded, moments(drive(tmp_path, 0.3, waiting=0.5)))
    assert found.reasons == ()
    assert found.path_m > 0.3
    assert found.end_m < 0.005
    assert found.modes_recorded == ("starting", "drive", "stopping", "idle")
    assert found.as_json()["similar"] is True


def test_a_faster_drive_is_different_and_says_how(recorded: list[Moment], tmp_path: Path) -> None:
    found = comparison(recorded, moments(drive(tmp_path, 0.45)))
    assert found.end_m > 0.15
    assert found.reasons[0] == f"the ends lie apart: {found.end_m:.3f} m, allowed {0.05 + 0.02 * found.path_m:.3f}"
    assert any("wheel speeds" in reason for reason in found.reasons)


def test_another_sequence_of_modes_is_different(recorded: list[Moment]) -> None:
    stopped = [moment._replace(mode=Mode.ESTOP) if moment.mode is Mode.STOPPING else moment for moment in recorded]
    (reason,) = comparison(recorded, stopped).reasons
    assert reason.startswith("modes: ")


def test_a_recording_that_was_cut_is_compared_as_far_as_it_goes(recorded: list[Moment]) -> None:
    assert comparison(recorded[: len(recorded) // 2], recorded).reasons == ()


def test_no_commands_no_comparison() -> None:
    with pytest.raises(ValueError, match="no commands"):
        comparison([], [])


@pytest.mark.parametrize("name", NAMES)
def test_a_robot_file_survives_being_written(name: str) -> None:
    config, _ = load(ROBOTS / f"{name}.toml")
    assert parse(as_toml(config), "copy") == config


@pytest.mark.parametrize("plant", [*PlantName, None])
def test_the_plant_of_the_session_is_taken_again(plant: PlantName | None, tmp_path: Path) -> None:
    config, text = load(ROBOTS / "moby.toml")
    recording = SessionRecording(config, text, "moby", directory=tmp_path, started_wall_ns=1, plant=plant)
    loop = ClosedLoop(config)
    recording.put(*loop.cycle(), loop.engine.snapshot)
    recording.close()
    session = open_session(recording.session)
    assert session.header.plant == (None if plant is None else plant.value)
    assert plant_told(session) is (plant or PlantName.SIMPLE)


def test_a_plant_that_is_not_known_is_refused(tmp_path: Path) -> None:
    session = drive(tmp_path, 0.1, seconds=0.1)
    session.header = msgspec.structs.replace(session.header, plant="wood")
    with pytest.raises(RedriveError, match="plant 'wood', which is not known here"):
        plant_told(session)


def test_a_simulated_robot_is_never_put_on_a_bus_of_motors(tmp_path: Path) -> None:
    session = drive(tmp_path, 0.1, seconds=0.1)
    for channel, words in (("can0", "may lead to motors"), ("vcan77", "no CAN interface vcan77")):
        with pytest.raises(RedriveError, match=words):
            redrive(session, channels=[channel], out=tmp_path, tick_ms=1)

"""What if, in closed loop: what is predicted from a drive on MuJoCo's plant, and what then really happens on it."""

import json
from collections.abc import Mapping, Sequence
from math import dist
from pathlib import Path
from typing import NamedTuple

import msgspec
import pytest
from rerun.chunk import RrdReader
from typer.testing import CliRunner, Result

from gateway.cli.app import build
from gateway.config import parse
from gateway.types import Outputs, RequestKind, Twist
from replay.compare.what_if import WhatIfError
from replay.identify.closed import ClosedLoopWhatIf, Sides
from replay.identify.identify import identify
from replay.identify.parameters import ParameterFile, Refused, values_of
from replay.sessions.reader import SessionError, open_session
from replay.sim.plants.contract import PlantName
from tests.recordings import write_drive
from tests.replay import mujoco_plant
from tests.replay.identified_drives import (
    MASS,
    SLACK,
    STIFF,
    Driven,
    Twists,
    drive,
    heavy_omni,
    pulled_twists,
    random_twists,
    text_of,
)
from tests.world import ROBOTS, World


class Answered(NamedTuple):
    """A drive on MuJoCo's plant, what was predicted of a change, and the drive with it."""

    then: Driven
    question: ClosedLoopWhatIf
    steps: list[Sides]
    truly: Driven

    def true_effect(self) -> float:
        """m between the two drives at their ends, as the core said."""
        return apart(self.then.cycles[-1][1], self.truly.cycles[-1][1])

    def off(self) -> list[float]:
        """m of the prediction from where it then was, in every cycle."""
        return [apart(step.changed, true) for step, (_, true) in zip(self.steps, self.truly.cycles, strict=False)]


@pytest.fixture(scope="module")
def pulled(tmp_path_factory: pytest.TempPathFactory) -> Answered:
    """moby, pulled, with another gain of its compensation."""
    folder, setting = tmp_path_factory.mktemp("pulled"), {"compensation_gain": 1.2}
    text, twists = text_of("moby"), pulled_twists(3)
    plant = mujoco_plant.offset_differential
    then = drive(folder / "then", text, twists, seconds=12.0, plant=plant)
    truly = drive(folder / "truly", text, twists, seconds=12.0, plant=plant, settings=setting)
    question = ClosedLoopWhatIf(open_session(then.path), identify(open_session(then.path)).file, setting)
    return Answered(then, question, list(question.steps()), truly)


def test_another_gain_is_predicted(pulled: Answered) -> None:
    """Measured: 0.36 m of change, predicted to 2 mm, and the recorded drive reproduced to 1 mm."""
    reproduced, effect = pulled.question.reproduced, pulled.question.effect
    assert reproduced.reasons == ()
    assert reproduced.largest_m < 0.02
    true = pulled.true_effect()
    assert true > 0.2, "there is something to predict"
    assert effect.end_m == pytest.approx(true, abs=0.03 * true + 0.005)
    assert max(pulled.off()) < 0.02
    assert len(pulled.steps) == len(pulled.then.cycles)


def test_the_recorded_side_is_the_recording(pulled: Answered) -> None:
    for step, (inputs, outputs) in zip(pulled.steps[::100], pulled.then.cycles[::100], strict=True):
        assert step.cycle == inputs.cycle
        assert step.recorded.trace == outputs.trace


def test_a_robot_heavier_than_its_file_is_predicted_with_what_was_identified(tmp_path: Path) -> None:
    """A slack speed loop, with which mass shows. Measured: 0.505 m of change predicted, 0.508 true; 0.061 by its file.

    The wheel speeds of the changed drive are predicted to 0.018 rad/s rms; by the file's mass to 1.05.
    """
    text, twists = text_of("omni4"), random_twists(4)
    assert text.count(STIFF) == 4
    slack = text.replace(STIFF, SLACK)
    then = drive(tmp_path / "then", text, twists, seconds=6.0, plant=heavy_omni)
    truly = drive(tmp_path / "truly", slack, twists, seconds=6.0, plant=heavy_omni)
    found = identify(open_session(then.path)).file
    assert found.values["mass"] == pytest.approx(MASS, rel=0.02)
    other = parse(slack, "slack")
    of_file = _file(values_of(then.config.robot))
    questions = [ClosedLoopWhatIf(open_session(then.path), one, {}, other) for one in (found, of_file)]
    known, unknown = (_off_wheels(list(one.steps()), truly) for one in questions)
    assert known < 0.1 * unknown
    assert unknown > 0.5, "rad/s: it matters"
    true = apart(then.cycles[-1][1], truly.cycles[-1][1])
    by_drive, by_file = (one.effect.end_m for one in questions)
    assert by_drive == pytest.approx(true, rel=0.03)
    assert abs(by_file - true) > 0.5 * true


def test_a_drive_that_is_not_reproduced_is_not_to_be_trusted(pulled: Answered, tmp_path: Path) -> None:
    """With a mass that its motors cannot drive like that."""
    file = tmp_path / "wrong.json"
    values = values_of(pulled.then.config.robot) | {"mass": 1500.0}
    file.write_text(_json(_file(values, kind="offset_differential")))
    done = run(pulled.then.path, "--closed", "--parameters", file, "--set", "compensation.gain=1.2")
    assert done.exit_code == 1
    words = " ".join(done.output.split())
    assert "not to be trusted" in words
    assert "the paths are apart" in words or "the ends lie apart" in words


def test_what_another_robot_file_changes_is_changed(omni: Driven) -> None:
    """Its mass is that of the other file, the rest as identified."""
    lighter = parse(omni.text.replace("mass = 25.0", "mass = 20.0"), "lighter")
    known = _file(values_of(omni.config.robot) | {"mass": 26.0, "joint_drag": 0.3})
    question = ClosedLoopWhatIf(open_session(omni.path), known, {}, lighter)
    steps = list(question.steps())
    alone = ClosedLoopWhatIf(open_session(omni.path), _file(known.values | {"mass": 20.0}), {"speed_override": 1.0})
    assert [step.predicted.trace for step in alone.steps()] == [step.changed.trace for step in steps]


def test_a_setting_acts_from_its_time_on(omni: Driven) -> None:
    known = _file(values_of(omni.config.robot))
    question = ClosedLoopWhatIf(open_session(omni.path), known, {"speed.override": 0.3}, begin=2.5)
    steps = list(question.steps())
    differing = [step.t for step in steps if step.predicted.trace != step.changed.trace]
    assert min(differing) >= 2.5
    assert min(differing) < 2.6
    assert min(change.first_t for change in question.changes) == pytest.approx(min(differing), abs=0.005)


def test_the_command_tells_both_and_draws_all_three(omni: Driven, tmp_path: Path) -> None:
    out, file = tmp_path / "whatif.rrd", tmp_path / "parameters.json"
    file.write_text(_json(_file(values_of(omni.config.robot))))
    words = ("--closed", "--parameters", file, "--set", "speed_override=0.5")
    done = run(omni.path, *words, "--out", out)
    assert done.exit_code == 0
    assert "closed loop" in done.stdout
    told = json.loads(run(omni.path, *words, "--json").stdout)
    assert list(told) == [
        *("changes", "cycles", "reproduced", "effect", "parameters", "plant", "closed_loop", "sensed", "problem")
    ]
    assert told["reproduced"]["similar"] is True
    assert told["effect"]["largest_m"] > 0.02
    entities = {str(chunk.entity_path) for chunk in RrdReader(out).store().stream()}
    for side in ("recorded", "predicted", "changed"):
        assert f"/{side}/twist/setpoint" in entities


def test_without_a_file_it_is_identified_first(omni: Driven) -> None:
    told = json.loads(run(omni.path, "--closed", "--set", "speed_override=0.5", "--json").stdout)
    assert told["parameters"]["mass"] == pytest.approx(25.0, rel=0.01)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--closed",), "nothing to change"),
        (("--closed", "--set", "compensation.gain=1.5"), "must be one of speed_override"),
        (("--closed", "--robot-file", ROBOTS / "moby.toml"), "of a robot of kind offset_differential"),
        (("--set", "speed_override=0.5", "--plant", "simple"), "give --closed too"),
        (("--closed", "--set", "speed_override=0.5", "--parameters", "nowhere.json"), "nowhere.json"),
    ],
)
def test_the_command_refuses_in_words(omni: Driven, words: Sequence[object], said: str) -> None:
    done = run(omni.path, *words)
    assert done.exit_code == 2
    assert said in " ".join(done.output.split())
    assert "Traceback" not in done.output


def test_a_drive_that_the_end_of_the_service_stopped_is_reproduced(tmp_path: Path) -> None:
    """As by Ctrl-C: the robot is told to come to rest there too."""
    world = World("omni4", rate_hz=100.0)
    world.start()
    world.run(1.5, Twist(0.3, 0.1, 0.0))
    world.request(RequestKind.SHUTDOWN)
    world.run(1.5)
    folder = write_drive(tmp_path, world, batch=50, snapshots=True)
    known = _file(values_of(world.config.robot))
    question = ClosedLoopWhatIf(open_session(folder), known, {"acceleration_override": 0.5})
    assert list(question.steps())
    assert question.reproduced.reasons == ()
    assert question.reproduced.modes_redriven == ("starting", "drive", "stopping", "idle")


def test_a_session_without_its_beginning_is_refused(tmp_path: Path) -> None:
    world = World("moby", rate_hz=100.0)
    world.start()
    world.run(2.0, Twist(9.0, 0.1, 0.0))
    folder = write_drive(tmp_path, world, batch=50, snapshots=True, segment_bytes=60_000)
    sorted(folder.glob("segment-*.rrd"))[0].unlink()
    with pytest.raises(SessionError, match="its beginning was not recorded"):
        ClosedLoopWhatIf(open_session(folder), _file({}), {"speed_override": 0.5})


def test_a_refused_setting_is_told(omni: Driven) -> None:
    question = ClosedLoopWhatIf(open_session(omni.path), _file(values_of(omni.config.robot)), {"friction": 0.5})
    with pytest.raises(WhatIfError, match="must be one of"):
        list(question.steps())


@pytest.fixture(scope="module")
def omni(tmp_path_factory: pytest.TempPathFactory) -> Driven:
    folder = tmp_path_factory.mktemp("omni")
    twists: Twists = random_twists(5)
    return drive(folder, text_of("omni4"), twists, seconds=4.0, plant=PlantName.SIMPLE)


def run(session: Path, *words: object) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", "whatif", str(session), *map(str, words)])


def apart(one: Outputs, other: Outputs) -> float:
    """m."""
    return dist(one.trace.pose[:2], other.trace.pose[:2])


def _off_wheels(steps: Sequence[Sides], truly: Driven) -> float:
    """rad/s rms of the predicted wheel speeds."""
    offs = [
        (mine or 0.0) - (true or 0.0)
        for step, (_, outputs) in zip(steps, truly.cycles, strict=False)
        for mine, true in zip(step.changed.trace.wheel_speeds, outputs.trace.wheel_speeds, strict=True)
    ]
    return float((sum(off * off for off in offs) / len(offs)) ** 0.5)


def _file(values: Mapping[str, float], *, kind: str = "omni") -> ParameterFile:
    """Parameters that somebody gives."""
    given = {name: Refused(value, "given") for name, value in values.items()}
    return ParameterFile("robot", kind, "session", "simple", {}, given, {}, {}, 1.0, 1)


def _json(file: ParameterFile) -> str:
    return msgspec.json.encode(file).decode()

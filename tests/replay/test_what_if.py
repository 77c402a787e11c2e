"""What would have been commanded: the answers of a core that was really driven so, given the same inputs."""

import json
from collections.abc import Mapping
from math import sqrt
from pathlib import Path

import pytest
from rerun.chunk import RrdReader
from typer.testing import CliRunner, Result

from gateway.cli.app import build
from gateway.config import RobotConfig, parse
from gateway.core.engine import Engine
from gateway.types import Outputs, Request, RequestKind, Twist
from replay.compare.what_if import Change, WhatIf, WhatIfError
from replay.sessions.reader import open_session
from tests.recordings import write_drive
from tests.world import World

RATE = 100.0
BATCH = 50
FROM = 1.5


@pytest.fixture(scope="module")
def world() -> World:
    driven = World("moby", rate_hz=RATE)
    driven.start()
    driven.run(2.0, Twist(9.0, 0.1, 0.0))
    return driven


@pytest.fixture(scope="module")
def session(world: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("session"), world, batch=BATCH, snapshots=True)


def asked(session: Path, settings: Mapping[str, float], other: RobotConfig | None = None, begin: float = 0.0) -> WhatIf:
    question = WhatIf(open_session(session), settings, other, begin)
    for _ in question.steps():
        pass
    return question


def slower(world: World) -> RobotConfig:
    """The same robot with half of its acceleration."""
    old = world.config.limits.acceleration
    limits = world.config.limits.model_copy(update={"acceleration": old.model_copy(update={"vx": old.vx / 2.0})})
    return world.config.model_copy(update={"limits": limits})


def run(session: Path, *words: object) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", "whatif", str(session), *map(str, words)])


def by_hand(world: World, cycle: int, value: float) -> list[Outputs]:
    """A core of its own, asked for the setting in that cycle."""
    engine, answers = Engine(world.config), []
    for inputs, _ in world.records:
        ours = [Request(RequestKind.SET, 99, inputs.now_ns, setting="speed_override", value=value)]
        answers.append(engine.step(inputs._replace(requests=tuple(ours)) if inputs.cycle == cycle else inputs))
    return answers


def test_what_changes_when_and_how_much(world: World, session: Path) -> None:
    start = round(FROM * RATE)
    question = asked(session, {"speed_override": 0.2}, begin=FROM)
    answers = by_hand(world, start, 0.2)
    assert question.cycles == len(world.records) - start
    for place, motor in enumerate(world.config.robot.motor_names()):
        pairs = [
            (before.trace.wheel_setpoints[place], after.trace.wheel_setpoints[place])
            for (_, before), after in zip(world.records[start:], answers[start:], strict=True)
        ]
        sizes = [abs(one - other) for one, other in pairs if one is not None and other is not None]
        found = change_of(question, motor, "commanded")
        assert found.first_t == pytest.approx(FROM + next(n for n, size in enumerate(sizes) if size) / RATE)
        assert found.largest == max(sizes)
        assert found.rms == pytest.approx(sqrt(sum(size * size for size in sizes) / len(sizes)))
        assert found.cycles == sum(size > 0.0 for size in sizes)


def test_what_was_measured_is_what_was_measured(session: Path) -> None:
    question = asked(session, {"speed_override": 0.2})
    assert not [one for one in question.changes if one.channel in {"speed", "x", "y", "theta", "vx_measured"}]
    assert [one for one in question.changes if one.channel.startswith("Set_Input_Vel.") and one.motor]


def test_the_same_setting_changes_nothing(session: Path) -> None:
    assert asked(session, {"speed_override": 1.0}, begin=FROM).changes == []


def test_the_same_robot_file_changes_nothing(world: World, session: Path) -> None:
    question = asked(session, {}, parse(world.text, "the same"))
    assert question.changes == []
    assert question.cycles == len(world.records)
    assert "at the session's beginning" in question.began


@pytest.mark.parametrize("begin", [0.0, FROM])
def test_another_robot_file_begins_where_the_session_does(world: World, session: Path, begin: float) -> None:
    question = asked(session, {}, slower(world), begin)
    engine = Engine(slower(world))
    start = round(begin * RATE)
    pairs = [(before.trace.setpoint[0], engine.step(inputs).trace.setpoint[0]) for inputs, before in world.records]
    sizes = [abs(one - other) for one, other in pairs[start:]]
    found = change_of(question, None, "vx_limited")
    assert (question.cycles, found.cycles) == (len(sizes), sum(size > 0.0 for size in sizes))
    assert (found.cycles < question.cycles) is (begin == 0.0)
    assert found.largest == max(sizes)
    assert found.rms == pytest.approx(sqrt(sum(size * size for size in sizes) / len(sizes)))


def test_settings_and_a_robot_file_are_asked_for_together(world: World, session: Path) -> None:
    """The setting from its time on, and not before."""
    same = parse(world.text, "the same")
    both, alone = (asked(session, {"speed_override": 0.2}, other, FROM) for other in (same, None))
    assert both.changes == alone.changes
    assert (both.cycles, both.unseen) == (alone.cycles, alone.unseen)


def without_beginning(world: World, tmp_path: Path) -> Path:
    """Cut out are cycles from 0 to a recorded state."""
    folder = write_drive(tmp_path, world, batch=BATCH, snapshots=True, segment_bytes=60_000)
    files = sorted(folder.glob("segment-*.rrd"))
    assert len(files) > 1
    files[0].unlink()
    return folder


def test_without_the_beginning_it_takes_a_state_that_fits(world: World, tmp_path: Path) -> None:
    folder = without_beginning(world, tmp_path)
    assert "which fits the other robot file" in asked(folder, {}, parse(world.text, "the same")).began
    with pytest.raises(WhatIfError, match="no recorded state of the core fits"):
        asked(folder, {}, slower(world))
    assert "state of the recorded core" in asked(folder, {"speed_override": 0.2}).began


def test_behind_a_gap_the_setting_is_set_again(world: World, tmp_path: Path) -> None:
    folder = write_drive(tmp_path, world, batch=BATCH, snapshots=True, segment_bytes=60_000)
    second, third, *_ = sorted(folder.glob("segment-*.rrd"))[1:]
    lost = [inputs.cycle for inputs, _ in open_session(second).cycles()]
    behind = open_session(third).cycles()
    second.unlink()
    question = WhatIf(open_session(folder), {"speed_override": 0.2})
    steps = list(question.steps())
    assert next(behind)[0].cycle == lost[-1] + 1
    assert [step.cycle for step in steps if step.cycle in lost] == []
    assert any(step.new.trace.target != step.recorded.trace.target for step in steps if step.cycle > lost[-1])


@pytest.mark.parametrize(
    ("settings", "begin", "words"),
    [
        ({"colour": 1.0}, 0.0, "'colour': must be one of speed_override"),
        ({"speed_override": 1.5}, 0.0, "speed_override = 1.5: must be 0.05 to 1"),
        ({"compensation.gain": 9.0}, 0.0, "compensation_gain = 9: must be 0 to 4"),
        ({"compensation.gain": 2.5}, 0.0, "'compensation_gain': must be one of speed_override"),
        ({}, 0.0, "nothing to change"),
        ({"speed_override": 0.5}, -1.0, "begin = -1 s: must be 0 or more"),
        ({"speed_override": 0.5}, 1e6, "nothing can be replayed from 1e+06 s on"),
    ],
)
def test_what_cannot_be_asked_is_refused_in_words(
    session: Path, settings: Mapping[str, float], begin: float, words: str
) -> None:
    with pytest.raises(WhatIfError) as refused:
        asked(session, settings, begin=begin)
    assert words in str(refused.value)


def test_the_command_tells_it(session: Path) -> None:
    done = run(session, "--set", "speed.override=0.2", "--from", FROM)
    assert done.exit_code == 0
    assert "commanded" in done.stdout
    assert "open loop" in done.stdout
    told = json.loads(run(session, "--set", "speed_override=0.2", "--from", FROM, "--json").stdout)
    assert list(told) == ["changes", "cycles", "unseen", "began", "open_loop", "problem"]
    assert list(told["changes"][0]) == list(Change._fields)
    assert min(one["first_t"] for one in told["changes"]) >= FROM


@pytest.mark.parametrize(
    "words", [("--set", "speed_override"), ("--set", "colour=1"), (), ("--robot-file", "nowhere.toml")]
)
def test_the_command_refuses_in_words(session: Path, words: tuple[str, ...]) -> None:
    done = run(session, *words)
    assert done.exit_code == 2
    assert done.output.strip()
    assert "Traceback" not in done.output


def test_the_command_takes_a_robot_file(world: World, session: Path, tmp_path: Path) -> None:
    file = tmp_path / "other.toml"
    file.write_text(world.text.replace("rate = 100.0", "rate = 125.0"), encoding="utf-8")
    done = run(session, "--robot-file", file)
    assert done.exit_code == 0
    assert "at the session's beginning" in " ".join(done.stdout.split())


def test_both_are_in_one_recording(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "whatif.rrd"
    assert run(session, "--set", "speed_override=0.2", "--out", out).exit_code == 0
    steps = {step.cycle: step for step in WhatIf(open_session(session), {"speed_override": 0.2}).steps()}
    for side in ("recorded", "new"):
        drawn = drawn_limited(out, f"/{side}/twist/setpoint")
        assert len(drawn) > 50
        assert drawn == {cycle: list(getattr(steps[cycle], side).trace.setpoint) for cycle in drawn}


def drawn_limited(out: Path, entity: str) -> dict[int, list[float]]:
    """The body's setpoint by cycle."""
    found: dict[int, list[float]] = {}
    for chunk in RrdReader(out).store().stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if "cycle" in batch.schema.names:
            found |= dict(
                zip(batch.column("cycle").to_pylist(), batch.column("Scalars:scalars").to_pylist(), strict=True)
            )
    return found


def test_what_is_refused_leaves_no_recording(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "whatif.rrd"
    assert run(session, "--set", "no_such=0.2", "--out", out).exit_code == 2
    assert not out.exists()


def test_the_session_itself_is_not_written_over(session: Path) -> None:
    file = session / "segment-00001.rrd"
    before = file.read_bytes()
    done = run(session, "--set", "speed_override=0.2", "--out", file)
    assert done.exit_code == 2
    assert "of the session itself" in done.output
    assert file.read_bytes() == before


def test_a_recording_that_cannot_be_written_is_said(session: Path, tmp_path: Path) -> None:
    done = run(session, "--set", "speed_override=0.2", "--out", tmp_path / "nowhere" / "whatif.rrd")
    assert done.exit_code == 2
    assert "cannot be written" in done.output


def change_of(question: WhatIf, motor: str | None, channel: str) -> Change:
    return next(one for one in question.changes if (one.motor, one.channel) == (motor, channel))

"""Compared is whatever a snapshot leads to: a segment of its own, what is behind a gap, what was left by pruning."""

import csv
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from gateway.cli.app import build
from gateway.core.engine import Engine
from gateway.core.snapshot import SnapshotError
from gateway.recording import segment
from gateway.recording.columns import arrays
from gateway.recording.disk import segment_path
from gateway.recording.packets import SNAPSHOT_PERIOD_NS, Record, Snapshot
from gateway.recording.recorder import Recorder
from gateway.recording.schema import SNAPSHOT_COLUMNS, Kind, Row
from gateway.types import CycleTiming, Outputs, Twist
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.drives import drive
from tests.recordings import robot, robot_text, stored, write_drive, writer
from tests.world import World

BATCH = 60
CYCLES = 4 * BATCH


@pytest.fixture(scope="module")
def world() -> World:
    driven = World("moby", rate_hz=100.0)
    driven.start()
    while len(driven.records) < CYCLES:
        driven.run(0.1, Twist(0.3, 0.1, 0.2))
    del driven.records[CYCLES:]
    return driven


@pytest.fixture(scope="module")
def recorded(world: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four segments of a batch each, all but the first with a snapshot in front."""
    return write_drive(tmp_path_factory.mktemp("s"), world, batch=BATCH, snapshots=True, segment_bytes=60_000)


@pytest.fixture
def session(recorded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recorded, tmp_path / recorded.name))


def test_whole_it_is_identical(recorded: Path) -> None:
    verdict = verify(open_session(recorded))
    assert (verdict.exit_code, verdict.cycles, verdict.unseen, verdict.refused) == (0, CYCLES, 0, None)


@pytest.mark.parametrize("number", [2, 3, 4])
def test_a_segment_is_compared_on_its_own(recorded: Path, number: int) -> None:
    verdict = verify(open_session(segment_path(recorded, number)))
    assert (verdict.exit_code, verdict.cycles, verdict.unseen) == (3, BATCH, 0)
    assert not verdict.identical
    assert f"cycles 0 to {(number - 1) * BATCH - 1} are missing" in (verdict.problem or "")


@pytest.mark.parametrize(("number", "compared"), [(1, 3), (2, 3), (4, 3)])
def test_behind_a_gap_it_goes_on(session: Path, number: int, compared: int) -> None:
    segment_path(session, number).unlink()
    verdict = verify(open_session(session))
    assert (verdict.exit_code, verdict.cycles, verdict.unseen) == (3, compared * BATCH, 0)


def test_a_difference_behind_a_gap_is_found(world: World, tmp_path: Path) -> None:
    other = World("moby", rate_hz=100.0)
    other.records = list(world.records)
    inputs, outputs = other.records[200]
    changed: Outputs = outputs._replace(frames=outputs.frames[:-1])
    other.records[200] = (inputs, changed)
    folder = write_drive(tmp_path, other, batch=BATCH, snapshots=True, segment_bytes=60_000)
    segment_path(folder, 1).unlink()
    verdict = verify(open_session(folder))
    assert (verdict.exit_code, verdict.cycles) == (1, 200 - BATCH + 1)
    assert verdict.first_difference is not None
    assert verdict.first_difference.cycle == 200


def test_cycles_that_no_snapshot_leads_to_are_counted(world: World, tmp_path: Path) -> None:
    other = World("moby", rate_hz=100.0)
    other.records = world.records[:70] + world.records[80:]
    verdict = verify(open_session(write_drive(tmp_path, other, batch=BATCH)))
    assert (verdict.exit_code, verdict.cycles, verdict.unseen) == (3, 70, CYCLES - 80)


@pytest.mark.pure_python  # replaces a function of the core
def test_a_snapshot_that_this_software_refuses_is_said(recorded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise SnapshotError("the snapshot is of another version of the software")

    monkeypatch.setattr("gateway.core.snapshot.put", refuse)
    verdict = verify(open_session(segment_path(recorded, 3)))
    assert (verdict.exit_code, verdict.cycles, verdict.unseen) == (2, 0, BATCH)
    assert verdict.refused == "after cycle 119: the snapshot is of another version of the software"


def test_a_damaged_snapshot_is_not_used(world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def other(columns: Mapping[str, Kind], rows: Sequence[Row]) -> dict[str, Any]:
        return arrays(columns, [(*rows[0][:2], 7, *rows[0][3:])] if columns is SNAPSHOT_COLUMNS else rows)

    monkeypatch.setattr(segment, "arrays", other)
    folder = write_drive(tmp_path, world, batch=BATCH, snapshots=True, segment_bytes=60_000)
    monkeypatch.undo()
    verdict = verify(open_session(segment_path(folder, 2)))
    assert (verdict.cycles, verdict.unseen) == (0, BATCH)
    assert "a snapshot of the core is not as it was written" in (verdict.problem or "")


def test_the_recorder_takes_one_every_five_seconds_and_begins_segments_there(world: World, tmp_path: Path) -> None:
    """In virtual time, through the recorder's own process; the batch of each snapshot begins behind it."""
    long = World("moby", rate_hz=100.0)
    recorder = Recorder(stored(long.config, tmp_path), long.text)
    for _ in range(1100):
        long.cycle()
        recorder.put(*long.records[-1], CycleTiming(0, 0, 0), long.engine.snapshot)
    assert recorder.close()
    assert recorder.session is not None
    opened = open_session(recorder.session)
    assert opened.complete
    firsts = [inputs.cycle for inputs, _ in opened.cycles() if opened.snapshot(inputs.cycle - 1) is not None]
    assert firsts == [1, 501, 1001]


def test_an_old_segment_waits_for_a_snapshot_to_begin_the_next_one(tmp_path: Path) -> None:
    def batch(number: int) -> Sequence[Record]:
        return list(drive(10, first=10 * number))

    state = Engine(robot(tmp_path)).snapshot()
    session = writer(tmp_path, segment_seconds=5.0)
    session.write(batch(0))
    session.write(batch(1), (), Snapshot.of(9, state))
    session._opened_ns -= 6 * 10**9
    session.write(batch(2))
    assert session.report().segment == 1
    session.write(batch(3), (), Snapshot.of(29, state))
    assert session.report().segment == 2
    session._opened_ns -= 6 * 10**9
    session._snapshot_ns -= 2 * SNAPSHOT_PERIOD_NS  # they do not come any more
    session.write(batch(4))
    assert session.report().segment == 3
    session.close()
    assert robot_text() == open_session(session.folder).config_text


def told(*arguments: str) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", *arguments])


def test_the_trace_of_every_cycle_is_computed_again(session: Path, world: World) -> None:
    lines = told("trace", str(session)).stdout.splitlines()
    rows = list(csv.DictReader(lines))
    assert [int(row["cycle"]) for row in rows] == list(range(CYCLES))
    for row, (_, outputs) in zip(rows, world.records, strict=True):
        assert row["mode"] == outputs.mode.value
        assert float(row["x"]) == outputs.trace.pose.x
        left = outputs.trace.wheel_speeds[0]
        assert row["speed.left"] == ("" if left is None else repr(left))
    cut = told("trace", str(session), "--from", "0.495", "--to", "0.605")
    assert len(cut.stdout.splitlines()) == 1 + 11
    assert cut.exit_code == 0


def test_the_trace_goes_on_behind_a_gap(session: Path) -> None:
    segment_path(session, 2).unlink()
    for command in ("trace", "can"):
        assert told(command, str(session), "--from", "900").exit_code == 2
    found = told("trace", str(session))
    assert found.exit_code == 3
    cycles = [int(row["cycle"]) for row in csv.DictReader(found.stdout.splitlines())]
    assert cycles == [*range(BATCH), *range(2 * BATCH, CYCLES)]


def test_every_frame_is_told_in_words(session: Path, world: World) -> None:
    found = told("can", str(session))
    lines = found.stdout.splitlines()
    assert found.exit_code == 0
    assert len(lines) == sum(len(inputs.frames) + len(outputs.frames) for inputs, outputs in world.records)
    assert any(" rx left Get_Encoder_Estimates Pos_Estimate=" in line and "(can0 029#" in line for line in lines)
    assert any(" tx left Set_Input_Vel Input_Vel=" in line and "(can0 02D#" in line for line in lines)


def test_of_what_is_no_session_nothing_is_told(tmp_path: Path) -> None:
    assert told("can", str(tmp_path)).exit_code == told("trace", str(tmp_path)).exit_code == 2

"""A piece of a session is what was there, verifies on its own, and put together the pieces are the whole."""

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from gateway.cli.app import build
from gateway.core.engine import Engine
from gateway.recording.disk import segment_path
from gateway.recording.failures import WriterDeadError
from gateway.recording.packets import Record, Snapshot
from gateway.recording.writer import SessionWriter
from gateway.types import CycleTiming, Twist
from replay.compare.verify import verify
from replay.drive.pieces import cut, merge
from replay.sessions.reader import Session, SessionError, open_session
from replay.sessions.summary import summary
from tests.recordings import STARTED_NS, world_writer, write_drive
from tests.world import World

BATCH = 60
RATE_HZ = 100.0
CYCLES = 4 * BATCH
OLD = Path(__file__).parent.parent / "sessions" / "v1-moby"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four segments of a batch each, all but the first with a snapshot in front."""
    world = World("moby", rate_hz=RATE_HZ)
    world.start()
    while len(world.records) < CYCLES:
        world.run(0.1, Twist(0.3, 0.1, 0.2))
    del world.records[CYCLES:]
    return written(tmp_path_factory.mktemp("s"), world)


def written(directory: Path, world: World) -> Path:
    """With a snapshot in front of every batch but the first; the loop kept another time in each cycle."""
    session = world_writer(directory, world, segment_bytes=60_000)
    engine = Engine(world.config)
    snapshot = None
    for start in range(0, len(world.records), BATCH):
        some = world.records[start : start + BATCH]
        timings = [CycleTiming(x.cycle * 7, x.cycle * 5, STARTED_NS + x.now_ns) for x, _ in some]
        session.write([Record(x, y, timing) for (x, y), timing in zip(some, timings, strict=True)], (), snapshot)
        for inputs, _ in some:
            engine.step(inputs)
        snapshot = Snapshot.of(some[-1][0].cycle, engine.snapshot())
    session.close()
    return session.folder


def cycles(session: Session) -> list[object]:
    return list(session.cycles())


@pytest.mark.parametrize(
    ("times", "numbers"),
    [
        ((0.0, 0.5), (0, 50)),
        ((0.7, 0.9), (60, 90)),
        ((0.59, 0.61), (0, 61)),
        ((0.6, 9.0), (60, 239)),
        ((1.9, 1.95), (180, 195)),
        ((0.0, 9.0), (0, 239)),
    ],
)
def test_a_piece_verifies_on_its_own(
    recorded: Path, tmp_path: Path, times: tuple[float, float], numbers: tuple[int, int]
) -> None:
    (begin, end), (first, last) = times, numbers
    whole = open_session(recorded)
    piece = cut(whole, tmp_path, begin=begin, end=end)
    assert (piece.first_cycle, piece.last_cycle) == (first, last)
    found = open_session(piece.session)
    assert cycles(found) == cycles(whole)[first : last + 1]
    assert found.complete
    verdict = verify(found)
    assert (verdict.exit_code, verdict.cycles, verdict.unseen) == (0, last - first + 1, 0)
    assert list(found.timings()) == list(whole.timings())[first : last + 1]
    told = summary(found)
    assert (told.cut_from, told.commit, told.versions) == (
        recorded.name,
        whole.header.git_commit,
        whole.header.versions,
    )
    assert found.header.config_text == whole.header.config_text


def test_what_is_taken_out_of_a_piece_is_missed(recorded: Path, tmp_path: Path) -> None:
    """Its beginning too: a piece says with which cycle it begins."""
    piece = cut(open_session(recorded), tmp_path, begin=0.7)
    again = cut(open_session(piece.session), tmp_path / "other", begin=0.61)
    assert open_session(again.session).header.first_cycle == 120
    fresh = tmp_path / "claims" / "more"
    fresh.mkdir(parents=True)
    shutil.copy(segment_path(again.session, 1), segment_path(fresh, 2))
    found = open_session(fresh)
    assert not found.complete
    assert any("segments 1 to 1 are missing" in problem for problem in found.problems)


def test_a_piece_of_a_piece(recorded: Path, tmp_path: Path) -> None:
    piece = cut(open_session(recorded), tmp_path, begin=0.7)
    smaller = cut(open_session(piece.session), tmp_path, begin=0.7, end=0.8)
    assert (smaller.first_cycle, smaller.last_cycle) == (120, 140)
    assert summary(open_session(smaller.session)).cut_from == recorded.name
    assert verify(open_session(smaller.session)).exit_code == 0


def test_pieces_put_together_are_the_whole(recorded: Path, tmp_path: Path) -> None:
    whole = open_session(recorded)
    places = [(0.0, 0.65), (1.2, 9.0), (0.6, 1.25)]
    parts = [open_session(cut(whole, tmp_path / "parts", begin=begin, end=end).session) for begin, end in places]
    merged = merge(parts, tmp_path / "merged")
    found = open_session(merged.session)
    assert cycles(found) == cycles(whole)
    assert (verify(found).exit_code, verify(found).cycles) == (0, CYCLES)
    with pytest.raises(SessionError, match="cycles 66 to 119 are missing"):
        merge(parts[:2], tmp_path / "merged")


def test_segments_of_a_session_are_pieces_of_it(recorded: Path, tmp_path: Path) -> None:
    parts = [open_session(segment_path(recorded, number)) for number in (3, 2)]
    merged = merge(parts, tmp_path)
    assert (merged.first_cycle, merged.last_cycle) == (BATCH, 3 * BATCH - 1)
    assert verify(open_session(merged.session)).exit_code == 0


def test_what_is_no_piece(recorded: Path, tmp_path: Path) -> None:
    whole = open_session(recorded)
    with pytest.raises(SessionError, match="no cycle was recorded from 9 s to 10 s"):
        cut(whole, tmp_path, begin=9.0, end=10.0)
    with pytest.raises(SessionError, match=r"from 1 s to 0\.5 s: the end is in front of the beginning"):
        cut(whole, tmp_path, begin=1.0, end=0.5)
    with pytest.raises(SessionError, match="schema 1"):
        cut(open_session(OLD), tmp_path)
    other = tmp_path / "other"
    world = World("moby", rate_hz=RATE_HZ)
    world.start()
    stranger = open_session(write_drive(other, world, started_ns=1_780_000_000_000_000_000))
    with pytest.raises(SessionError, match="not pieces of one session"):
        merge([whole, stranger], tmp_path)


def test_sessions_of_one_name_are_told_apart(recorded: Path, tmp_path: Path) -> None:
    """Two robots of one name may start in the same second."""
    world = World("moby", rate_hz=RATE_HZ)
    world.start()
    world.text += "\n# another one\n"
    namesake = open_session(write_drive(tmp_path, world))
    assert namesake.header.session == recorded.name
    with pytest.raises(SessionError, match=f"two sessions called {recorded.name}: they differ in the robot file"):
        merge([open_session(recorded), namesake], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def dead(*_: object, **__: object) -> None:
    raise WriterDeadError("no quota")


def test_a_full_disk_is_told_and_nothing_is_left(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("replay.drive.recording.free_bytes", lambda _: 1000)
    for command in ("cut", "merge"):
        arguments = ["replay", command, str(recorded), "--out", str(tmp_path), "--json"]
        result = CliRunner().invoke(build("replay"), arguments)
        assert result.exit_code == 2
        assert "disk full: 1000 bytes free" in json.loads(result.stdout)["problem"]
        assert list(tmp_path.iterdir()) == []


def test_a_dead_writer_leaves_nothing_either(recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not touched again, and its process ends at once."""
    monkeypatch.setattr(SessionWriter, "write", dead)
    monkeypatch.setattr(SessionWriter, "close", lambda *_, **__: pytest.fail("it may block for ever"))
    ended: list[int] = []
    monkeypatch.setattr("os._exit", ended.append)
    result = CliRunner().invoke(build("replay"), ["replay", "cut", str(recorded), "--out", str(tmp_path), "--json"])
    assert (result.exit_code, ended) == (2, [2])
    assert json.loads(result.stdout) == {"problem": "no quota"}
    assert list(tmp_path.iterdir()) == []


def test_an_error_of_the_system_names_its_file(recorded: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    arguments = ["replay", "cut", str(recorded), "--out", str(tmp_path / "file"), "--json"]
    result = CliRunner().invoke(build("replay"), arguments)
    assert (result.exit_code, json.loads(result.stdout)["problem"]) == (2, f"{tmp_path / 'file'}: File exists")


def test_what_was_recorded_is_in_a_piece_and_not_what_would_be_said_now(tmp_path: Path) -> None:
    world = World("moby", rate_hz=RATE_HZ)
    world.start()
    world.run(1.0, Twist(0.3, 0.1, 0.2))
    inputs, outputs = world.records[70]
    world.records[70] = (inputs, outputs._replace(frames=outputs.frames[:-1]))
    piece = cut(open_session(written(tmp_path / "whole", world)), tmp_path, begin=0.65)
    found = verify(open_session(piece.session))
    assert found.exit_code == 1
    assert found.first_difference is not None
    assert found.first_difference.cycle == 70


@pytest.mark.pure_python
def test_a_piece_that_cannot_be_made_is_not_there(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaks(*_: object) -> None:
        raise ValueError("broken")

    whole = open_session(recorded)
    monkeypatch.setattr(Engine, "step", breaks)
    with pytest.raises(SessionError, match="this version of the software breaks on it"):
        cut(whole, tmp_path)
    assert not list(tmp_path.glob("*/*.rrd"))


def test_a_piece_ends_at_a_gap(recorded: Path, tmp_path: Path) -> None:
    gappy = Path(shutil.copytree(recorded, tmp_path / recorded.name))
    segment_path(gappy, 2).unlink()
    session = open_session(gappy)
    with pytest.raises(SessionError, match="cycle 60 is missing"):
        cut(session, tmp_path / "out")
    assert cut(session, tmp_path / "out", begin=1.3).first_cycle == 120
    segment_path(gappy, 1).unlink()
    assert cut(open_session(gappy), tmp_path / "out", begin=0.7).first_cycle == 180


def test_the_command(recorded: Path, tmp_path: Path) -> None:
    def asked(*arguments: object) -> Result:
        return CliRunner().invoke(build("replay"), ["replay", *map(str, arguments)])

    result = asked("cut", recorded, "--from", 0.7, "--to", 0.9, "--out", tmp_path, "--json")
    told = json.loads(result.stdout.splitlines()[-1])
    assert result.exit_code == 0
    assert (told["first_cycle"], told["last_cycle"], told["begin"]) == (60, 90, 0.6)
    assert asked("verify", told["session"]).exit_code == 0
    assert asked("merge", told["session"], segment_path(recorded, 1), "--out", tmp_path).exit_code == 0
    assert asked("cut", recorded, "--from", 9.0, "--out", tmp_path).exit_code == 2
    assert asked("merge", tmp_path / "nothing", "--out", tmp_path).exit_code == 2

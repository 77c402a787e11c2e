"""A recording that is not whole is never called identical: whatever is cut out of it, changed, lost or taken away."""

import json
import random
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from gateway.cli.app import build
from gateway.recording.disk import SUMS, segment_path
from gateway.recording.packets import Gap, Record
from gateway.types import ZERO_TWIST, CycleTiming, Outputs, Twist
from replay.compare.verify import Verdict, not_replayable, verify
from replay.sessions.reader import SessionError, open_session
from tests.recordings import world_writer, write, write_drive
from tests.replay.test_session import message_ends
from tests.world import World

OLD = Path(__file__).parent.parent / "sessions"  # v1: before segments had seals; v2: before cycles had a digest chain
SEGMENTS = 3
BATCH = 60

Spoil = Callable[[Path], object]


@pytest.fixture(scope="module")
def world() -> World:
    driven = World("moby", rate_hz=100.0)
    driven.start()
    driven.run(0.5, Twist(0.3, 0.1, 0.0))
    driven.run(0.3, ZERO_TWIST)
    return driven


@pytest.fixture(scope="module")
def recorded(world: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of three segments."""
    del world.records[SEGMENTS * BATCH :]
    assert len(world.records) > (SEGMENTS - 1) * BATCH
    folder = write_drive(tmp_path_factory.mktemp("recorded"), world, batch=BATCH, segment_bytes=60_000)
    assert len(open_session(folder).segments) == SEGMENTS
    return folder


@pytest.fixture
def session(recorded: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    return Path(shutil.copytree(recorded, tmp_path / recorded.name))


def judged(path: Path) -> Verdict:
    try:
        return verify(open_session(path))
    except SessionError as error:
        return not_replayable(str(error))


def with_spoilt(file: Path, content: bytes) -> Verdict:
    """The verdict on the session of this file while it holds this."""
    before = file.read_bytes()
    file.write_bytes(content)
    try:
        return judged(file.parent)
    finally:
        file.write_bytes(before)


def pieces(data: bytes) -> st.SearchStrategy[tuple[int, int]]:
    """Begin and end of a piece: anywhere, of whole messages, or from somewhere to the end of the file."""
    borders = [12, *message_ends(data)]
    anywhere = st.tuples(st.integers(0, len(data) - 1), st.integers(1, len(data)))
    messages = st.tuples(st.sampled_from(borders), st.sampled_from(borders))
    tails = st.tuples(st.sampled_from(borders), st.just(len(data)))
    ordered = st.one_of(anywhere, messages, tails).map(lambda pair: (min(pair), max(pair)))
    return ordered.filter(lambda pair: pair[0] < pair[1])


def test_whole_it_is_identical_and_complete(recorded: Path, world: World) -> None:
    verdict = judged(recorded)
    assert (verdict.exit_code, verdict.problem, verdict.cycles) == (0, None, len(world.records))


@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_no_cut_is_ever_called_identical(recorded: Path, data: st.DataObject) -> None:
    file = data.draw(st.sampled_from(sorted(recorded.glob("segment-*.rrd"))))
    content = file.read_bytes()
    begin, end = data.draw(pieces(content))
    verdict = with_spoilt(file, content[:begin] + content[end:])
    assert not verdict.identical
    assert verdict.exit_code in {2, 3}  # what is left is as it was, or is not there
    assert verdict.problem


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@pytest.mark.parametrize("name", ["v1-moby", "v1-omni4"])
@given(data=st.data())
def test_no_cut_of_an_older_recording_is_called_identical(name: str, tmp_path: Path, data: st.DataObject) -> None:
    content = (OLD / name / "segment-00001.rrd").read_bytes()
    begin, end = data.draw(pieces(content))
    (tmp_path / "segment-00001.rrd").write_bytes(content[:begin] + content[end:])
    verdict = judged(tmp_path)
    assert not verdict.complete
    assert verdict.exit_code != 0


def test_no_flipped_bit_is_called_identical(recorded: Path) -> None:
    """Also in what is not replayed: pictures, what Rerun puts around its numbers, the seal, the footer."""
    generator = random.Random(4)
    for file in sorted(recorded.glob("segment-*.rrd")):
        content = file.read_bytes()
        for _ in range(15):
            spoilt = bytearray(content)
            spoilt[generator.randrange(len(content))] ^= 1 << generator.randrange(8)
            verdict = with_spoilt(file, bytes(spoilt))
            assert verdict.exit_code in {1, 2, 3}
            assert not verdict.complete


def without(number: int) -> Spoil:
    return lambda folder: segment_path(folder, number).unlink()


def emptied(number: int) -> Spoil:
    return lambda folder: segment_path(folder, number).write_bytes(b"")


def exchanged(folder: Path) -> None:
    first, second = segment_path(folder, 2), segment_path(folder, 3)
    first.rename(folder / "aside")
    second.rename(first)
    (folder / "aside").rename(second)


def doubled(folder: Path) -> None:
    shutil.copy(segment_path(folder, 3), segment_path(folder, 4))


def grown(folder: Path) -> None:
    with segment_path(folder, 2).open("ab") as file:
        file.write(b"\0")


def unclosed(folder: Path) -> None:
    file = segment_path(folder, 3)
    content = file.read_bytes()
    file.write_bytes(content[: message_ends(content)[-2]])


class Case(NamedTuple):
    """`cycles`: as many as can be replayed before the first that is missing; None: all."""

    spoil: Spoil
    exit_code: int
    cycles: int | None
    words: str


CASES = [
    Case(without(1), 2, 0, "segments 1 to 1 are missing"),
    Case(without(2), 3, BATCH, "segments 2 to 2 are missing"),
    Case(without(3), 3, 2 * BATCH, "the session was not ended in order"),
    Case(emptied(1), 2, 0, "segment-00001.rrd: it cannot be read: not a Rerun file"),
    Case(emptied(2), 3, BATCH, "segment-00002.rrd: it cannot be read: not a Rerun file"),
    Case(emptied(3), 3, 2 * BATCH, "segment-00003.rrd: it cannot be read: not a Rerun file"),
    Case(exchanged, 3, BATCH, "segment-00002.rrd: it is segment 3 by its header"),
    Case(doubled, 3, None, "segment-00004.rrd: it is segment 3 by its header"),
    Case(grown, 3, None, "segment-00002.rrd: it is not as it was written"),
    Case(unclosed, 3, None, "segment-00003.rrd: it was not closed"),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.exit_code}-{case.words[:40]}")
def test_what_is_wrong_is_said(session: Path, world: World, case: Case) -> None:
    case.spoil(session)
    verdict = judged(session)
    assert verdict.problem is not None
    assert case.words in verdict.problem
    assert (verdict.exit_code, verdict.identical, verdict.complete) == (case.exit_code, False, False)
    assert verdict.cycles == (len(world.records) if case.cycles is None else case.cycles)


def test_a_segment_of_another_session_is_not_replayed(session: Path, world: World, tmp_path: Path) -> None:
    other = write(tmp_path / "other", [])
    foreign = write_drive(tmp_path / "foreign", world, started_ns=1_800_000_000_000_000_000)
    shutil.copy(segment_path(foreign, 1), segment_path(session, 2))
    verdict = judged(session)
    assert (verdict.exit_code, verdict.cycles) == (3, BATCH)
    assert f"it belongs to session {foreign.name}" in (verdict.problem or "")
    assert judged(other).exit_code == 2


def test_a_service_that_did_not_say_goodbye_leaves_it_open(world: World, tmp_path: Path) -> None:
    for ended, exit_code in ((True, 0), (False, 3)):
        recording = world_writer(tmp_path / str(ended), world)
        recording.write([Record(inputs, outputs, CycleTiming(0, 0, 0)) for inputs, outputs in world.records])
        recording.close(ended=ended)
        assert judged(recording.folder).exit_code == exit_code


def test_cycles_lost_at_the_end_are_missing(world: World, tmp_path: Path) -> None:
    recording = world_writer(tmp_path, world)
    records = [Record(inputs, outputs, CycleTiming(0, 0, 0)) for inputs, outputs in world.records]
    recording.write(records[:50])
    recording.write((), [Gap(50, 59, "full")])
    recording.close()
    verdict = judged(recording.folder)
    assert (verdict.exit_code, verdict.cycles) == (3, 50)
    assert verdict.problem == "cycles 50 to 59 are missing from the recording (full)"


def test_a_difference_outranks_what_is_missing(world: World, tmp_path: Path) -> None:
    other = World("moby", rate_hz=100.0)
    other.records = list(world.records)
    inputs, outputs = other.records[20]
    other.records[20] = (inputs, outputs._replace(frames=outputs.frames[:-1] if outputs.frames else ()))
    changed: Outputs = other.records[20][1]
    assert changed != outputs
    del other.records[40:50]
    verdict = judged(write_drive(tmp_path, other))
    assert (verdict.exit_code, verdict.complete, verdict.cycles) == (1, False, 21)
    assert verdict.first_difference is not None
    assert verdict.problem is not None


@pytest.mark.pure_python
def test_a_core_that_breaks_on_a_recorded_cycle_answers_differently(
    recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr("gateway.core.engine.Engine.step", broken)
    verdict = judged(recorded)
    assert (verdict.exit_code, verdict.complete, verdict.cycles) == (1, True, 1)


@pytest.mark.parametrize("name", ["v1-moby", "v1-omni4"])
def test_older_recordings_are_read_whole(name: str) -> None:
    """The rules of the core have changed since: they are different, and a change of the software is the reason."""
    session = open_session(OLD / name)
    cycles = [inputs.cycle for inputs, _ in session.cycles()]
    assert cycles == list(range({"v1-moby": 556, "v1-omni4": 594}[name]))
    assert session.complete
    assert session.header.robot == name.removeprefix("v1-")
    verdict = verify(session)
    assert verdict.exit_code == 1
    assert "arithmetic the machine's libraries, now own" in str(verdict.software_change)


def test_a_recording_of_schema_2_is_read_whole() -> None:
    session = open_session(OLD / "v2-moby")
    assert session.header.schema_version == 2
    assert [inputs.cycle for inputs, _ in session.cycles()] == list(range(258))
    verdict = verify(session)
    assert verdict.complete
    assert (verdict.exit_code == 0) is verdict.identical


@pytest.mark.parametrize(("spoil", "exit_code"), [(lambda _: None, 0), (without(3), 3), (without(1), 2)])
def test_the_command_says_it_and_exits_with_it(session: Path, spoil: Spoil, exit_code: int) -> None:
    spoil(session)
    words = CliRunner().invoke(build("replay"), ["replay", "verify", str(session)])
    assert words.exit_code == exit_code
    assert ("incomplete" in words.output) is (exit_code == 3)
    assert words.output.startswith("identical") is (exit_code == 0)
    done = CliRunner().invoke(build("replay"), ["replay", "verify", str(session), "--json"])
    assert done.exit_code == exit_code
    verdict = json.loads(done.stdout)
    assert verdict["exit_code"] == exit_code
    assert verdict["identical"] is verdict["complete"] is (exit_code == 0)
    assert (verdict["problem"] is None) is (exit_code == 0)


def test_the_command_on_what_is_no_session(tmp_path: Path) -> None:
    done = CliRunner().invoke(build("replay"), ["replay", "verify", str(tmp_path), "--json"])
    assert done.exit_code == 2
    assert json.loads(done.stdout)["exit_code"] == 2


def test_what_was_noted_of_a_segment_is_what_sha256sum_says(session: Path) -> None:
    done = subprocess.run(["sha256sum", "--check", "--strict", SUMS], cwd=session, capture_output=True, check=False)
    assert done.returncode == 0
    (session / SUMS).unlink()  # a copy of the segments alone: seals and footers are taken at their word
    assert judged(session).exit_code == 0


@pytest.mark.parametrize("spoil", [lambda text: text.replace("segment-00002", "segment-00009"), lambda text: text[1:]])
def test_a_spoilt_note_is_told(session: Path, spoil: Callable[[str], str]) -> None:
    (session / SUMS).write_text(spoil((session / SUMS).read_text()))
    verdict = judged(session)
    assert verdict.exit_code == 3
    assert "it is not in SHA256SUMS" in (verdict.problem or "")

"""A session compared side by side gets the verdict of the single pass: whole, damaged or different."""

import os
import pickle
import random
import select
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import ParamSpec, TypeVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from gateway.cli.app import build
from gateway.core.engine import Engine
from gateway.recording.disk import segment_path
from gateway.recording.packets import Snapshot
from gateway.recording.segment import Segment
from gateway.types import Twist
from replay.compare.side_by_side import Confirmed, confirmed, processes
from replay.compare.verify import Verdict, not_replayable, verify
from replay.sessions.reader import SessionError, open_session, packed
from tests.recordings import write_drive
from tests.replay.test_incomplete import OLD, pieces
from tests.replay.test_session import message_ends
from tests.world import NAMES, World

BATCH = 40
STRETCHES = 6
CYCLES = STRETCHES * BATCH

P = ParamSpec("P")
T = TypeVar("T")


class Here(Executor):
    """A pool that is this process; what goes in and comes out is packed as for another one."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        done: Future[T] = Future()
        try:
            done.set_result(pickle.loads(pickle.dumps(fn(*pickle.loads(pickle.dumps(args)), **kwargs))))
        except BrokenProcessPool as error:
            done.set_exception(error)
        return done


@contextmanager
def spoilt(file: Path, content: bytes) -> Iterator[None]:
    """A file that holds something else for a while."""
    before = file.read_bytes()
    file.write_bytes(content)
    try:
        yield
    finally:
        file.write_bytes(before)


class Dying(Here):
    """A pool whose second process is killed."""

    def __init__(self) -> None:
        self._begun = 0

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        self._begun += 1
        if self._begun == 2:
            raise BrokenProcessPool
        return super().submit(fn, *args, **kwargs)


def driven(name: str) -> World:
    world = World(name, rate_hz=100.0)
    world.start()
    while len(world.records) < CYCLES:
        world.run(0.1, Twist(0.3, 0.1, 0.2))
    del world.records[CYCLES:]
    return world


def write(directory: Path, world: World) -> Path:
    """A snapshot in front of every batch but the first, a segment of its own for each second batch."""
    return write_drive(directory, world, batch=BATCH, snapshots=True, segment_bytes=90_000)


@pytest.fixture(scope="module", params=NAMES)
def world(request: pytest.FixtureRequest) -> World:
    return driven(request.param)


@pytest.fixture(scope="module")
def recorded(world: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("recorded"), world)


@pytest.fixture
def session(recorded: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(recorded, tmp_path / recorded.name))


def judged(path: Path, pool: Executor | None) -> Verdict:
    try:
        return verify(open_session(path), pool=pool)._replace(realtime_ratio=0.0)
    except SessionError as error:
        return not_replayable(str(error))


def found(path: Path) -> Confirmed | None:
    return confirmed(open_session(path), Here(), lambda _: None)


def alike(path: Path) -> Verdict:
    """The verdict, once it is the same either way."""
    alone = judged(path, None)
    assert judged(path, Here()) == alone
    return alone


def test_whole_it_is_confirmed(recorded: Path) -> None:
    assert len(list(open_session(recorded).stretches())) == STRETCHES
    assert len(open_session(recorded).segments) > 1
    assert found(recorded) is not None
    assert alike(recorded).cycles == CYCLES


@pytest.mark.parametrize("number", [1, 2, 3])
def test_what_is_left_of_it_is_confirmed(session: Path, number: int) -> None:
    segment_path(session, number).unlink()
    assert found(session) is not None
    assert alike(session).exit_code == 3


def test_the_time_that_was_covered_is_the_same(session: Path) -> None:
    """It is what `realtime_ratio` tells."""
    for number in (None, 2):
        if number is not None:
            segment_path(session, number).unlink()
        there = found(session)
        assert there is not None
        first_ns = {inputs.cycle: inputs.now_ns for inputs, _ in open_session(session).cycles()}
        pairs = zip(list(first_ns)[:-1], list(first_ns)[1:], strict=True)
        expected = sum(first_ns[after] - first_ns[before] for before, after in pairs if after == before + 1)
        assert there.compared.covered_ns == expected


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_cut_it_gets_the_same_verdict(recorded: Path, data: st.DataObject) -> None:
    file = data.draw(st.sampled_from(sorted(recorded.glob("segment-*.rrd"))))
    content = file.read_bytes()
    begin, end = data.draw(pieces(content))
    with spoilt(file, content[:begin] + content[end:]):
        assert not alike(recorded).identical


def test_with_flipped_bits_it_gets_the_same_verdict(recorded: Path) -> None:
    generator = random.Random(7)
    for file in sorted(recorded.glob("segment-*.rrd")):
        content = file.read_bytes()
        for _ in range(8):
            changed = bytearray(content)
            changed[generator.randrange(12, message_ends(content)[-1])] ^= 1 << generator.randrange(8)
            with spoilt(file, bytes(changed)):
                alike(recorded)


@pytest.mark.parametrize("cycle", [0, BATCH - 1, BATCH, CYCLES // 2, CYCLES - 1])
def test_a_difference_is_the_same_difference(world: World, tmp_path: Path, cycle: int) -> None:
    other = World(world.config.robot.name, rate_hz=100.0)
    other.records = list(world.records)
    inputs, outputs = other.records[cycle]
    other.records[cycle] = (inputs, outputs._replace(frames=outputs.frames[:-1], events=()))
    folder = write(tmp_path, other)
    verdict = alike(folder)
    if outputs.frames or outputs.events:
        assert verdict.first_difference is not None
        assert verdict.first_difference.cycle == cycle


@pytest.mark.parametrize("lost", [range(10, 20), range(BATCH - 3, BATCH + 3), range(3 * BATCH - 1, 3 * BATCH)])
def test_cycles_that_were_lost(world: World, tmp_path: Path, lost: range) -> None:
    other = World(world.config.robot.name, rate_hz=100.0)
    other.records = [record for record in world.records if record[0].cycle not in lost]
    verdict = alike(write_drive(tmp_path, other, batch=BATCH))
    assert (verdict.exit_code, verdict.cycles) == (3, lost.start)


@pytest.mark.parametrize("name", ["v1-moby", "v1-omni4"])
def test_older_recordings_go_through_the_single_pass(name: str) -> None:
    assert found(OLD / name) is None
    assert alike(OLD / name).exit_code == 1


def test_a_snapshot_that_is_not_what_led_to_it_confirms_nothing(
    world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The single pass goes by it at no place, and finds the drive identical."""
    fresh = packed(Engine(world.config).snapshot())

    def keep(self: Segment, snapshot: Snapshot, plain: Callable[[Segment, Snapshot], None] = Segment.keep) -> None:
        plain(self, Snapshot(snapshot.cycle, fresh))

    monkeypatch.setattr(Segment, "keep", keep)
    folder = write(tmp_path, world)
    monkeypatch.undo()
    assert found(folder) is None
    assert alike(folder).identical


def test_a_process_that_dies_leaves_it_to_the_single_pass(recorded: Path) -> None:
    assert confirmed(open_session(recorded), Dying(), lambda _: None) is None
    assert judged(recorded, Dying()) == judged(recorded, None)


def test_every_cycle_is_told_of_once(world: World, recorded: Path, tmp_path: Path) -> None:
    told: list[int] = []
    verify(open_session(recorded), told.append, pool=Here())
    assert sum(told) == CYCLES


def test_the_command_says_the_same_with_processes(session: Path) -> None:
    def said(*arguments: str) -> Iterator[str]:
        done = CliRunner().invoke(build("replay"), ["replay", "verify", str(session), *arguments])
        yield str(done.exit_code)
        yield done.output.rpartition(",")[0]

    assert list(said("--jobs", "2")) == list(said("--jobs", "1"))


def test_processes_are_others(recorded: Path) -> None:
    with processes(1) as pool:
        assert pool.submit(os.getpid).result() != os.getpid()
        assert judged(recorded, pool) == judged(recorded, None)


def test_processes_end_with_the_one_that_began_them() -> None:
    script = (
        "import os, sys\n"
        "from replay.compare.side_by_side import processes\n"
        "if __name__ == '__main__':\n"
        "    print(processes(1).submit(os.getpid).result(), flush=True)\n"
        "    sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as parent:
        assert parent.stdout is not None
        worker = os.pidfd_open(int(parent.stdout.readline()))
        parent.kill()
        ended, _, _ = select.select([worker], [], [], 60.0)
        os.close(worker)
    assert ended

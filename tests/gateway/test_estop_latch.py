"""The emergency stop on disk: set only if it cannot be ruled out, told only once it is there, never waited for."""

import errno
import json
import os
import signal
import subprocess
import sys
from datetime import datetime
from pathlib import Path
from threading import Event as Signal

import pytest

from gateway.cli.run import _state_directory
from gateway.config import parse
from gateway.edges import estop_latch
from gateway.edges.estop_gate import HOLD_NS, EstopGate, News
from gateway.edges.estop_latch import EstopFile, EstopLatch, Kept
from gateway.types import Event, Level
from tests.world import robot_text

WALL = "2026-03-01T12:00:00.000+00:00"
T0 = 5_000_000_000


@pytest.fixture
def file(tmp_path: Path) -> EstopFile:
    return EstopFile(tmp_path / "state" / "of" / "moby", "moby")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "state" / "of" / "moby" / "moby.estop"


# the file


def test_set_read_and_clear(file: EstopFile, path: Path) -> None:
    assert file.read() is None
    file.prepare()
    assert list(path.parent.iterdir()) == [], "the probe leaves nothing"
    file.set(wall=WALL, reason="emergency stop requested")
    assert json.loads(path.read_text()) == {"set_wall": WALL, "reason": "emergency stop requested"}
    assert path.stat().st_mode & 0o777 == 0o640
    kept = file.read()
    assert kept == Kept("emergency stop requested, set 2026-03-01T12:00:00+00:00, before this start", sound=True)
    file.clear()
    assert file.read() is None
    file.clear()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"[]",
        b"null",
        b"\xff\xfe",
        b'{"set_wall": "yesterday", "reason": ""}',
        b'{"set_wall": 5, "reason": ""}',
    ],
)
def test_a_malformed_file_counts_as_set(file: EstopFile, path: Path, content: bytes) -> None:
    file.prepare()
    path.write_bytes(content)
    kept = file.read()
    assert kept is not None
    assert not kept.sound
    assert "malformed" in kept.note
    file.clear()
    assert file.read() is None


def test_whatever_is_not_certainly_absent_counts_as_set(
    file: EstopFile, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file.prepare()
    path.mkdir()
    assert (kept := file.read()) is not None and "directory" in kept.note
    path.rmdir()
    path.symlink_to("nowhere")
    assert (kept := file.read()) is not None and "symbolic" in kept.note
    path.unlink()
    os.mkfifo(path)
    assert (kept := file.read()) is not None
    path.unlink()
    path.with_name("moby.estop.new").touch()
    assert (kept := file.read()) is not None and "being written" in kept.note
    path.with_name("moby.estop.new").unlink()
    assert file.read() is None
    for code in (errno.EACCES, errno.EIO, errno.ENOTDIR, errno.EMFILE):

        def refuse(*_: object, code: int = code) -> int:
            raise OSError(code, os.strerror(code))

        monkeypatch.setattr(os, "open", refuse)
        assert (kept := file.read()) is not None and os.strerror(code) in kept.note


def test_a_folder_that_is_a_file_counts_as_set(tmp_path: Path) -> None:
    (tmp_path / "state").touch()
    assert EstopFile(tmp_path / "state", "moby").read() is not None


STEPS = ("write", "fsync", "replace", "unlink")
KILLED = """
import os, signal, sys
from pathlib import Path
from gateway.edges import estop_latch
def die(*_, **__):
    os.kill(os.getpid(), signal.SIGKILL)
file = estop_latch.EstopFile(Path(sys.argv[1]), "moby")
file.prepare()
step = sys.argv[2]
if step == "unlink":
    file.set(wall="2026-03-01T12:00:00+00:00", reason="a test")
if step == "replace":
    Path.replace = die
elif step == "unlink":
    Path.unlink = die
elif step == "write":
    os.fchmod = die
else:
    os.fsync = die
file.clear() if step == "unlink" else file.set(wall="2026-03-01T12:00:00+00:00", reason="a test")
"""


@pytest.mark.parametrize("step", STEPS)
def test_killed_in_between_it_counts_as_set(file: EstopFile, path: Path, step: str) -> None:
    done = subprocess.run([sys.executable, "-c", KILLED, str(path.parent), step], check=False, timeout=60)
    assert done.returncode == -signal.SIGKILL
    assert file.read() is not None


def test_everything_is_synced_before_it_is_said_to_be_there(
    file: EstopFile, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Content, then name, then folder: a power cut after `set` finds the whole file."""
    file.prepare()
    steps: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def note_sync(descriptor: int) -> None:
        steps.append("folder" if Path(f"/proc/self/fd/{descriptor}").resolve() == path.parent else "content")
        fsync(descriptor)

    def note_replace(before: Path, after: Path) -> Path:
        steps.append("name")
        return replace(before, after)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(Path, "replace", note_replace)
    file.set(wall=WALL, reason="a test")
    assert steps == ["content", "name", "folder"]
    steps.clear()
    file.clear()
    assert steps == ["folder"]


# the latch


class FakeStore:
    """A disk that can hang (`gate`) or fail (`error`); `done` is set after every attempt."""

    def __init__(self, kept: Kept | None = None) -> None:
        self.kept = kept
        self.is_set = kept is not None
        self.error: OSError | None = None
        self.unwritable: OSError | None = None
        self.gate = Signal()
        self.gate.set()
        self.done = Signal()
        self.walls: list[str] = []

    def prepare(self) -> None:
        if self.unwritable is not None:
            raise self.unwritable

    def read(self) -> Kept | None:
        return self.kept

    def set(self, *, wall: str, reason: str) -> None:
        assert reason
        self.walls.append(wall)
        self._do(is_set=True)

    def clear(self) -> None:
        self._do(is_set=False)

    def _do(self, *, is_set: bool) -> None:
        assert self.gate.wait(10.0)
        try:
            if self.error is not None:
                raise self.error
            self.is_set = is_set
        finally:
            self.done.set()

    def attempt(self) -> None:
        assert self.done.wait(10.0)
        self.done.clear()


def settle(latch: EstopLatch) -> dict[str, object]:
    """What it says once its thread has ended."""
    latch.close(10.0)
    assert not latch._thread.is_alive()
    return latch.health()


ON_DISK = {"on_disk": True, "problem": None}
NOT_SET = {"on_disk": False, "problem": None}


def test_the_loop_is_not_held_up_by_a_disk_that_hangs() -> None:
    store = FakeStore()
    latch = EstopLatch(store)
    store.gate.clear()
    latch.want(stopped=True)
    assert latch.health() == NOT_SET
    store.gate.set()
    assert settle(latch) == ON_DISK
    assert store.is_set
    assert datetime.fromisoformat(store.walls[0]).tzinfo is not None


def test_the_last_wish_counts_and_a_removal_under_way_is_not_taken_for_a_stop_on_disk() -> None:
    store = FakeStore()
    latch = EstopLatch(store)
    latch.want(stopped=True)
    store.attempt()
    store.gate.clear()
    latch.want(stopped=False)
    store.gate.set()
    store.attempt()
    store.gate.clear()
    latch.want(stopped=True)
    assert not latch.on_disk
    store.gate.set()
    assert settle(latch) == ON_DISK
    assert store.is_set


def test_a_full_disk_is_told_tried_again_and_cleaned_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(estop_latch, "RETRY_S", 0.001)
    store = FakeStore()
    store.error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    latch = EstopLatch(store)
    latch.want(stopped=True)
    store.attempt()
    store.attempt()
    assert latch.problem == "the emergency stop is not on disk: No space left on device"
    assert not latch.on_disk
    store.error = None
    store.attempt()
    assert settle(latch) == ON_DISK


def test_one_that_is_being_removed_is_told_to_be_on_disk_until_it_is_gone() -> None:
    store = FakeStore(Kept("set yesterday", sound=True))
    latch = EstopLatch(store)
    store.gate.clear()
    latch.want(stopped=False)
    assert latch.health() == ON_DISK
    store.gate.set()
    assert settle(latch) == NOT_SET
    assert not store.is_set


def test_what_failed_half_way_is_removed_at_the_reset() -> None:
    store = FakeStore()
    store.error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    latch = EstopLatch(store)
    latch.want(stopped=True)
    store.attempt()
    store.error = None
    store.is_set = True  # the half of it
    latch.want(stopped=False)
    store.attempt()
    settle(latch)
    assert not store.is_set


def test_a_stop_that_cannot_be_removed_is_told() -> None:
    store = FakeStore(Kept("set yesterday", sound=True))
    latch = EstopLatch(store)
    assert latch.on_disk
    store.error = OSError(errno.EROFS, os.strerror(errno.EROFS))
    latch.want(stopped=False)
    store.attempt()
    settle(latch)
    assert latch.problem is not None
    assert "the next start will be in it: Read-only file system" in latch.problem


def test_an_assumed_stop_is_written_soundly() -> None:
    store = FakeStore(Kept("assumed", sound=False))
    latch = EstopLatch(store)
    store.attempt()
    assert settle(latch) == ON_DISK
    assert len(store.walls) == 1


def test_a_sound_one_is_left_as_it_is() -> None:
    store = FakeStore(Kept("set yesterday", sound=True))
    latch = EstopLatch(store)
    latch.want(stopped=True)
    assert settle(latch) == ON_DISK
    assert store.walls == []


def test_a_directory_that_cannot_be_written_is_told_at_start() -> None:
    store = FakeStore()
    store.unwritable = OSError(errno.EROFS, os.strerror(errno.EROFS))
    latch = EstopLatch(store)
    assert latch.health() == {
        "on_disk": False,
        "problem": "an emergency stop will not outlive a restart: Read-only file system",
    }
    settle(latch)


def test_a_latch_that_hangs_ends_in_bounded_time() -> None:
    store = FakeStore()
    latch = EstopLatch(store)
    store.gate.clear()
    latch.want(stopped=True)
    latch.close(0.01)
    store.gate.set()
    settle(latch)
    assert store.is_set


# what may be told


def news(cycle: int, code: str = "") -> News:
    events = (Event(Level.INFO, code, "text"),) if code else ()
    return News(T0 + cycle * 4_000_000, events=events)


def codes(told: list[News]) -> list[str]:
    return [event.code for item in told for event in item.events]


def test_nothing_is_told_of_a_stop_until_it_is_on_disk_and_then_everything_in_order() -> None:
    gate = EstopGate()
    assert codes(gate.step(news(0, "before"), stopped=False, on_disk=False, problem="an old one")) == ["before"]
    for cycle in range(1, 100):
        assert gate.step(news(cycle, f"cycle {cycle}"), stopped=True, on_disk=False, problem=None) == []
    told = gate.step(news(100, "cycle 100"), stopped=True, on_disk=True, problem=None)
    assert codes(told) == [f"cycle {cycle}" for cycle in range(1, 101)]
    assert codes(gate.step(news(101, "after"), stopped=True, on_disk=True, problem=None)) == ["after"]


def test_a_stop_that_does_not_reach_the_disk_is_told_with_that_fact() -> None:
    gate = EstopGate()
    first = news(0, "stop")
    assert gate.step(first, stopped=True, on_disk=False, problem=None) == []
    late = news(1)._replace(now_ns=first.now_ns + HOLD_NS - 1)
    assert gate.step(late, stopped=True, on_disk=False, problem=None) == []
    due = gate.step(late._replace(now_ns=first.now_ns + HOLD_NS), stopped=True, on_disk=False, problem=None)
    assert codes(due) == ["stop", "estop_not_on_disk"]
    assert codes(gate.step(news(999, "later"), stopped=True, on_disk=False, problem=None)) == ["later"], "told once"


def test_a_stop_that_fails_to_reach_the_disk_is_told_at_once_with_the_reason() -> None:
    gate = EstopGate()
    (due,) = gate.step(news(0, "stop"), stopped=True, on_disk=False, problem="no space")
    assert [event.text for event in due.events] == ["text", "no space"]


def test_each_stop_is_held_back_anew() -> None:
    gate = EstopGate()
    assert gate.step(news(0), stopped=True, on_disk=True, problem=None)
    assert gate.step(news(1), stopped=False, on_disk=False, problem=None)
    assert gate.step(news(2), stopped=True, on_disk=False, problem=None) == []
    assert len(gate.step(news(3), stopped=False, on_disk=False, problem=None)) == 2


def test_the_state_directory() -> None:
    config = parse(robot_text("moby"), "moby")
    assert _state_directory(None, config, {}) == Path("sessions")
    assert _state_directory(None, config, {"STATE_DIRECTORY": "/var/lib/a:/var/lib/b"}) == Path("/var/lib/a")
    assert _state_directory(Path("given"), config, {"STATE_DIRECTORY": "/var/lib/a"}) == Path("given")

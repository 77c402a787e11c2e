"""Incidents as the service sees them: kept beside a session or without one, told, and never in the way."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway.config import Incidents
from gateway.recording import recorder as recorder_module
from gateway.recording.disk import INCIDENTS
from gateway.recording.recorder import Recorder
from gateway.types import CycleTiming, Event, Level, Twist
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.gateway.test_recorder import PATIENCE_S, pid, settled, wait_for_end
from tests.incidents import MarkedWorld, short
from tests.recordings import STARTED_NS, stored

CHUNK = 100


class Robot:
    """A drive in virtual time that is put into a recorder, no faster than that can take it."""

    def __init__(self, directory: Path, *, marked: tuple[int, ...] = (), **recording: object) -> None:
        self.world = MarkedWorld("moby", marked)
        self.directory = directory
        config = stored(short(self.world.config, directory), directory, **recording)
        self.recorder = Recorder(config, self.world.text, "moby.toml")
        self.events: list[Event] = []
        self.put = 0

    def run(self, cycles: int) -> None:
        """Drive on to this cycle."""
        world, recorder = self.world, self.recorder
        while len(world.records) < cycles:
            world.cycle(commands=[world.command(Twist(0.0, 0.0, 0.0))] if len(world.records) % 5 == 0 else [])
            inputs, outputs = world.records[-1]
            recorder.put(inputs, outputs, CycleTiming(0, 0, STARTED_NS + inputs.now_ns), world.engine.snapshot)
            self.put += 1
            if self.put % CHUNK == 0:
                self.until(lambda: not recorder._backlog and recorder.alive)

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, (self.recorder.health(), self.events)
            if self.recorder._child is not None:
                self.recorder._child.wait_readable(0.05)
            self.events += self.recorder.poll()

    @property
    def health(self) -> dict[str, object]:
        found = self.recorder.health()["incidents"]
        assert isinstance(found, dict)
        return found

    def kept(self, count: int = 1) -> Path:
        """Wait for so many; the last one."""
        self.until(lambda: self.health["kept"] == count)
        return Path(str(self.health["file"]))

    def files(self) -> list[Path]:
        return sorted((self.directory / INCIDENTS).glob("*.rrd"))


@contextmanager
def robot(directory: Path, **recording: object) -> Iterator[Robot]:
    made = Robot(directory, **recording)  # type: ignore[arg-type]
    yield made
    made.recorder.close(PATIENCE_S)


@pytest.fixture(autouse=True)
def _at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "FIRST_BACKOFF_S", 0.0)


def test_beside_a_session(tmp_path: Path) -> None:
    with robot(tmp_path, marked=(700,)) as made:
        made.run(700)
        assert made.health == {"kept": 0, "failed": 0, "file": None, "error": None, "pending": False}
        made.run(800)
        path = made.kept()
        assert Event(Level.INFO, "incident", str(path)) in made.events
        assert made.recorder.error is None
        made.run(900)
    assert made.recorder.session is not None
    whole, piece = open_session(made.recorder.session), open_session(path)
    assert verify(whole).identical
    assert verify(piece).identical
    assert piece.header.cut_from == whole.path.name
    numbers = [inputs.cycle for inputs, _ in piece.cycles()]
    assert (numbers[0], numbers[-1]) == (501, 750)  # behind the state after 5 s, the last that is old enough
    assert list(piece.cycles()) == list(whole.cycles())[501:751]


def test_without_a_session(tmp_path: Path) -> None:
    with robot(tmp_path, marked=(700,), enabled=False) as made:
        assert made.recorder.session is None
        assert made.recorder.health()["session"] is None
        assert made.recorder.alive
        made.run(800)
        path = made.kept()
        assert made.recorder.dropped == 0
    assert [one.name for one in tmp_path.iterdir()] == [INCIDENTS]
    session = open_session(path)
    assert verify(session).identical
    assert session.header.cut_from is None


def test_without_a_directory_the_robot_drives_and_it_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with robot(tmp_path / "file", marked=(150,), enabled=False) as made:
        made.run(300)
        made.until(lambda: made.health["failed"] == 1)
        assert "file" in str(made.health["error"])
        assert [event.code for event in made.events] == ["incident_lost"]


def test_where_none_are_wanted_none_are_kept(tmp_path: Path) -> None:
    with robot(tmp_path, marked=(150,), incidents=Incidents(enabled=False)) as made:
        made.run(300)
        made.until(lambda: settled(made.recorder) == 300)
        assert made.recorder.health()["incidents"] is None
        assert made.events == []
    assert not (tmp_path / INCIDENTS).exists()


def test_a_full_disk_costs_neither_driving_nor_the_words(tmp_path: Path) -> None:
    with robot(tmp_path, marked=(150,), min_free=10**13) as made:
        made.run(300)
        made.until(lambda: made.health["failed"] == 1)
        assert str(made.health["error"]).startswith("an incident is not kept: disk full: ")
        made.run(400)
        assert made.recorder.alive
    assert made.files() == []


def test_a_killed_recorder_loses_what_it_was_collecting_and_says_so(tmp_path: Path) -> None:
    with robot(tmp_path, marked=(680, 820)) as made:
        made.run(700)
        made.until(lambda: bool(made.health["pending"]))
        os.kill(pid(made.recorder), signal.SIGKILL)
        made.until(lambda: made.recorder._child is None)
        made.until(lambda: made.recorder._child is not None)
        (lost,) = [event for event in made.events if event.code == "incident_lost"]
        assert lost.text == "an incident may not be kept: the recorder process ended (exit code -9)"
        made.run(900)
        path = made.kept()
        assert made.health["failed"] == 1
    assert made.files() == [path]
    session = open_session(path)
    # A state of the core was asked for at once: behind what the dead process had not confirmed all can be compared.
    verdict = verify(session)
    assert verdict.exit_code in {0, 3}
    assert verdict.first_difference is None
    numbers = [inputs.cycle for inputs, _ in session.cycles()]
    assert numbers[-1] == 870
    assert verdict.cycles >= numbers[-1] - 720


def test_the_end_of_the_drive_ends_the_window(tmp_path: Path) -> None:
    with robot(tmp_path, marked=(700,)) as made:
        made.run(720)
        assert made.files() == []
    path = until_there(made)
    session = open_session(path)
    assert verify(session).identical
    assert [inputs.cycle for inputs, _ in session.cycles()][-1] == 719


def until_there(made: Robot) -> Path:
    """What writes it outlives the recorder."""
    deadline = time.monotonic() + 3 * PATIENCE_S
    while not made.files():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return made.files()[0]


_DOOMED_SERVICE = """
import os, signal, sys
from pathlib import Path
from tests.gateway.test_recorder import pid
from tests.gateway.test_recorder_incidents import Robot
made = Robot(Path(sys.argv[1]), marked=(690,), enabled=False)
made.run(700)
print(pid(made.recorder), flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_service_leaves_the_incident_that_was_collected(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _DOOMED_SERVICE, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    wait_for_end(int(done.stdout))
    made = Robot.__new__(Robot)
    made.directory = tmp_path
    session = open_session(until_there(made))
    assert verify(session).identical
    assert [inputs.cycle for inputs, _ in session.cycles()][-1] == 699

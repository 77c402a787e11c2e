"""Who follows a robot with a viewer: restarts, silence, another version, and a viewer that does not read."""

import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest
import rerun as rr
import rerun.blueprint as rrb
from typer.testing import CliRunner

from gateway.cli import look as look_module
from gateway.cli import viewer as viewer_module
from gateway.cli.app import build
from gateway.cli.look import Follower
from gateway.cli.parts import MissingPartError
from gateway.cli.viewer import LOOPBACK, LiveViewer, ViewerError, free_port
from gateway.client import Client
from gateway.core.samples import Sampler
from gateway.edges.live_view import VIEW_SCHEMA, Batch, encode_batch
from gateway.edges.zenoh_link import ZenohLink
from tests.drawn import Drawn, drawn
from tests.drives import drive
from tests.gateway.test_zenoh_link import TIMEOUT_S, eventually
from tests.gateway.test_zenoh_link import _robot as robot
from tests.recordings import robot_text


class Stand:
    """A follower whose recordings are files, and the link of a robot that it follows."""

    def __init__(self, folder: Path, endpoint: str) -> None:
        self.said: list[str] = []
        self.files: list[Path] = []
        self._folder = folder
        self._endpoint = endpoint
        self.link = self.robot()
        self.client = Client("moby", connect=[endpoint])
        assert self.client.wait_alive(TIMEOUT_S)
        self.follower = Follower(self.client, self._opens, self.said.append)

    def robot(self, text: str | None = None) -> ZenohLink:
        """A run of its service."""
        self._records = drive(10**6)
        return ZenohLink(robot(self._endpoint), robot_text() if text is None else text)

    def cycle(self) -> None:
        record = next(self._records)
        self.link.show(record.inputs, record.outputs, record.timing)

    def until_drawn(self) -> None:
        """Until one more batch was taken and drawn."""

        def took() -> bool:
            self.cycle()
            waiting = list(self.follower._waiting.queue)
            if waiting:
                self.follower.draw_next()
            return any(isinstance(one, bytes) for one in waiting)

        eventually(took)

    def drawn(self, number: int) -> Drawn:
        """What is in a recording, which ends with this."""
        if self.follower._recording is not None:
            self.follower._recording.close()
        return drawn([self.files[number]])

    def _opens(self, recording: rr.RecordingStream, layout: rrb.Blueprint) -> None:
        self.files.append(self._folder / f"{len(self.files)}.rrd")
        recording.save(self.files[-1], default_blueprint=layout)


@pytest.fixture
def stand(tmp_path: Path, free_port: int) -> Iterator[Stand]:
    stand = Stand(tmp_path, f"tcp/127.0.0.1:{free_port}")
    yield stand
    stand.client.close()
    stand.link.close()


def test_a_robot_that_is_restarted_is_a_new_recording(stand: Stand) -> None:
    stand.until_drawn()
    stand.until_drawn()
    stand.link.close()
    stand.link = stand.robot(robot_text().replace("# MOBY", "# another MOBY"))
    stand.until_drawn()
    assert stand.said == ["looking at moby", "moby was restarted"]
    first, second = stand.drawn(0), stand.drawn(1)
    assert "# another MOBY" in repr(second["/config"])
    assert "# another MOBY" not in repr(first["/config"])
    assert len(first["/trace/pose"]) > 2


def test_silence_is_said_once_and_its_end_too(stand: Stand, monkeypatch: pytest.MonkeyPatch) -> None:
    def told(text: str) -> bool:
        stand.follower.mind()
        return text in stand.said

    monkeypatch.setattr(look_module, "SILENT_S", 0.3)
    eventually(lambda: told("moby answers and shows nothing: its software is older, or moby/view is not allowed to us"))
    stand.until_drawn()
    stand.follower.mind()
    assert stand.said[1:] == ["looking at moby", "moby is heard again"]
    stand.follower.draw_next()
    eventually(lambda: told("moby is silent"))
    stand.follower.draw_next()
    stand.follower.mind()
    stand.link.close()
    eventually(lambda: not stand.client.alive)
    stand.link = stand.robot()
    eventually(lambda: stand.client.alive)
    stand.until_drawn()
    stand.follower.mind()
    stand.follower.draw_next()
    assert stand.said[3:] == ["moby is silent", "moby was restarted", "moby is heard again"]
    assert "view: moby is silent" in repr(stand.drawn(0)["/trace/events"])
    assert "view: moby is heard again" in repr(stand.drawn(1)["/trace/events"])


def test_a_robot_that_is_gone_is_said(stand: Stand, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(look_module, "SILENT_S", 0.0)
    stand.link.close()
    eventually(lambda: not stand.client.alive)
    stand.follower.mind()
    assert stand.said == ["moby is gone: waiting for it"]


def test_another_version_of_the_software_is_refused_in_words_and_once(stand: Stand) -> None:
    payload = msgspec.msgpack.encode((VIEW_SCHEMA + 1, "of tomorrow", "run", []))
    for _ in range(3):
        stand.link._session.put("moby/view", payload)
        stand.follower.draw_next()
    (said,) = stand.said
    assert said.startswith("moby: the robot's software is another version: 'of tomorrow'")
    stand.until_drawn()
    assert stand.said[1:] == ["looking at moby"]


def test_what_cannot_be_drawn_is_said_and_the_rest_is_drawn(stand: Stand) -> None:
    stand.until_drawn()
    (record,) = drive(1)
    trace = record.outputs.trace._replace(wheel_positions=(), wheel_speeds=(1.0,))
    sample = Sampler().step(record.inputs, record.outputs._replace(trace=trace), record.timing)
    assert sample is not None
    stand.link._session.put("moby/view", encode_batch(Batch(stand.link._view._run, (sample,))))

    def told() -> bool:
        stand.follower.draw_next()
        return len(stand.said) > 1

    eventually(told)
    assert stand.said[1].startswith("moby: cannot be drawn: ")
    stand.until_drawn()
    assert len(stand.said) == 2


def test_a_robot_file_that_is_not_of_this_software_is_said(stand: Stand) -> None:
    stand.until_drawn()
    stand.link.close()
    stand.link = stand.robot(robot_text() + "\n[tomorrow]\n")
    stand.until_drawn()
    stand.until_drawn()
    assert stand.said[0] == "looking at moby"
    (said,) = stand.said[1:]
    assert "moby/config" in said
    assert "tomorrow" in said


def test_a_viewer_that_does_not_read_holds_up_nothing_but_its_drawing(stand: Stand) -> None:
    """Nobody draws here: one batch waits, some wait in the ring, the rest is dropped; neither side minds."""

    def waits() -> bool:
        stand.cycle()
        return not stand.follower._waiting.empty()

    eventually(waits)
    begun = stand.link._view._sampler
    for _ in range(2000):
        stand.cycle()
    stand.follower.mind()
    assert stand.link._view._sampler is begun is not None
    stand.client.close()
    assert not stand.client.alive


@pytest.mark.parametrize("options", [["--web"], ["--viewer", "--json"], ["--viewer", "--once"]])
def test_options_that_do_not_go_together(options: list[str]) -> None:
    found = CliRunner().invoke(build("watch"), ["watch", "moby", *options])
    assert found.exit_code == 2
    assert "--viewer" in found.output


def test_a_viewer_that_is_not_there_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer_module, "_program", lambda: tmp_path / "rerun")
    with pytest.raises(MissingPartError, match="not installed"):
        LiveViewer()
    found = CliRunner().invoke(build("watch"), ["watch", "moby", "--viewer"])
    assert isinstance(found.exception, MissingPartError), "whether there is a robot is another question"
    (tmp_path / "rerun").symlink_to("/bin/false")
    with pytest.raises(ViewerError, match="ended with exit code"):
        LiveViewer()


def test_a_port_that_is_taken_is_left_alone() -> None:
    with socket.socket() as taken:
        taken.bind((LOOPBACK, 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert free_port(port) != port
    assert free_port(port) == port
    assert free_port(port, other_than=port) != port


def test_where_another_was_quicker_to_take_a_port_it_takes_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "rerun"
    tried = tmp_path / "tried"
    program.write_text(f'#!/bin/sh\n[ -e {tried} ] && exec {viewer_module._program()} "$@"\ntouch {tried}\nexit 1\n')
    program.chmod(0o755)
    monkeypatch.setattr(viewer_module, "_program", lambda: program)
    with LiveViewer(web=True) as viewer:
        assert viewer.url.rpartition(":")[2] != f"{viewer_module.DATA_PORT}/proxy"
        assert viewer.wait(0.0)


def test_a_viewer_takes_a_recording_and_is_ended() -> None:
    with LiveViewer(web=True) as viewer:
        assert viewer.page is not None
        assert viewer.page.startswith("http://127.0.0.1:")
        assert listening(viewer.pid) == {LOOPBACK}
        assert viewer.wait(0.0)
    assert not viewer.wait(0.0)


def listening(pid: int) -> set[str]:
    """Addresses on which a process listens (IPv4)."""
    own = set()
    for path in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            own.add(str(path.readlink()))
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and f"socket:[{fields[9]}]" in own:
                address = bytes.fromhex(fields[1].partition(":")[0])
                found.add(socket.inet_ntoa(address[::-1]) if table == "tcp" else address.hex())
    return found

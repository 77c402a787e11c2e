"""Sessions behind a URL: what is told of them is what is told of the same ones on this disk."""

import functools
import http.server
import json
import shutil
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem
from typer.testing import CliRunner, Result

from gateway.cli.app import build
from replay.compare.fleet import Judged, judged
from replay.compare.verify import Verdict, verify
from replay.sessions.folders import sessions
from replay.sessions.reader import Session
from replay.sessions.remote import local, place
from tests.replay import test_cluster, test_fleet

fleet, scheduler = test_fleet.fleet, test_cluster.scheduler
WHERE = "memory://bucket/fleet"


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Nothing."""


@pytest.fixture(scope="module")
def web(fleet: Path) -> Iterator[str]:
    """The fleet on a web server of this machine."""
    handler = functools.partial(_Quiet, directory=str(fleet))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def memory(fleet: Path) -> Iterator[str]:
    """The fleet in an object storage that is in this process."""
    fsspec.filesystem("memory").put(f"{fleet}/", "/bucket/fleet", recursive=True)
    yield WHERE
    MemoryFileSystem.store.clear()
    MemoryFileSystem.pseudo_dirs[:] = [""]


@pytest.fixture(params=["memory", "file", "http"])
def url(request: pytest.FixtureRequest, fleet: Path) -> str:
    """The same fleet by each scheme."""
    if request.param == "file":
        return fleet.as_uri()
    found: str = request.getfixturevalue("memory" if request.param == "memory" else "web")
    return found


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where sessions are fetched to."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def run(command: str, *words: object) -> Result:
    return CliRunner().invoke(build("replay"), ["replay", command, *map(str, words)])


def comparable(found: Judged, base: str) -> dict[str, object]:
    """Without where it was and how long it took."""
    told = json.dumps(found.as_json() | {"realtime_ratio": None})
    document: dict[str, object] = json.loads(told.replace(base, "here"))
    return document


def document(*words: object, base: str) -> dict[str, object]:
    told: dict[str, object] = json.loads(run("verify", *words, "--json").stdout.replace(base, "here"))
    for one in told["sessions"]:  # type: ignore[attr-defined]
        del one["realtime_ratio"]
    return told


def test_the_same_sessions_are_found(fleet: Path, url: str) -> None:
    here = [str(found).replace(str(fleet), "") for found in sessions([fleet])]
    assert len(here) == 5
    assert [str(found).replace(url, "") for found in sessions([url])] == here
    (one,) = sessions([f"{url}{here[0]}"])
    assert one == f"{url}{here[0]}"


def test_the_verdicts_are_the_same_and_nothing_is_left(fleet: Path, url: str, scratch: Path) -> None:
    here = [comparable(judged(one), str(fleet)) for one in sessions([fleet])]
    assert [one["exit_code"] for one in here] == [0, 0, 1, 3, 2]
    assert [comparable(judged(one), url) for one in sessions([url])] == here
    assert list(scratch.iterdir()) == []


def test_a_single_segment_is_held_against_what_was_noted_beside_it(fleet: Path, url: str) -> None:
    (whole,) = sessions([fleet / "robots" / "a"])
    segment = f"{str(whole).replace(str(fleet), '')}/segment-00001.rrd"
    with local(f"{url}{segment}") as path:
        assert sorted(one.name for one in path.parent.iterdir()) == ["SHA256SUMS", "segment-00001.rrd"]
    assert comparable(judged(f"{url}{segment}"), url) == comparable(judged(place(f"{fleet}{segment}")), str(fleet))


def test_only_one_session_is_on_the_disk_at_a_time(fleet: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []

    def watched(session: Session) -> Verdict:
        seen.append(len(list(scratch.rglob("segment-*.rrd"))))
        return verify(session)

    monkeypatch.setattr("replay.compare.fleet.verify", watched)
    found = [judged(one) for one in sessions([fleet.as_uri()])]
    assert len(found) == 5
    assert set(seen) == {1}


def test_the_command_is_the_same_over_the_network_and_in_processes(fleet: Path, web: str) -> None:
    here = document(fleet, "--jobs", 1, base=str(fleet))
    assert document(web, "--jobs", 1, base=web) == here
    assert document(web, "--jobs", 2, base=web) == here


def test_workers_of_a_cluster_fetch_for_themselves(fleet: Path, web: str, scheduler: str) -> None:
    assert document(web, "--scheduler", scheduler, base=web) == document(fleet, "--jobs", 1, base=str(fleet))


@pytest.mark.parametrize(
    ("command", "more"), [("info", ()), ("info", ("--json",)), ("trace", ()), ("can", ()), ("verify", ("--json",))]
)
@pytest.mark.parametrize("letter", ["a", "d"])
def test_whatever_reads_one_session_reads_it_there(
    fleet: Path, url: str, command: str, more: tuple[str, ...], letter: str
) -> None:
    (here,) = sessions([fleet / "robots" / letter])
    there = f"{url}{str(here).replace(str(fleet), '')}"
    one, other = run(command, here, *more), run(command, there, *more)
    assert one.exit_code == other.exit_code == (0 if letter == "a" else 3)
    if command == "verify":
        told = [json.loads(done.stdout) | {"realtime_ratio": None} for done in (one, other)]
        assert told[0] == told[1]
    else:
        assert other.stdout == one.stdout
    assert other.stderr.replace(url, "") == one.stderr.replace(str(fleet), "")


def test_two_of_them_are_held_against_each_other(fleet: Path, web: str) -> None:
    (one,), (other,) = sessions([f"{web}/robots/a"]), sessions([fleet / "robots" / "b"])
    assert run("diff", one, other).exit_code == 0


# what goes wrong


def test_without_the_package_its_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    done = run("verify", WHERE)
    assert done.exit_code == 2
    assert f"{WHERE}: needs the package `fsspec`: pip install 'drivegate[fleet]'" in done.output


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ("s3://bucket/robots", "s3fs"),
        ("nowhere://bucket", "Protocol not known: nowhere"),
        ("memory://bucket/none", "there is no such file or folder"),
        ("memory://bucket/none.rrd", "there is no such file or folder"),
        ("file:///not/there", "there is no such file or folder"),
        ("http://127.0.0.1:9/robots", "127.0.0.1:9"),
    ],
)
@pytest.mark.parametrize("command", ["verify", "info"])
def test_what_cannot_be_had_is_said(command: str, where: str, words: str) -> None:
    done = run(command, where)
    assert done.exit_code == 2
    assert f"{where}: " in done.output.replace("\n", "")
    assert words in done.output.replace("\n", " ")


def test_in_a_fleet_it_is_a_line(fleet: Path, memory: str) -> None:
    done = run("verify", memory, "s3://bucket/robots", fleet.as_uri(), "--jobs", 1, "--json")
    told = json.loads(done.stdout)
    assert [one["exit_code"] for one in told["sessions"]] == [0, 0, 1, 3, 2, 2, 0, 0, 1, 3, 2]
    assert "s3fs" in told["sessions"][5]["problem"]


def test_what_has_no_segment_is_no_session(memory: str) -> None:
    fsspec.filesystem("memory").pipe("/bucket/notes/read.me", b"nothing")
    assert run("info", "memory://bucket/notes").exit_code == 2
    assert str(judged("memory://bucket/notes").verdict.problem).startswith("memory://bucket/notes: not a session: ")
    assert len(sessions(["memory://bucket"])) == len(sessions([memory]))


def test_a_download_that_was_cut_is_no_verdict_on_the_recording(memory: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def cut(self: MemoryFileSystem, path: str, target: str) -> None:
        Path(target).write_bytes(self.cat_file(path)[:-1])

    monkeypatch.setattr(MemoryFileSystem, "get_file", cut)
    (first, *_) = sessions([memory])
    found = judged(first)
    assert found.verdict.exit_code == 2
    assert " bytes of " in str(found.verdict.problem)


def test_what_does_not_fit_on_the_disk_is_not_fetched(
    memory: str, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(scratch)
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage._replace(free=1000))
    found = judged(sessions([memory])[0])
    assert found.verdict.exit_code == 2
    assert f"MB in {scratch}, where 0.0 MB are free" in str(found.verdict.problem)

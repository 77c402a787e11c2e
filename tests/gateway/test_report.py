"""`drivegate report`: an archive that has all it should, names what is missing, and in no byte has a planted secret."""

import errno
import json
import os
import stat
import subprocess
import sys
import zipfile
from pathlib import Path

import msgspec
import pytest

from gateway import robot_files
from gateway.cli import report_parts
from gateway.cli.report import _Archive, _write
from gateway.cli.report_parts import MissingError, Source, bounded, newest_incidents, source
from gateway.core.settings import LIMITING
from gateway.recording.bundle import kept
from replay.compare.verify import verify
from replay.sessions.reader import open_session
from replay.sharing.incident import texts
from replay.sharing.redaction import Redaction
from tests.e2e.robot_process import RobotProcess
from tests.incidents import MarkedWorld, orders, short, with_snapshots

B64 = "Zm9vYmFyYmF6cXV4MTIzNDU2Nzg5MEFCQ0RFRkdISUpLTA=="
# One of its own in each place, so that it is seen which one got through.
SECRETS = {
    "robot file": "hunter-in-file",
    "endpoint": "hunter-in-endpoint",
    "zenoh password": "hunter-in-zenoh",
    "zenoh comment": "hunter-in-comment",
    "zenoh key": B64,
    "log": "hunter-in-log",
    "log url": "hunter-in-url",
    "origin of an incident": "carol",
    "host of an incident": "far-off-host",
    "user": "alice",
    "home": "/srv/people",
}
ZENOH = """{
  // password: hunter-in-comment
  mode: "peer",
  transport: {
    auth: { usrpwd: { user: "joe", password: "hunter-in-zenoh" } },
    link: { tls: { connect_private_key_base64: "KEY" } },
  },
}""".replace("KEY", B64)
LOG = """2026-09-21T14:13:20+00:00 drivegate: alice logged in with hunter-in-zenoh, carol did not
2026-09-21T14:13:21+00:00 drivegate: token=hunter-in-log tcp/x:hunter-in-url@10.0.0.1:7447 /home/carol/x
"""


@pytest.fixture(scope="module")
def planted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a robot file, the configuration of Zenoh, an incident, and programs of its own."""
    folder = tmp_path_factory.mktemp("planted")
    world = MarkedWorld("omni4", [150])
    world.drive(250)
    config = short(world.config, folder / "sessions")
    text = world.text.replace("[zenoh]", f'[zenoh]\nconfig_file = "{folder}/zenoh.json5"')
    text = text.replace("[zenoh]", '[zenoh]\nconnect = ["tcp/joe:hunter-in-endpoint@10.0.0.1:7447"]')
    text = text.replace("[recording]", f'[recording]\ndirectory = "{folder}/sessions"') + "# password: hunter-in-file\n"
    if "[recording]" not in text:
        text += f'[recording]\ndirectory = "{folder}/sessions"\n'
    (folder / "omni4.toml").write_text(text, encoding="utf-8")
    (folder / "zenoh.json5").write_text(ZENOH, encoding="utf-8")
    (order,) = orders(world, config, with_snapshots(config, world.packets, (40, 120)))
    hello = order.hello._replace(config_text=text, config_origin="/home/carol/omni4.toml")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gateway.recording.header.socket.gethostname", lambda: "far-off-host")
        assert kept(msgspec.structs.replace(order, hello=hello)).file
    programs = folder / "bin"
    programs.mkdir()
    (programs / "journalctl").write_text(f"#!/bin/sh\ncat <<'END'\n{LOG}END\n", encoding="utf-8")
    (programs / "journalctl").chmod(0o755)
    return folder


def reported(*arguments: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gateway", "report", *arguments],
        env=os.environ | {"USER": "alice", "HOME": "/srv/people/alice"} | environment,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=110,
        check=False,
    )


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def places_of_secrets(path: Path) -> list[tuple[str, str]]:
    """Which secrets are where: in the bytes of the archive, of its members, and in every text of an incident."""
    found = [("the archive", path.read_bytes()), ("names", "\n".join(members(path)).encode())]
    for name, data in members(path).items():
        found.append((name, data))
        if name.endswith(".rrd"):
            unpacked = path.with_suffix(".rrd")
            unpacked.write_bytes(data)
            found += [(name, text.encode()) for text in texts(open_session(unpacked))]
            found += [(name, state) for state in open_session(unpacked).snapshots.values()]
    return [(what, where) for what, secret in SECRETS.items() for where, data in found if secret.encode() in data]


def test_no_planted_secret_is_in_any_byte(planted: Path, tmp_path: Path) -> None:
    path = tmp_path / "report.zip"
    done = reported(
        str(planted / "omni4.toml"),
        "-o",
        str(path),
        "--json",
        folder=tmp_path,
        PATH=f"{planted}/bin:{os.environ['PATH']}",
    )
    assert done.returncode == 0, done.stderr
    assert places_of_secrets(path) == []
    told = json.loads(done.stdout)
    there = members(path)
    assert {one["name"]: one["bytes"] for one in told["members"]} == {name: len(data) for name, data in there.items()}
    incidents = [name for name in there if name.startswith("incidents/")]
    expected = {"robot.toml", "software.json", "doctor.json", "service.log", "zenoh.json", "README.txt"}
    assert set(there) == expected | set(incidents)
    assert len(incidents) == 1
    assert told["bytes"] == path.stat().st_size
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert b"somebody logged in with REDACTED, somebody did not" in there["service.log"]
    assert json.loads(there["zenoh.json"])["mode"] == "peer"
    assert json.loads(there["doctor.json"])["findings"]
    assert json.loads(there["software.json"])["packages"]["numpy"]
    (tmp_path / "incident.rrd").write_bytes(there[incidents[0]])
    assert verify(open_session(tmp_path / "incident.rrd")).identical
    readme = there["README.txt"].decode()
    assert list(told["missing"]) == ["state.json"]
    for name in [*there, "state.json: omni4 does not answer", "firmware"]:
        assert name in readme or name == "README.txt"


def test_with_nothing_but_a_wrong_robot_file(tmp_path: Path) -> None:
    """Each part that is not there is named, and why."""
    (tmp_path / "odd robot.toml").write_text('name = "x', encoding="utf-8")
    (tmp_path / "bin").mkdir()
    done = reported("odd robot.toml", "-o", "report.zip", folder=tmp_path, PATH=str(tmp_path / "bin"))
    assert done.returncode == 0, done.stderr
    there = members(tmp_path / "report.zip")
    assert set(there) == {"robot.toml", "software.json", "README.txt"}
    readme = there["README.txt"].decode()
    for words in (
        *(
            "zenoh.json: the robot file names no zenoh.config_file",
            "doctor.json: python",
            "there is no journalctl here",
        ),
        *("state.json: no robot file that tells", "incidents: no robot file that tells"),
    ):
        assert words in readme
        assert words in done.stdout
    again = reported("odd robot.toml", "-o", "report.zip", folder=tmp_path)
    assert again.returncode == 1
    assert "the report is not written: report.zip: File exists" in again.stderr
    assert members(tmp_path / "report.zip") == there


def test_what_is_no_robot_file(tmp_path: Path) -> None:
    done = reported("nobody", folder=tmp_path)
    assert done.returncode == 78
    assert "no such robot file" in done.stderr
    gone = reported("gone.toml", folder=tmp_path)
    assert gone.returncode == 1
    assert gone.stderr == "gone.toml: No such file or directory\n"
    assert list(tmp_path.iterdir()) == []


def test_of_a_running_robot(tmp_path: Path) -> None:
    """Its state and the robot file in use are there; it drives on as before."""
    with RobotProcess("omni4", tmp_path, 7487) as robot:
        file = tmp_path / "other.toml"
        text = robot_files.bundled()["omni4"].read_text(encoding="utf-8").replace("7448", "7487")
        file.write_text(text + "# another one\n", encoding="utf-8")
        robot.start()
        done = reported(str(file), "-o", "report.zip", folder=tmp_path)
        assert done.returncode == 0, done.stderr
        there = members(tmp_path / "report.zip")
        state = json.loads(there["state.json"])
        assert state["mode"] in {"drive", "stopping", "idle"}
        assert [one["name"] for one in state["settings"]] == list(LIMITING)
        assert there["robot.toml"].endswith(b"# another one\n")
        assert b"# another one" not in there["running-robot.toml"]
        robot.start()


def test_a_part_in_which_something_is_left_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the redaction overlooks that was found elsewhere."""
    monkeypatch.setattr(Redaction, "again", lambda _self, text: text)
    archive = _Archive(Source(None, None, None, ours=False))
    for name, text in (
        ("robot.toml", 'password = "hunter-in-file"'),
        ("service.log", "hunter-in-file"),
        ("doctor.json", "{}"),
    ):
        archive._texts[name] = text
    path = tmp_path / "report.zip"
    assert set(archive.write(path, "now")) == {"doctor.json", "README.txt"}
    assert archive.missing["service.log"] == "something that was taken out of another part could not be taken out of it"
    assert places_of_secrets(path) == []


def test_an_archive_that_cannot_be_written_whole_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("gateway.cli.report.os.fchmod", full)
    path = tmp_path / "report.zip"
    with pytest.raises(OSError, match="No space left"):
        _write(path, {"robot.toml": b""})
    assert not path.exists()


def test_a_computer_called_as_its_robot_keeps_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_parts, "hosts", lambda: {"moby", "moby.lan"})
    archive = _Archive(source(robot_files.find_bundled("moby"), ours=False))
    assert archive._redaction.text('name = "moby" on moby.lan') == 'name = "moby" on somewhere'


def test_of_a_long_part_the_end_is_taken() -> None:
    data = b"a" * report_parts.MOST_TEXT + b"end"
    assert bounded(data)[-3:] == b"end"
    assert len(bounded(data)) == report_parts.MOST_TEXT


def test_the_newest_incidents_come_first(planted: Path) -> None:
    found = source(planted / "omni4.toml", ours=False)
    folder = planted / "sessions" / "incidents"
    newer = folder / "omni4-19700101T000000Z-fault-12.rrd"  # by its number, whatever the clock said
    newer.write_bytes(b"")
    try:
        assert newest_incidents(found, None)[0] == newer
    finally:
        newer.unlink()
    with pytest.raises(MissingError, match="none in "):
        newest_incidents(found._replace(ours=True), None)

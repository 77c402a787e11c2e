"""With what the commands end for a bad file, for what is not there, and for a wrong option: one row for each.

78 (EX_CONFIG): a file that somebody has to mend, also one that is missing; systemd does not restart into it.
69 (EX_UNAVAILABLE): what may be there later: a robot, a bus, an address, a directory.
2: a wrong option, and of `replay` what cannot be answered. 1: not as hoped, or refused.
"""

import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.cli import app, operate
from tests.world import ROBOTS, robot_text

SESSION = str(Path(__file__).parents[1] / "sessions" / "v1-omni4")
OMNI4 = str(ROBOTS / "omni4.toml")
NOBODY = ("--connect", "tcp/127.0.0.1:1")

# What is wrong with a file, and how it is told.
BAD = {
    "missing.toml": "missing.toml: cannot be read: No such file or directory",
    "folder.toml": "folder.toml: cannot be read: Is a directory",
    "broken.toml": "broken.toml: not valid TOML",
    "binary.toml": "binary.toml: cannot be read: 'utf-8'",
    "wrong.toml": "wrong.toml: y = 1: unknown key",
}
# Every command that reads a file, with FILE in its place.
READING = [
    ("check", "FILE"),
    ("run", "FILE"),
    ("run", "FILE", "--simulate"),
    ("run", OMNI4, "--simulate", "--script", "FILE"),
    ("sim", "FILE", "--channel", "vcan9"),
    ("doctor", "FILE"),
    ("drive", "FILE"),
    ("send", "FILE"),
    ("watch", "FILE"),
    ("events", "FILE"),
    ("stop", "FILE"),
    ("set", "FILE", "speed_override", "1"),
    ("mark", "FILE", "words"),
    ("reference", "FILE"),
    ("stand", "FILE", "up"),
    ("fault", "FILE", "clear"),
    ("fault", "omni4", "--script", "FILE"),
    ("path", "FILE", "omni4"),
    ("path", str(ROBOTS.parent / "paths" / "omni4_square.toml"), "FILE", "--check"),
    ("scenario", "FILE"),
    ("calibrate", "slip", "FILE", "--surface", "lino"),
    ("setup", "scan", "can0", "--file", "FILE"),
    ("setup", "jog", "FILE", "front_left"),
    ("setup", "directions", "FILE"),
    ("setup", "reference", "FILE"),
    ("setup", "prepare", "FILE"),
    ("setup", "tune", "FILE", "front_left"),
    ("setup", "calibrate", "FILE"),
    ("setup", "covariance", "FILE"),
    ("replay", "inject", SESSION, "FILE"),
]
ROWS = [
    # A person's word for a fault is a line of a script.
    (78, ("run", OMNI4, "--simulate", "--fault", "encoder_freeze@1"), "did you mean 'encoder_frozen'?"),
    (78, ("run", OMNI4, "--simulate", "--fault", "power_off:left"), "motor = 'left': there is front_left"),
    (78, ("fault", "omni4", "frames_lost=3"), "value = 3.0: must be a fraction, 0 to 1"),
    (78, ("replay", "inject", SESSION, "--fault", "nope"), "must be KIND@SECONDS"),
    # Zenoh's own file is named in the robot file.
    (78, ("run", "zenoh.toml", "--simulate", "--endpoint", "tcp/127.0.0.1:0"), "zenoh.json5: line 1, column 9"),
    (78, ("run", "nozenoh.toml", "--simulate", "--endpoint", "tcp/127.0.0.1:0"), "zenoh.config_file = nowhere.json5"),
    (78, ("setup", "new", "new.toml", "--answers", "missing.toml"), "cannot be read"),
    (78, ("setup", "new", "new.toml", "--answers", "broken.toml"), "not valid TOML"),
    # What came with the package is nobody's to correct.
    *(
        (78, ("setup", *words), "omni4: is bundled and stays as it is; correct a copy of it: cp ")
        for words in (
            ("prepare", "omni4"),
            ("directions", "omni4"),
            ("reference", "omni4"),
            ("tune", "omni4", "front_left"),
            ("calibrate", "omni4"),
            ("covariance", "omni4"),
        )
    ),
    # Nobody, nothing, no room.
    (69, ("send", "omni4", *NOBODY), "omni4 does not answer on tcp/127.0.0.1:1"),
    (69, ("watch", "omni4", *NOBODY, "--json"), "omni4 does not answer"),
    (69, ("events", "omni4", *NOBODY), "omni4 does not answer"),
    (69, ("stop", "omni4", *NOBODY), "omni4 does not answer"),
    (69, ("set", "omni4", "speed_override", "1", *NOBODY), "omni4 does not answer"),
    (69, ("mark", "omni4", "words", *NOBODY), "omni4 does not answer"),
    (69, ("fault", "omni4", "clear", *NOBODY), "omni4 does not answer"),
    (69, ("reference", "moby", *NOBODY), "moby does not answer"),
    (69, ("path", str(ROBOTS.parent / "paths" / "omni4_square.toml"), "omni4", *NOBODY), "omni4 does not answer"),
    (69, ("setup", "scan", "nocan0"), "socketcan nocan0: No such device"),
    *(
        (69, ("setup", *words), "socketcan nocan0: No such device")
        for words in (
            ("id", "nocan0", "c620"),
            ("jog", "nocan.toml", "front_left"),
            ("tune", "nocan.toml", "front_left"),
            ("directions", "nocan.toml"),
            ("prepare", "nocan.toml"),
            ("reference", "nocan_steered.toml"),
        )
    ),
    (69, ("run", OMNI4, "--simulate", "--endpoint", "ADDRESS IN USE"), "Address already in use"),
    (69, ("run", OMNI4, "--simulate", "--out", "plain/x", "--endpoint", "tcp/127.0.0.1:0"), "Not a directory"),
    # A wrong option.
    (2, ("send", "omni4", "--connect", "nonsense"), "must be a protocol and an address"),
    (2, ("run", OMNI4, "--simulate", "--endpoint", "nonsense"), "must be a protocol and an address"),
    (2, ("sim", OMNI4, "--endpoint", "nonsense"), "must be a protocol and an address"),
    (2, ("run", OMNI4, "--fault", "power_off"), "belongs to --simulate"),
    (2, ("fault", "omni4"), "needs the NAME of a robot and a fault"),
    (2, ("set", "omni4", "speed_override"), "Missing argument"),
    # What replay cannot answer.
    (2, ("replay", "verify", "missing"), "missing: cannot be read: No such file or directory"),
    (2, ("replay", "info", "wrong.toml"), "wrong.toml: not a Rerun file"),
    (2, ("replay", "whatif", SESSION, "--robot-file", "wrong.toml"), "wrong.toml: y = 1: unknown key"),
    (2, ("replay", "inject", "missing", "--fault", "estop@1"), "missing: cannot be read"),
    # Refused before anybody is asked.
    (1, ("set", "omni4", "limits.velocity.vx", "1"), "needs a restart: it is in the robot file"),
    (1, ("set", "omni4", "speed_override", "fast"), "value = 'fast': must be a number"),
    (1, ("set", "omni4", "speed_override", "nan"), "value = nan: must be a number from"),
    (1, ("mark", "omni4", ""), "must be 1 to 200 printable characters"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With every bad file in it."""
    path = tmp_path_factory.mktemp("bad")
    (path / "folder.toml").mkdir()
    (path / "broken.toml").write_text("x = [")
    (path / "binary.toml").write_bytes(bytes(range(128, 255)))
    (path / "wrong.toml").write_text("y = 1\n")
    (path / "plain").write_text("")
    for name, bundled in (("nocan", "omni4"), ("nocan_steered", "moby")):
        (path / f"{name}.toml").write_text(robot_text(bundled).replace('channel = "can0"', 'channel = "nocan0"'))
    (path / "zenoh.json5").write_text("{ mode: 3 }")
    for name, file in (("zenoh", "zenoh.json5"), ("nozenoh", "nowhere.json5")):
        (path / f"{name}.toml").write_text(robot_text("omni4").replace("[zenoh]", f'[zenoh]\nconfig_file = "{file}"'))
    return path


@pytest.fixture
def taken() -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"tcp/127.0.0.1:{server.getsockname()[1]}"


def ends_with(
    words: tuple[str, ...], folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> tuple[int, str]:
    """Exit code and everything that is said. The daemon, which takes over signals and logs, in a process of its own."""
    if words[0] == "run":
        command = [sys.executable, "-m", "gateway", *words]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60.0, check=False)
        return done.returncode, plain(done.stdout + done.stderr)
    monkeypatch.chdir(folder)
    monkeypatch.setattr(operate, "NOTICE_S", 0.1)
    monkeypatch.setattr(operate, "ALIVE_TIMEOUT_S", 0.1)
    monkeypatch.setattr(sys, "argv", ["drivegate", *words])
    with pytest.raises(SystemExit) as ended:
        app.main()
    said = capsys.readouterr()
    assert isinstance(ended.value.code, int)
    return ended.value.code, plain(said.out + said.err)


def plain(text: str) -> str:
    """In one line, without the frame that Typer draws around a wrong option."""
    return " ".join(text.replace("│", " ").split())


@pytest.mark.parametrize(
    ("command", "bad"),
    [
        (command, bad)
        for command in READING
        for bad in (("wrong.toml",) if command[0] == "run" else BAD)  # of the daemon, a process each, one will do
    ],
)
def test_a_bad_file_ends_with_78_and_its_name(
    command: tuple[str, ...],
    bad: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if command[0] == "drive":
        monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    code, said = ends_with(tuple(bad if word == "FILE" else word for word in command), folder, monkeypatch, capsys)
    assert code == 78, said
    assert BAD[bad] in said


@pytest.mark.parametrize(("code", "command", "words"), ROWS)
def test_what_else_a_command_ends_with(  # noqa: PLR0917  # fixtures
    code: int,
    command: tuple[str, ...],
    words: str,
    folder: Path,
    taken: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = tuple(taken if word == "ADDRESS IN USE" else word for word in command)
    if given[0] == "run" and "--out" not in given:
        given = (*given, "--out", "sessions")
    found, said = ends_with(given, folder, monkeypatch, capsys)
    assert found == code, said
    assert words in said


def test_it_is_said_soon_for_whom_a_command_waits(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before it gives up; a keyboard is no different."""
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    for words in (("drive", "omni4"), ("send", "omni4"), ("watch", "omni4")):
        code, said = ends_with((*words, *NOBODY), folder, monkeypatch, capsys)
        assert code == 69
        soon, late = said.index("nobody answers as omni4 on tcp/127.0.0.1:1 yet"), said.index("does not answer on")
        assert soon < late

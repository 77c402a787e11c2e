"""Who may do what from another computer: keys, access rules and program as `deploy/README.md` has them, on loopback."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gateway.client import Client
from gateway.edges.messages import StateMessage
from gateway.types import Mode
from tests.docs.pages import ROOT, blocks
from tests.world import robot_text

BLOCKS = list(blocks((ROOT / "deploy" / "README.md").read_text(encoding="utf-8")))
ADDRESS, CREDENTIALS = "10.0.0.5:7447", "/run/credentials/drivegate@moby.service/tls_"
START_S, NEVER_S = 40.0, 1.5


def told(begin: str, language: str) -> str:
    """The block of the page that has these words."""
    (found,) = (block for block in BLOCKS if block.language == language and begin in block.text)
    return found.text


@pytest.fixture
def place(tmp_path: Path, free_port: int) -> Callable[[str], str]:
    """Texts of the page with the places of this test."""

    def placed(text: str) -> str:
        for old, new in (
            ("/etc/drivegate/tls", str(tmp_path)),
            ("/root/ca.key", str(tmp_path / "ca.key")),
            ("/etc/drivegate/", f"{tmp_path}/"),
            (CREDENTIALS, f"{tmp_path}/"),
            (ADDRESS, f"127.0.0.1:{free_port}"),
            ("IP:10.0.0.5", "IP:127.0.0.1"),
        ):
            text = text.replace(old, new)
        return text

    return placed


@pytest.fixture
def robot(tmp_path: Path, place: Callable[[str], str]) -> Iterator[Path]:
    """The simulated robot with the keys and the settings of the page; its log."""
    commander = told("-keyout operator.key", "sh")
    for script in (told("-keyout robot.key", "sh"), commander, commander.replace("operator", "dashboard")):
        subprocess.run(["bash", "-euc", place(script)], cwd=tmp_path, capture_output=True, timeout=60, check=True)
    (tmp_path / "moby.zenoh.json5").write_text(place(told("access_control", "json5")))
    before, after = robot_text("moby").split("[zenoh]")
    _, gap, rest = after.partition("\n[")
    file, log = tmp_path / "moby.toml", tmp_path / "log"
    file.write_text(f"{before}{place(told('config_file', 'toml'))}{gap}{rest}")
    command = [sys.executable, "-m", "gateway", "run", str(file), "--simulate", "--out", str(tmp_path / "sessions")]
    with log.open("wb") as lines:
        process = subprocess.Popen(command, stderr=lines, stdin=subprocess.DEVNULL)
    try:
        yield log
    finally:
        process.terminate()
        try:
            process.wait(60.0)
        finally:
            process.kill()


def client_of(name: str, folder: Path, endpoint: str) -> Client:
    """Whoever has the certificate of this name."""
    settings = told("connect_certificate", "json5").replace("operator", name)
    for file in ("ca.pem", f"{name}.key", f"{name}.pem"):
        settings = settings.replace(f'"{file}"', f'"{folder / file}"')
    (folder / f"{name}.json5").write_text(settings)
    return Client("moby", connect=[endpoint], config_file=str(folder / f"{name}.json5"))


def test_who_may_do_what(tmp_path: Path, free_port: int, robot: Path, place: Callable[[str], str]) -> None:
    endpoint = f"tls/127.0.0.1:{free_port}"
    with client_of("operator", tmp_path, endpoint) as operator:
        assert operator.wait_alive(START_S), robot.read_text()
        (tmp_path / "operator.json5").write_text(told("connect_certificate", "json5"))
        program = [sys.executable, "-c", place(told("config_file=", "python"))]
        said = subprocess.run(program, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
        assert said.returncode == 0, said.stderr
        with client_of("dashboard", tmp_path, endpoint) as onlooker:
            assert onlooker.wait_alive(START_S)
            assert onlooker.wait_for_state(lambda _: True, START_S) is not None, "it may look"
            onlooker.stop()
            onlooker.send_twist(0.0, 0.0, 0.0, source="teleop")
            assert operator.wait_for_state(_commanded, NEVER_S) is None, "and nothing else"
        operator.stop()
        assert operator.wait_for_state(lambda state: state.status.mode is Mode.ESTOP, START_S) is not None
    with Client("moby", connect=[endpoint]) as stranger:
        assert not stranger.wait_alive(NEVER_S)


def _commanded(state: StateMessage) -> bool:
    teleop = next(one for one in state.status.sources if one.name == "teleop")
    return state.status.mode is Mode.ESTOP or teleop.age_s is not None

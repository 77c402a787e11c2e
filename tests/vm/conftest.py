"""The installed robot of the systemd lane: one installation for all tests, one commander for each."""

import sys
from collections.abc import Callable, Iterator

import pytest

from tests.vm import installed_robot
from tests.vm.installed_robot import Commander, Motors


@pytest.fixture(scope="session")
def motors(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Motors]:
    """Installed and starting; vcan0 is down and the simulated motors are off."""
    with installed_robot.installation(tmp_path_factory.mktemp("robot") / "motors.log") as motors:
        yield motors


@pytest.fixture
def commander() -> Iterator[Commander]:
    """Silent at first."""
    commander = Commander()
    yield commander
    commander.close()


@pytest.fixture
def running(motors: Motors, commander: Commander) -> Commander:
    """The service is ready, its motors answer; left running for the next test."""
    motors.on()
    installed_robot.systemctl("start", installed_robot.UNIT)
    commander.await_state(lambda state: not state.status.faults)
    return commander


@pytest.fixture
def tell(capsys: pytest.CaptureFixture[str]) -> Callable[[str], None]:
    """Shows a measured figure, also when the test passes."""

    def write(figure: str) -> None:
        with capsys.disabled():
            sys.stdout.write(f"\n[measured] {figure}\n")

    return write

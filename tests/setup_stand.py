"""A simulated robot on a stand, in real time, and `drivegate setup` as a person calls it there."""

import json
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import can
from typer.testing import CliRunner, Result

from gateway.cli.app import build
from gateway.config import RobotConfig, parse
from replay.sim.controllers.contract import STEP_NS
from replay.sim.server import SimulationServer
from tests.lifted import LiftedPlant
from tests.setup_robots import TRUE

TICK_NS = 2 * STEP_NS


class Stand:
    """A true robot on a stand, in a thread, and the file that a person has of it."""

    def __init__(self, tmp_path: Path, channel: str, name: str, wrong: Callable[[str], str] = str) -> None:
        on_virtual = (
            TRUE[name]().replace('"socketcan"', '"virtual"').replace('channel = "can0"', f'channel = "{channel}"')
        )
        self.true = on_virtual
        self.config: RobotConfig = parse(on_virtual, name)
        self.file = tmp_path / f"{name}.toml"
        self.file.write_text(wrong(on_virtual))
        self.channel = channel
        self.plant = LiftedPlant(self.config)
        self._bus = can.Bus(interface="virtual", channel=channel)
        self.server = SimulationServer(self.config, {"can0": self._bus}, tick_ns=TICK_NS, plant=self.plant)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self.server.run, args=(self._stop,))
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._bus.shutdown()

    @property
    def moved(self) -> bool:
        return any(angle != 0.0 for angle in self.plant.angles)


@contextmanager
def stands(directory: Path, test: str) -> Iterator[Callable[..., Stand]]:
    """Makes them by the name of a robot, on buses of this test alone; each is closed in the end."""
    with ExitStack() as made:

        def make(name: str, wrong: Callable[[str], str] = str) -> Stand:
            return made.enter_context(closing(Stand(directory, f"{os.getpid()}_{test}"[:40], name, wrong)))

        yield make


def called(*arguments: object, answers: str = "") -> Result:
    """`drivegate setup` with these; `answers`: what is typed."""
    return CliRunner().invoke(build("setup"), ["setup", *map(str, arguments)], input=answers)


def document(result: Result) -> dict[str, object]:
    """What it tells a program."""
    found: dict[str, object] = json.loads(result.stdout)
    return found

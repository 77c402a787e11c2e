"""`drivegate` beside a simulated robot that is as it is: `python -m tests.docs.bench TRUE.toml EYES drivegate ...`.

How this works
--------------
For `setup` the robot of the file TRUE is on python-can's virtual bus of this process, in a thread, with its wheels in
the air. What a person standing beside it would see, how far each motor has turned, is in the file EYES, a double for
each, in the order of the chassis. For `run` it is on its wheels, and on the bus of the service itself, as the simulated
robot of `--simulate` is, so that a busy machine makes no motor silent.
"""

import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Final
from unittest.mock import patch

import can

from gateway.cli import main
from gateway.cli import run as run_module
from gateway.config import RobotConfig, load
from replay.sim.bus import SimulatedBus
from replay.sim.controllers.contract import STEP_NS
from replay.sim.plants.contract import Plant
from replay.sim.robot import SimulatedRobot
from replay.sim.server import SimulationServer
from tests.lifted import LiftedPlant

TICK_NS: Final = 2 * STEP_NS
LOOK_S: Final = 0.02


@contextmanager
def standing(config: RobotConfig, plant: Plant, eyes: Path) -> Iterator[None]:
    """The robot is there."""
    ended = Event()
    bus = can.Bus(interface="virtual", channel=config.bus[0].channel)
    server = SimulationServer(config, {config.bus[0].name: bus}, tick_ns=TICK_NS, plant=plant)

    new = eyes.with_suffix(".new")

    def look() -> None:
        while not ended.wait(LOOK_S):
            new.write_bytes(struct.pack(f"{len(plant.angles)}d", *plant.angles))
            new.replace(eyes)  # whoever looks sees all of it

    threads = [Thread(target=server.run, args=(ended,)), Thread(target=look)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in threads:
            thread.join()
        bus.shutdown()


def call(arguments: Sequence[str]) -> None:
    """The command, with the robot beside it where it needs one."""
    true, eyes, command, *rest = arguments
    sys.argv = [command, *rest]
    match rest:
        case ["run", *_]:
            config, _ = load(Path(true))
            with patch.object(run_module, "CanBuses", lambda _: SimulatedBus(config, SimulatedRobot(config))):
                main()
        case ["setup", "scan" | "directions" | "jog", *_]:
            config, _ = load(Path(true))
            with standing(config, LiftedPlant(config), Path(eyes)):
                main()
        case _:
            main()


if __name__ == "__main__":
    call(sys.argv[1:])

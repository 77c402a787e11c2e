"""`drivegate` beside a simulated robot that is as it is: `python -m tests.docs.bench TRUE.toml EYES drivegate ...`.

How this works
--------------
The robot of the file TRUE is on python-can's virtual bus of this process, in a thread, while the command runs: with its
wheels in the air for `setup`, on them for `run`. What a person standing beside it would see, how far each motor has
turned, is in the file EYES, a double for each, in the order of the chassis.
"""

import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Final

import can

from gateway.cli import main
from gateway.config import RobotConfig, load
from replay.sim.controllers.contract import STEP_NS
from replay.sim.plants import plant_of
from replay.sim.plants.contract import Plant
from replay.sim.server import SimulationServer
from tests.lifted import LiftedPlant

TICK_NS: Final = 2 * STEP_NS
LOOK_S: Final = 0.02
LIFTED: Final = "setup"
ON_WHEELS: Final = "run"


@contextmanager
def standing(config: RobotConfig, plant: Plant, eyes: Path) -> Iterator[None]:
    """The robot is there."""
    ended = Event()
    bus = can.Bus(interface="virtual", channel=config.bus[0].channel)
    server = SimulationServer(config, {config.bus[0].name: bus}, tick_ns=TICK_NS, plant=plant)

    def look() -> None:
        while not ended.wait(LOOK_S):
            eyes.write_bytes(struct.pack(f"{len(plant.angles)}d", *plant.angles))

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
    if rest[:1] not in ([LIFTED], [ON_WHEELS]) or rest[:2] == [LIFTED, "new"]:
        main()
        return
    config, _ = load(Path(true))
    plant = LiftedPlant(config) if rest[0] == LIFTED else plant_of(config.robot)
    with standing(config, plant, Path(eyes)):
        main()


if __name__ == "__main__":
    call(sys.argv[1:])

"""`drivegate` beside a simulated robot that is as it is: `python -m tests.docs.bench TRUE.toml EYES drivegate ...`.

How this works
--------------
The robot of the file TRUE is heard on the virtual bus of this process. What turns a motor of it for `setup`, or
drives it for `run`, has the bus of the simulation instead, so that a busy machine makes no motor silent: for `setup` in
virtual time and with its wheels in the air, for `run` by the clock and on its wheels. What a person standing beside it
would see, how far each motor has turned, is in the file EYES, a double for each, in the order of the chassis.
"""

import logging
import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Event, Thread
from typing import Final
from unittest.mock import patch

import can

from gateway.cli import main, run, setup_jog
from gateway.config import RobotConfig, load
from gateway.edges.signals import EndRequest
from gateway.edges.turning import Procedure, turn
from replay.drive.closed_loop import FIRST_NS
from replay.sim.bus import SimulatedBus
from replay.sim.controllers.contract import SECOND_NS, STEP_NS
from replay.sim.robot import SimulatedRobot
from replay.sim.server import SimulationServer
from tests.lifted import LiftedPlant

TICK_NS: Final = 2 * STEP_NS


@contextmanager
def heard(config: RobotConfig) -> Iterator[None]:
    """The robot talks on its bus."""
    logging.getLogger(
        SimulationServer.__module__
    ).disabled = True  # a robot does not tell that it is simulated too slowly
    ended = Event()
    bus = can.Bus(interface="virtual", channel=config.bus[0].channel)
    server = SimulationServer(config, {config.bus[0].name: bus}, tick_ns=TICK_NS, plant=LiftedPlant(config))
    thread = Thread(target=server.run, args=(ended,))
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        bus.shutdown()


class Lifted:
    """The robot in the air, and its time, which goes on while a motor is turned."""

    def __init__(self, config: RobotConfig, eyes: Path) -> None:
        self._plant = LiftedPlant(config)
        self._bus = SimulatedBus(config, SimulatedRobot(config, plant=self._plant))
        self._eyes = eyes
        self._now_ns = FIRST_NS

    def bus(self, _: RobotConfig) -> SimulatedBus:
        """In the place of the buses of a robot file."""
        return self._bus

    def turn(self, bus: SimulatedBus, procedure: Procedure, ending: EndRequest, *, period_ns: int) -> None:
        """In the place of the loop that turns a motor; what came of it can be seen."""
        turn(bus, procedure, ending, period_ns=period_ns, clock=lambda: self._now_ns, sleep=self._sleep)
        self._eyes.write_bytes(struct.pack(f"{len(self._plant.angles)}d", *self._plant.angles))

    def _sleep(self, seconds: float) -> None:
        self._now_ns += max(1, round(seconds * SECOND_NS))


def call(arguments: Sequence[str]) -> None:
    """The command, with the robot beside it where it needs one."""
    true, eyes, command, *rest = arguments
    sys.argv = [command, *rest]
    with ExitStack() as stack:
        match rest:
            case ["run", *_]:
                config, _ = load(Path(true))
                robot = SimulatedRobot(config)
                stack.enter_context(patch.object(run, "CanBuses", lambda _: SimulatedBus(config, robot)))
            case ["setup", "scan" | "directions", *_]:
                config, _ = load(Path(true))
                lifted = Lifted(config, Path(eyes))
                stack.enter_context(patch.object(setup_jog, "CanBuses", lifted.bus))
                stack.enter_context(patch.object(setup_jog, "turn", lifted.turn))
                stack.enter_context(heard(config))
        main()


if __name__ == "__main__":
    call(sys.argv[1:])

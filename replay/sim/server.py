"""The simulated robot in real time on python-can buses: a process of its own on vcan, or a thread in a test.

How this works
--------------
One `step` is one tick: drain every bus, advance the world by the tick, send what the devices have to say. The world
has its own time, counted in ticks, so a stalled server pauses the world instead of flooding the bus afterwards. A bus
that fails is tried again in every tick; only the change of its state is logged. There is no arbitration here: the
real or virtual bus has its own.
"""

import logging
import threading
import time
from collections.abc import Mapping

from drivers.contract import CanFrame
from gateway.config import RobotConfig
from gateway.edges.can_adapter import AdapterError, ask, flaw, frame_of, message_of
from gateway.edges.python_can import can
from replay.sim.controllers.contract import STEP_NS, Emission
from replay.sim.plants.contract import Plant
from replay.sim.robot import SimulatedRobot

logger = logging.getLogger(__name__)

_SECOND_NS = 1_000_000_000
_GIVE_UP_NS = 100_000_000  # lateness beyond which the deadlines start afresh


class SimulationServer:
    """Owner of the loop; the buses belong to the caller and are not closed here."""

    def __init__(
        self,
        config: RobotConfig,
        buses: Mapping[str, can.BusABC],
        *,
        tick_ns: int = STEP_NS,
        plant: Plant | None = None,
    ) -> None:
        missing = {bus.name for bus in config.bus} - set(buses)
        if missing or tick_ns < STEP_NS:
            raise ValueError(f"missing buses: {sorted(missing)}; tick {tick_ns} ns: at least {STEP_NS}")
        self.robot = SimulatedRobot(config, plant=plant)
        self.dropped = 0  # frames that could not be sent (queue full, interface down)
        self._buses = dict(buses)
        self._fd = {bus.name for bus in config.bus if bus.fd}
        self._failing: set[str] = set()
        self._tick_ns = tick_ns
        self._world_ns = 0
        self.robot.start(0)

    def run(self, stop_event: threading.Event) -> None:
        """Step at absolute deadlines until told to stop."""
        deadline_ns = time.monotonic_ns()
        while not stop_event.is_set():
            self.step()
            deadline_ns += self._tick_ns
            spare_ns = deadline_ns - time.monotonic_ns()
            if spare_ns > 0:
                stop_event.wait(spare_ns / _SECOND_NS)
            elif spare_ns < -_GIVE_UP_NS:
                logger.warning("simulation is %.0f ms late: the world pauses", -spare_ns / 1e6)
                deadline_ns = time.monotonic_ns()

    def step(self) -> None:
        """One tick of the world and one exchange of frames."""
        emissions = [emission for name, bus in self._buses.items() for emission in self._hear(name, bus)]
        self._world_ns += self._tick_ns
        self.robot.advance(self._world_ns)
        for device in self.robot.on_bus():
            emissions.extend(device.poll(self._world_ns))
        for emission in sorted(emissions):
            self._say(emission.frame)

    def _hear(self, name: str, bus: can.BusABC) -> list[Emission]:
        """Everything that waits on one bus, given to its devices; their replies."""
        devices = self.robot.on_bus(name)
        replies: list[Emission] = []
        while (message := self._received(name, bus)) is not None:
            if message.is_error_frame or flaw(message, fd=name in self._fd) is not None:
                continue
            frame = frame_of(message, bus=name, received_ns=None)
            for device in devices:
                replies.extend(device.receive(frame, self._world_ns))
        return replies

    def _received(self, name: str, bus: can.BusABC) -> can.Message | None:
        try:
            return ask(bus.recv, 0)
        except AdapterError as error:
            self._note_failure(name, error)
            return None

    def _say(self, frame: CanFrame) -> None:
        try:
            ask(self._buses[frame.bus].send, message_of(frame))
        except AdapterError as error:
            self.dropped += 1
            self._note_failure(frame.bus, error)
            return
        if frame.bus in self._failing:
            self._failing.discard(frame.bus)
            logger.info("bus %s works again", frame.bus)

    def _note_failure(self, name: str, error: Exception) -> None:
        if name not in self._failing:
            self._failing.add(name)
            logger.warning("bus %s fails, trying again: %s", name, error)

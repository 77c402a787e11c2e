"""The daemon with an adapter that holds its caller for ever: `python -m tests.e2e.held_adapter run FILE …`.

Behind it is the simulated robot, in real time. Once there is a file `open` or `send` beside the robot file, that call
does not return; with `send`, closing does not either.
"""

import sys
import time
from pathlib import Path
from threading import Event, Lock

import can

from drivers.contract import CanFrame
from gateway.cli import main
from gateway.config import load
from replay.sim.bus import SimulatedBus
from tests.world import ROBOTS


class HeldBus:
    """What python-can would give."""

    def __init__(self, **_: object) -> None:
        self._directory = Path(sys.argv[2]).parent
        self._hold("open")
        self._robot = SimulatedBus(load(ROBOTS / "moby.toml")[0])
        self._lock = Lock()
        self._frames: list[CanFrame] = []

    def recv(self, _timeout: float) -> can.Message | None:
        with self._lock:
            self._frames += self._robot.receive(time.monotonic_ns())[0]
            if not self._frames:
                return None
            frame = self._frames.pop(0)
        return can.Message(arbitration_id=frame.id, data=frame.data, is_extended_id=False)

    def send(self, message: can.Message, timeout: float) -> None:
        assert timeout > 0.0
        self._hold("send")
        data = bytes(message.data)
        frame = CanFrame("can0", message.arbitration_id, data, remote=message.is_remote_frame)
        with self._lock:
            self._robot.send([frame], time.monotonic_ns())

    def shutdown(self) -> None:
        self._hold("send")

    def _hold(self, call: str) -> None:
        if (self._directory / call).exists():
            Event().wait()


if __name__ == "__main__":
    can.Bus = HeldBus  # type: ignore[assignment]
    main()

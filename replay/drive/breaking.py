"""A fault of a script put into a simulated world, and taken out of it again."""

from gateway.config import RobotConfig
from replay.drive import faults
from replay.drive.faults import FaultKind
from replay.drive.scenario_file import Fault
from replay.sim.bus import SimulatedBus


class Breaking:
    """Knows the world and who is in it. Everything happens at an instant, up to which the world is run before."""

    def __init__(self, bus: SimulatedBus, config: RobotConfig) -> None:
        self._bus = bus
        self._config = config

    def begin(self, fault: Fault, now_ns: int, *, seed: int) -> tuple[str, ...]:
        """Break it; the motors, buses or sensors that it concerns, for its end."""
        self._bus.advance(now_ns)
        names = faults.concerned(fault.kind, self._config, motor=fault.motor, bus=fault.bus, sensor=fault.sensor)
        lasting = fault.seconds is not None
        faults.begin(fault.kind, self._bus, names, fault.value, seed=seed, lasting=lasting)
        if fault.kind is FaultKind.CLEAR and fault.motor is None:
            faults.clear_surroundings(self._bus, [one.name for one in self._config.bus])
        return names

    def end(self, fault: Fault, names: tuple[str, ...], now_ns: int) -> None:
        """After its seconds."""
        self._bus.advance(now_ns)
        faults.end(fault.kind, self._bus, names, fault.value)

"""Which motors can be relied on: three independent detectors, and the faults they raise.

The detectors: age of the feedback, state that does not match what was asked (both judged by the driver), and speed
that does not follow its setpoint (judged here). An error code alone is never relied on.
"""

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from drivers.interface import MotorFeedback, MotorState

FOLLOWING_TOLERANCE = 0.3  # of the motor's top speed; a jam or a runaway exceeds it, a hard start does not
FOLLOWING_TIME_NS = 500_000_000


class FaultKind(Enum):
    """Reasons not to rely on a motor or to move at all."""

    SILENT = "silent"  # no feedback
    MOTOR = "motor"  # the controller or its driver refuses
    FOLLOWING = "following"  # speed does not follow the setpoint
    POSITION_UNKNOWN = "position_unknown"  # a joint angle the geometry needs
    ARMING = "arming"  # a motor did not become operational in time
    BUS = "bus"  # the bus cannot send or receive


class Fault(NamedTuple):
    """One reason, in words; a latched one stays until a reset even if its cause is gone."""

    kind: FaultKind
    subject: str  # motor or bus
    text: str
    latched: bool

    def __str__(self) -> str:
        return f"{self.subject}: {self.text}"


class Health(NamedTuple):
    """Per motor, in the order of the robot file: may it be driven; and every present fault."""

    usable: tuple[bool, ...]
    faults: tuple[Fault, ...]


class HealthMonitor:
    """Judges every motor each cycle; remembers latched faults until `reset` and lost motors until `forgive`."""

    def __init__(self, names: Sequence[str], *, top_speeds: Sequence[float]) -> None:
        self._names = tuple(names)
        self._tolerances = tuple(FOLLOWING_TOLERANCE * speed for speed in top_speeds)
        self._following_since: list[int | None] = [None] * len(self._names)
        self._latched: dict[tuple[FaultKind, str], Fault] = {}
        self._lost: set[int] = set()
        self._well = Health((True,) * len(self._names), ())

    def latch(self, fault: Fault) -> None:
        """A fault found elsewhere that only a reset may clear."""
        self._latched.setdefault((fault.kind, fault.subject), fault)

    def reset(self) -> None:
        """Forget latched faults; those whose cause persists come back in the next cycle."""
        self._latched.clear()
        self._following_since = [None] * len(self._names)

    def forgive(self) -> None:
        """The robot is at rest and released: motors lost while driving may be tried again."""
        self._lost.clear()

    def assess(
        self,
        feedback: Sequence[MotorFeedback],
        *,
        setpoints: Sequence[float | None],
        speeds: Sequence[float | None],
        driving: bool,
        now_ns: int,
    ) -> Health:
        """Health of this cycle. `setpoints`, `speeds`: last commanded and measured output speeds, rad/s."""
        present: list[tuple[int, Fault]] = []
        for index, motor in enumerate(feedback):
            if motor.state is MotorState.OPERATIONAL:
                fault = self._following(index, setpoints[index], speeds[index], now_ns)
            else:
                fault = self._reported(index, motor, driving=driving)
            if fault is not None:
                present.append((index, fault))
        if not present and not self._latched and not self._lost:
            return self._well
        return self._judge(present, driving)

    def _reported(self, index: int, motor: MotorFeedback, *, driving: bool) -> Fault | None:
        self._following_since[index] = None
        if motor.fault is not None:
            return Fault(FaultKind.MOTOR, self._names[index], motor.fault.text, motor.fault.latched)
        if motor.state is MotorState.SILENT:
            age = "never heard" if motor.age_ns is None else f"silent for {motor.age_ns * 1e-9:.2f} s"
            return Fault(FaultKind.SILENT, self._names[index], age, latched=False)
        if driving and index not in self._lost:
            text = f"left operation while driving (is {motor.state.value})"
            return Fault(FaultKind.MOTOR, self._names[index], text, latched=False)
        return None

    def _following(self, index: int, setpoint: float | None, speed: float | None, now_ns: int) -> Fault | None:
        if setpoint is None or speed is None or abs(setpoint - speed) <= self._tolerances[index]:
            self._following_since[index] = None
            return None
        since = self._following_since[index]
        if since is None:
            self._following_since[index] = now_ns
            return None
        if now_ns - since < FOLLOWING_TIME_NS:
            return None
        text = f"turns at {speed:.2f} rad/s where {setpoint:.2f} rad/s is commanded"
        return Fault(FaultKind.FOLLOWING, self._names[index], text, latched=True)

    def _judge(self, present: Sequence[tuple[int, Fault]], driving: bool) -> Health:
        for index, fault in present:
            if fault.latched:
                self.latch(fault)
            if driving:
                self._lost.add(index)
        faults = {(fault.kind, fault.subject): fault for _, fault in present}
        faults |= self._latched
        bad = {fault.subject for fault in faults.values()}
        usable = tuple(name not in bad and index not in self._lost for index, name in enumerate(self._names))
        return Health(usable, tuple(faults.values()))

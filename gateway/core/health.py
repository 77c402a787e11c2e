"""Which motors can be relied on, and the faults that say why not.

How this works
--------------
Three independent sources: age of the feedback, state that does not match what was asked (both judged by the driver),
and what the motor's numbers say (`gateway.core.detectors`, `gateway.core.torque_loss`). An error code alone is never
relied on.
A motor that fails while the robot is energised is lost until the robot is back in IDLE, whatever becomes of the cause:
it is released and not driven again. A motor whose bus is down is not lost yet but out of reach: it may still be doing
what it was last told, so once the bus is back it goes on braking if it still obeys, and is lost if it does not.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from enum import Enum
from typing import Final, NamedTuple

from drivers.contract import MotorFeedback, MotorState
from drivers.twins import CODE as ID_TWIN
from gateway.core import detectors
from gateway.core.detectors import Detector, Limits, Sample

# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_OPERATIONAL: Final = MotorState.OPERATIONAL
_SILENT: Final = MotorState.SILENT

RETURN_GRACE_NS: Final = 150_000_000  # for a motor to be heard again once its bus is back


class FaultKind(Enum):
    """Reasons not to rely on a motor or to move at all."""

    SILENT = "silent"  # no feedback
    MOTOR = "motor"  # the controller or its driver refuses
    STALL = "stall"  # torque at its limit, and no motion
    FROZEN = "frozen"  # the encoder stands still, the wheel does not
    RUNAWAY = "runaway"  # speeds up against its torque
    REVERSED = "reversed"  # moves against its torque
    TORQUE_LOST = "torque_lost"  # what it pushes does not arrive
    FOLLOWING = "following"  # speed does not follow the setpoint
    TWIN = "twin"  # two controllers answer as one
    POSITION_UNKNOWN = "position_unknown"  # a joint angle the geometry needs
    ARMING = "arming"  # a motor did not become operational in time
    FALLEN = "fallen"  # a robot that balances leans too far, or nobody knows how far
    BUS = "bus"  # the bus cannot send or receive


DETECTORS: Final[dict[FaultKind, Callable[[Limits], Detector]]] = {
    FaultKind.RUNAWAY: detectors.RunawayDetector,
    FaultKind.FROZEN: detectors.FrozenEncoderDetector,
    FaultKind.STALL: detectors.StallDetector,
    FaultKind.FOLLOWING: detectors.FollowingDetector,
}
TOLD: Final[dict[str, FaultKind]] = {ID_TWIN: FaultKind.TWIN}  # what drivers tell by these codes; else it is MOTOR
STILL_BRAKING: Final = frozenset({FaultKind.STALL, FaultKind.FOLLOWING})  # but on a slope it must hold
# A controller that misreads its shaft, or pushes the wrong way, cannot even brake it.
BLIND: Final = frozenset({FaultKind.FROZEN, FaultKind.TWIN, FaultKind.REVERSED})


class Fault(NamedTuple):
    """One reason, in words; a latched one stays until a reset even if its cause is gone."""

    kind: FaultKind
    subject: str  # motor or bus
    text: str
    latched: bool

    def __str__(self) -> str:
        return f"{self.subject}: {self.text}"


class Health(NamedTuple):
    """Per motor, in the order of the robot file, and every present fault.

    `usable`: may be driven. `obeying`: may go on with the ramp to rest. `brakable`: may be braked in an emergency stop.
    """

    usable: tuple[bool, ...]
    obeying: tuple[bool, ...]
    brakable: tuple[bool, ...]
    faults: tuple[Fault, ...]


class HealthMonitor:
    """Judges every motor each cycle; remembers latched faults until `reset` and lost motors until `forgive`."""

    def __init__(self, names: Sequence[str], *, limits: Sequence[Limits]) -> None:
        self._names = tuple(names)
        self._limits = tuple(limits)
        self._latched: dict[tuple[FaultKind, str], Fault] = {}
        self._lost: set[int] = set()
        self._obeyed: set[int] = set()  # since the robot was last at rest
        self._away: dict[int, int] = {}  # motors out of reach, and when that was last so
        all_well = (True,) * len(self._names)
        self._well = Health(all_well, all_well, all_well, ())
        self.look_anew()

    def latch(self, fault: Fault) -> None:
        """A fault found elsewhere that only a reset may clear."""
        self._latched.setdefault((fault.kind, fault.subject), fault)

    def lose(self, indices: Iterable[int]) -> None:
        """Motors that were released while the robot was energised: not to be driven before it has been at rest."""
        self._lost.update(indices)

    def reset(self) -> None:
        """Forget latched faults; those whose cause persists come back."""
        self._latched.clear()
        self.look_anew()

    def expect_nothing(self) -> None:
        """The motors are released: that they no longer obey is no fault, also when they are to brake again."""
        self._obeyed.clear()

    def forgive(self) -> None:
        """The robot is at rest and released: motors lost before may be tried again."""
        self._lost.clear()
        self._obeyed.clear()
        self.look_anew()

    def look_anew(self) -> None:
        """What the motors did before says nothing about now: after a pause of the loop, a reset, or at rest."""
        self._reversed = detectors.ReversedDetector(self._limits)
        self._detectors = [
            [(kind, detector(limits)) for kind, detector in DETECTORS.items()] for limits in self._limits
        ]

    def assess(
        self,
        feedback: Sequence[MotorFeedback],
        samples: Sequence[Sample],
        *,
        others: Sequence[Fault] = (),
        out_of_reach: Collection[int] = (),
        energised: bool,
        redundant: bool = False,
        powerless: tuple[int, str] | None = None,
        now_ns: int,
    ) -> Health:
        """Health of this cycle. `others`: faults found elsewhere; `out_of_reach`: motors on a bus that is down.

        `redundant`: there are more wheels than ways to move, so that each can be told from the others. `powerless`: the
        place of a motor whose torque does not arrive, and that in words.
        """
        present: list[Fault] = []
        backwards = self._reversed.look(samples) if redundant else None
        for index in out_of_reach:
            self._away[index] = now_ns
        for index, motor in enumerate(feedback):
            if index in self._away and self._is_away(index, motor, now_ns):
                continue
            if motor.state is _OPERATIONAL:
                if energised:
                    self._obeyed.add(index)
                fault = None if powerless is None else self._blamed(index, FaultKind.TORQUE_LOST, powerless)
                fault = fault or self._detected(index, samples[index])
                if fault is None and backwards is not None:
                    fault = self._blamed(index, FaultKind.REVERSED, backwards)
            else:
                fault = self._reported(index, motor, energised=energised)
            if fault is not None:
                present.append(fault)
                if energised and fault.kind not in STILL_BRAKING:
                    self._lost.add(index)
        if not (present or others or self._latched or self._lost or self._away):
            return self._well
        return self._judge([*present, *others])

    def _is_away(self, index: int, motor: MotorFeedback, now_ns: int) -> bool:
        """Whether the motor is still to be waited for, and not to be judged."""
        back = motor.state is not _SILENT
        waited = now_ns - self._away[index]
        if waited == 0 or (not back and waited < RETURN_GRACE_NS):
            self._begin(index)
            return True
        del self._away[index]
        return False

    def _reported(self, index: int, motor: MotorFeedback, *, energised: bool) -> Fault | None:
        self._begin(index)
        name = self._names[index]
        if motor.fault is not None:
            return Fault(TOLD.get(motor.fault.code, FaultKind.MOTOR), name, motor.fault.text, motor.fault.latched)
        if motor.state is _SILENT:
            age = "never heard" if motor.age_ns is None else f"silent for {motor.age_ns * 1e-9:.2f} s"
            return Fault(FaultKind.SILENT, name, motor.silence or age, latched=False)
        if energised and index in self._obeyed and index not in self._lost:
            text = f"stopped obeying (is {motor.state.value})"
            return Fault(FaultKind.MOTOR, name, text, latched=False)
        return None

    def _detected(self, index: int, sample: Sample) -> Fault | None:
        for kind, detector in self._detectors[index]:
            text = detector.look(sample)
            if text is not None and not (kind is FaultKind.RUNAWAY and self._is_dragged(index)):
                return Fault(kind, self._names[index], text, latched=True)
        return None

    def _is_dragged(self, index: int) -> bool:
        """Whether it is known that whatever turns its wheel, this motor does not: it is none to release all others."""
        return (FaultKind.TORQUE_LOST, self._names[index]) in self._latched

    def _blamed(self, index: int, kind: FaultKind, blamed: tuple[int, str]) -> Fault | None:
        """What was found by looking at all motors together."""
        place, text = blamed
        return Fault(kind, self._names[index], text, latched=True) if place == index else None

    def _judge(self, present: Sequence[Fault]) -> Health:
        for fault in present:
            if fault.latched:
                self.latch(fault)
        faults = {(fault.kind, fault.subject): fault for fault in present} | self._latched
        bad = {fault.subject for fault in faults.values()}
        runaway = any(fault.kind is FaultKind.RUNAWAY for fault in faults.values())
        blind = {fault.subject for fault in faults.values() if fault.kind in BLIND}
        places = tuple(enumerate(self._names))
        return Health(
            usable=tuple(
                not runaway and name not in bad and index not in self._lost | set(self._away) for index, name in places
            ),
            obeying=tuple(not runaway and index not in self._lost for index, _ in places),
            brakable=tuple(not runaway and name not in blind for _, name in places),
            faults=tuple(faults.values()),
        )

    def _begin(self, index: int) -> None:
        """What a motor did before it was out of operation or out of reach says nothing about now."""
        self._detectors[index] = [(kind, detector(self._limits[index])) for kind, detector in DETECTORS.items()]

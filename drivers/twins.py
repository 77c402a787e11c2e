"""Two controllers that answer as one id, seen frame by frame.

How this works
--------------
Each frame either goes on from the one before it, as far as one rotor can have turned meanwhile, or it does not. A rotor
that really jumps (a power cycle, a slipped magnet, an impact) does so once and goes on from there. Two rotors that take
turns make the readings jump to and fro: a frame that does not go on from the last one goes on from the one before the
last jump. Such returns are counted, and everything else wears the count off.

Stamps may be wrong by a few periods (frames that waited for their adapter), frames may be lost, repeated or overtaken,
so a turning rotor may be anywhere within the way of that time, ahead or behind. At rest it is anywhere but elsewhere.
Two rotors that stand within NEAR of each other look like one; they part as soon as one of them turns.
"""

from typing import Final

from drivers.checks import measuring_hz
from drivers.contract import DriverFault, MotorSpec

CODE: Final = "id_twin"

NEAR: Final = 0.2  # rad at the motor shaft; a step of the coarsest encoder in use (42 Hall states per turn) is 0.15
SLACK_PERIODS: Final = 2.0  # of the feedback, by which stamps may be wrong; at least a cycle of the loop
CLEAR: Final = 0.25  # of a turn; where a rotor may have gone further, an angle within a turn says nothing of its way
SPEED_NOISE: Final = 0.3  # of max_speed; an impact, or play in the gear, changes the rotor's speed in no time
ACCELERATION: Final = 20.0  # max_speed per second; a rotor without a load takes some 15
RETURNS: Final = 4.0
FADE: Final = 0.2  # of a return, by each frame that is none; a single rotor never comes near one return in six frames

_Reading = tuple[float, float, int]  # rad, rad/s, ns


class TwinWatch:
    """Looks at the readings of one id. `turn`: rad after which the position starts anew; None: it never does."""

    __slots__ = (
        "_before_jump",
        "_calm",
        "_max_speed",
        "_position",
        "_received_ns",
        "_returns",
        "_slack",
        "_turn",
        "_velocity",
    )

    def __init__(self, spec: MotorSpec, *, turn: float | None = None) -> None:
        self._max_speed = spec.max_speed
        self._calm = SPEED_NOISE * spec.max_speed
        self._slack = max(SLACK_PERIODS / measuring_hz(spec), 1.0 / spec.command_rate)
        self._turn = turn
        self.forget()

    def forget(self) -> None:
        """What was seen so far says nothing about now."""
        self._position = self._velocity = 0.0  # of the last reading
        self._received_ns: int | None = None  # there is none yet
        self._before_jump: _Reading | None = None
        self._returns = 0.0

    def take(self, position: float, velocity: float, received_ns: int) -> bool:
        """Take a reading, rad and rad/s at the motor shaft; whether two rotors are sure by now."""
        last_position, last_velocity, last_ns = self._position, self._velocity, self._received_ns
        self._position, self._velocity, self._received_ns = position, velocity, received_ns
        if last_ns is None:
            return False
        # The ordinary frame is near even without the time since the last one, and costs little.
        near = abs(velocity - last_velocity) <= self._calm and (
            abs(position - last_position) <= NEAR + abs(velocity) * self._slack
        )
        if not near:
            self._compare((last_position, last_velocity, last_ns), (position, velocity, received_ns))
        elif self._returns:
            self._fade()
        return self._returns >= RETURNS

    def _compare(self, last: _Reading, reading: _Reading) -> None:
        """A reading that may be too far from the last one for one rotor."""
        if self._goes_on(last, reading):
            self._fade()
        else:
            self._jump(last, reading)

    def _fade(self) -> None:
        self._returns = max(0.0, self._returns - FADE)

    def _jump(self, last: _Reading, reading: _Reading) -> None:
        before, self._before_jump = self._before_jump, last
        if before is not None and self._goes_on(before, reading):
            self._returns += 1.0
        else:
            self._fade()

    def _goes_on(self, before: _Reading, now: _Reading) -> bool:
        """Whether one rotor can have moved from one reading to the other."""
        time = self._slack + max(0, now[2] - before[2]) * 1e-9
        reach = NEAR + max(abs(before[1]), abs(now[1])) * time
        way, turn = now[0] - before[0], self._turn
        if turn is not None:
            way = 0.0 if reach > CLEAR * turn else way - turn * round(way / turn)
        if abs(way) > reach:
            return False
        return abs(now[1] - before[1]) <= self._max_speed * (SPEED_NOISE + ACCELERATION * time)


def twin_fault(spec: MotorSpec, bus: str) -> DriverFault:
    """What is told of a motor whose id two controllers have."""
    return DriverFault(CODE, f"two controllers answer as id {spec.id} on {bus}", latched=True)

"""How fast this machine is now: a fixed piece of plain Python, of the kind that the core is made of.

How this works
--------------
The aims of the issues are times on the machine that the core's first figures were measured on, where a cycle of pure
Python took 49.6 us at the commit of that issue ("Replace a recorder process that is stuck in writing, and claim no
footer that is not there"). That commit can be measured on any machine, in turn with this work, and both are Python of
one kind: the quotient of the two is a property of the programs. It came out as CYCLES; so there this work took
49.6 us / CYCLES. What it takes here, over that, is how many times slower this machine is now.

The work must stay as it is: it is a unit. It uses nothing of the product.
"""

import time
from collections.abc import Sequence
from math import sqrt
from struct import Struct
from typing import NamedTuple

ISSUE_CYCLE_US = 49.6  # one cycle of pure Python, as the issue has it
CYCLES = 5.75  # that cycle in units of this work: 5.70 to 5.83 in nine runs on a busy machine
ISSUE_US = ISSUE_CYCLE_US / CYCLES
WARM, CALLS = 5, 20
RUNS = 200  # of a third of a millisecond

_FEEDBACK = Struct(">hhhBx")
_ROWS = ((-0.7, 0.7, 0.3), (-0.7, -0.7, 0.3), (0.7, -0.7, 0.3), (0.7, 0.7, 0.3))
_FRAMES = tuple((0x201 + place % 4, _FEEDBACK.pack(1000 * place, 100 - place, -place, 40)) for place in range(8))


class _Reading(NamedTuple):
    position: float
    speed: float
    torque: float
    now_ns: int


class _Joint:
    def __init__(self) -> None:
        self.reading = _Reading(0.0, 0.0, 0.0, 0)
        self.turned = 0.0
        self.count = 0

    def take(self, data: bytes, now_ns: int) -> None:
        angle, speed, current, _ = _FEEDBACK.unpack(data)
        position = angle * (6.283185307179586 / 8192.0)
        step = position - self.reading.position
        if step > 3.141592653589793:
            step -= 6.283185307179586
        elif step < -3.141592653589793:
            step += 6.283185307179586
        self.turned += step
        self.count += 1
        self.reading = _Reading(position, speed * 0.10471975511965977, current * 0.0003, now_ns)


class Work:
    """The unit."""

    def __init__(self) -> None:
        self.joints = {identifier: _Joint() for identifier in range(0x201, 0x205)}
        self.rates = [0.0, 0.0, 0.0]

    def run_us(self) -> float:
        """The processor's time for one unit, us, once it has it in its caches."""
        for now_ns in range(WARM):
            self._step(now_ns)
        begin = time.process_time_ns()
        for now_ns in range(CALLS):
            self._step(now_ns)
        return (time.process_time_ns() - begin) / CALLS / 1000.0

    def _step(self, now_ns: int) -> tuple[bytes, ...]:
        for identifier, data in _FRAMES:
            self.joints[identifier].take(data, now_ns)
        speeds = [joint.reading.speed for joint in self.joints.values()]
        twist = [sum([row[axis] * one for row, one in zip(_ROWS, speeds, strict=True)]) for axis in range(3)]
        length = sqrt(sum([one * one for one in twist])) + 1.0
        self.rates = [
            old + max(-0.01, min(0.01, new / length - old)) for old, new in zip(self.rates, twist, strict=True)
        ]
        wanted = [sum([part * one for part, one in zip(row, self.rates, strict=True)]) for row in _ROWS]
        most = max([abs(one) for one in wanted] + [1.0])
        return tuple([_FEEDBACK.pack(int(one / most * 1000.0), 0, 0, 0) for one in wanted])


def slowness(runs: Sequence[float]) -> float:
    """How many times slower than that machine this one was in these runs (us); the fastest count: load only adds."""
    return sorted(runs)[len(runs) // 50] / ISSUE_US


def now() -> list[float]:
    """Some runs."""
    work = Work()
    return [work.run_us() for _ in range(RUNS)]

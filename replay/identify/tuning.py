"""From what a motor was told and what it did to the gains of its speed loop, and what they are worth."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from gateway.config import SpeedLoop
from replay.identify.gains import Gains, Margins, gains, margins
from replay.identify.response import Answer, Response, ResponseError, identify


class Cycle(Protocol):
    """What was measured and told in one cycle: ns, rad, rad/s, N m from then on."""

    @property
    def now_ns(self) -> int: ...
    @property
    def position(self) -> float | None: ...
    @property
    def speed(self) -> float | None: ...
    @property
    def torque(self) -> float: ...


class Tuned(NamedTuple):
    """`heavy`: kg m^2 of a wheel that carries its share of the robot; `delay`: s, that the rule counted with."""

    answer: Answer
    times: Sequence[float]
    speeds: Sequence[float]
    torques: Sequence[float]
    heavy: float
    delay: float
    period: float
    before: Gains
    after: Gains

    def rows(self) -> list[tuple[str, Gains, float, Margins]]:
        """Both loops with both loads."""
        return [
            (f"{name}, {where}", loop, load, margins(loop, load, delay=self.delay, period=self.period))
            for name, loop in (("before", self.before), ("after", self.after))
            for where, load in (("as it was turned", self.answer.response.inertia), ("with the robot", self.heavy))
        ]

    def loaded(self) -> Response:
        """How it would answer with its share of the robot."""
        return self.answer.response._replace(inertia=self.heavy)


def tune(told: Sequence[Cycle], *, before: SpeedLoop, carried: float, damping: float, period: float) -> Tuned:
    """`carried`: kg m^2 of the robot's share at the output. Raises ResponseError.

    `damping`: N m per rad/s that the windings take and the host makes up for: no friction that the loop has.
    """
    known = [
        (one.now_ns * 1e-9, one.position, one.speed, one.torque)
        for one in told
        if one.position is not None and one.speed is not None
    ]
    if len(known) < len(told) or not known:
        raise ResponseError("its speed was not known all the time")
    times, positions, speeds, torques = map(list, zip(*known, strict=True))
    answer = identify(times, positions, speeds, torques)
    times = [one - times[0] for one in times]
    friction = max(0.0, answer.response.friction - damping)
    answer = answer._replace(response=answer.response._replace(friction=friction))
    light = answer.response.inertia
    heavy = light + carried
    delay = answer.response.delay + answer.halves.delay  # the longest that it may be
    after = gains(light, heavy, delay=delay, period=period)
    return Tuned(answer, times, speeds, torques, heavy, delay, period, Gains(before.kp, before.ki), after)

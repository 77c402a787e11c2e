"""Random drives in the pull region, with pushes; `python -m tests.bench.pulled` drives as many as one likes.

How this works
--------------
One number makes one drive, the same on every machine: a robot that starts pulled and is commanded along arcs, lines and
clothoids, up to its top speed and down to 1.5 d1 (at d1 the balances of push and pull meet, and no
correction is left). Pushes along both directions of the world's x, 2 % of all frames lost both ways, and every frame a
cycle late, both ways: feedback and command. The frames get lost from when the robot drives.
A second core gets the same inputs and has to answer the same. What is judged comes from the true motion, and from what
the wheels are told.
"""

from collections.abc import Callable, Sequence
from math import acos, atan2, cos, hypot, pi, sin, sqrt
from pathlib import Path
from random import Random
from typing import NamedTuple

from gateway.config import RobotConfig, parse
from gateway.core.engine import Engine
from gateway.core.snapshot import State
from gateway.types import ZERO_TWIST, Inputs, Mode, Outputs, Twist, TwistCommand, TwistFrame
from replay.compare.verify import Verdict, verify
from replay.drive.closed_loop import ClosedLoop
from replay.drive.recording import SessionRecording
from replay.sessions.reader import open_session
from replay.sim.robot import Truth
from tests.world import robot_text

D1 = 0.25  # m, of moby
TOP = (0.2, 1.2)  # m/s
TURN, TURNING = 1.0, 0.7  # rad/s and rad/s^2 of the platform; the limit is 1.0 for both
ACROSS, SPEEDING = 0.6, 0.5  # m/s^2 across the motion and along it: 0.78 in all, the limit is 0.8
CURVING = 1.0  # rad/s^2 of the path's rate: pieces meet in clothoids
LED = 0.25  # of the fastest that a pulled chassis can change its place on an arc
STEERED = 2  # place of the platform joint
MOST = (60.0, 60.0, 20.0)  # rad/s^2 of the motors, as the bundled file proposes
COMMANDS_S = 0.02
ANSWERS_S = 0.5
ACROSS_COSINE = 0.05  # |cos gamma| beyond which a side counts
RATES = (250.0, 50.0)  # Hz
ROUNDING = 1e-6
STARTED_WALL_NS = 1_790_000_000_000_000_000

COMPENSATION = "[robot.compensation]\ngain = 2.0\nregion = 1.57\n\n[robot.body]"
LIMITS = "motor_acceleration = {{ left = {}, right = {}, platform = {} }}\n\n[[bus]]"

Put = Callable[[Inputs, Outputs, Callable[[], State]], None]


class Trouble(NamedTuple):
    """`push`: N at most, for 0.1 s to 0.3 s every 2 s to 6 s; `loss`: share of frames; `tightest`: radius in d1."""

    push: float = 250.0
    loss: float = 0.02
    periods: float = 1.0  # by which frames are late, each way
    tightest: float = 1.5


TROUBLE = Trouble()


class Found(NamedTuple):
    """What became of a drive.

    `flips`: times that the chassis went from pull to push; `first_flip`: s. `nearest`: rad that were left to neutral
    steering, negative beyond it. `step`: the largest change of what a motor is told, in units of its limit.
    `differing`: cycles to which the second core answered otherwise.
    """

    cycles: int
    flips: int
    first_flip: float | None
    nearest: float
    error: float  # rad, the largest that the core saw
    step: float
    differing: int
    modes: tuple[Mode, ...]
    ended: str | None  # why the robot did not go on

    @property
    def sound(self) -> bool:
        """No motor was told more than its limit, and both cores said the same."""
        return self.step <= 1.0 + ROUNDING and not self.differing


def robot(rate: float, *, compensated: bool) -> tuple[RobotConfig, str]:
    """moby with motors that have limits, its feedback as fast as its loop."""
    text = robot_text("moby", rate_hz=rate).replace("feedback_rate = 250.0", f"feedback_rate = {rate}")
    text = text.replace("[[bus]]", LIMITS.format(*MOST), 1)
    text = text.replace("[robot.body]", COMPENSATION, 1) if compensated else text
    return parse(text, "moby"), text


class Course:
    """What is commanded: a velocity whose direction over the ground turns no tighter than a radius allows.

    Nor faster than a pulled chassis can be led: in balance it lies p = asin(d1/r) off its path's tangent and turns at
    (c/d1) sin p. Its fastest turn is c/d1, so p' < (c/d1)(1 - sin p) whoever corrects; LED of that is used.
    """

    def __init__(self, seed: int, tightest: float) -> None:
        self._chance = Random(seed)
        self._radius = tightest * D1
        self._left = 0.0  # s of this piece
        self._speed, self._rate, self._direction = 0.0, 0.0, self._chance.uniform(-pi, pi)
        self._tightness = 0.0  # sine of how far the chassis lies off its path's tangent: d1 over the radius
        self._turn = 0.0  # rad/s of the platform, its share of the path's rate
        self._wanted = (0.0, 0.0, 0.0)

    @property
    def direction(self) -> float:
        """Of the velocity, rad in the platform's frame."""
        return self._direction

    def next(self, seconds: float) -> tuple[Twist, float | None]:
        """The command of now, and the path rate where this piece tells it."""
        if self._left <= 0.0:
            self._begin()
        self._left -= seconds
        speed, rate, share = self._wanted
        self._speed = _towards(self._speed, speed, SPEEDING * seconds)
        self._rate = self._led(_towards(self._rate, rate, CURVING * seconds), seconds)
        self._turn = _towards(self._turn, max(-TURN, min(TURN, share * self._rate)), TURNING * seconds)
        self._direction += (self._rate - self._turn) * seconds
        twist = Twist(self._speed * cos(self._direction), self._speed * sin(self._direction), self._turn)
        return twist, self._rate if self._tells else None

    def _led(self, rate: float, seconds: float) -> float:
        """A rate to which the chassis can turn in time, rad/s."""
        per_d1 = self._speed / D1
        tightest = min(D1 / self._radius, D1 * ACROSS / (self._speed * self._speed))
        wanted = max(-tightest, min(tightest, rate / per_d1))
        if abs(wanted) > abs(self._tightness):
            spare = max(0.0, 1.0 - abs(self._tightness))
            wanted = _towards(self._tightness, wanted, LED * per_d1 * spare * sqrt(spare * (2.0 - spare)) * seconds)
        self._tightness = wanted
        return wanted * per_d1

    def _begin(self) -> None:
        chance = self._chance
        speed = chance.choice([TOP[1], chance.uniform(*TOP)])
        most = speed / self._radius
        bend = chance.choice([0.0, chance.uniform(-most, most), most, -most])
        self._wanted = (speed, bend, chance.choice([0.0, 1.0, chance.random()]))
        self._tells = chance.random() < 0.5
        self._left = chance.uniform(1.0, 5.0)


def drive(
    seed: int,
    rate: float,
    *,
    compensated: bool,
    seconds: float,
    trouble: Trouble = TROUBLE,
    put: Put | None = None,
) -> Found:
    """The random drive of this number. `put` takes every cycle, as the recorder does."""
    config, _ = robot(rate, compensated=compensated)
    course, chance = Course(seed, trouble.tightest), Random(f"pushes {seed}")
    loop = ClosedLoop(config, joint_angles={"platform": pi - course.direction})
    again, judge = Engine(config), _Judge(rate)
    bus, begin_ns = loop.bus, loop.next_ns
    bus.advance(begin_ns)
    bus.delay("can0", trouble.periods / rate)
    pushes = _pushes(chance, seconds, trouble.push)
    command_due, driving = ANSWERS_S, False
    for cycle in range(round(seconds * rate)):
        t = cycle / rate
        while pushes and pushes[0][0] <= t:
            bus.advance(begin_ns + round(pushes[0][0] * 1e9))
            bus.robot.set_push(pushes.pop(0)[1])
        commands = []
        if t >= command_due:
            twist, told = course.next(COMMANDS_S) if driving else (ZERO_TWIST, None)
            commands = [TwistCommand("teleop", twist, TwistFrame.BODY, None, loop.next_ns, path_rate=told)]
            command_due += COMMANDS_S
        inputs, outputs = loop.cycle(commands=commands)
        if outputs.mode is Mode.DRIVE and not driving:
            driving = True
            bus.drop("can0", received=trouble.loss, sent=trouble.loss, seed=seed)
        if put is not None:
            put(inputs, outputs, loop.engine.snapshot)
        judge.look(t, outputs, bus.robot.truth, same=again.step(inputs) == outputs)
        if driving and outputs.mode is not Mode.DRIVE:  # a motor counts as silent by chance, now and then
            break
    return judge.found()


class _Judge:
    """Collects what is found."""

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._cycles = self._flips = self._differing = 0
        self._pulled = False
        self._first: float | None = None
        self._nearest, self._error, self._step = pi, 0.0, 0.0
        self._modes: list[Mode] = []
        self._reason: str | None = None
        self._told: Sequence[float | None] = (None,) * len(MOST)

    def look(self, t: float, outputs: Outputs, truth: Truth, *, same: bool) -> None:
        """One cycle."""
        self._cycles += 1
        self._differing += not same
        if not self._modes or self._modes[-1] is not outputs.mode:
            self._modes.append(outputs.mode)
            self._reason = outputs.status.reason if outputs.status else None
        self._look_at_wheels(outputs.trace.wheel_setpoints)
        vx, vy, _ = truth.twist
        if hypot(vx, vy) < TOP[0] / 2.0:
            return
        error = outputs.trace.chassis[2]
        if error is not None:
            self._error = max(self._error, abs(error))
        along = cos(atan2(vy, vx) + truth.joint_angles[STEERED])
        self._nearest = min(self._nearest, acos(along) - pi / 2.0)
        if along < -ACROSS_COSINE:
            self._pulled = True
        elif along > ACROSS_COSINE and self._pulled:
            self._pulled = False
            self._flips += 1
            self._first = t if self._first is None else self._first

    def _look_at_wheels(self, told: Sequence[float | None]) -> None:
        for before, now, most in zip(self._told, told, MOST, strict=True):
            if before is not None and now is not None:
                self._step = max(self._step, abs(now - before) * self._rate / most)
        self._told = told

    def found(self) -> Found:
        """All of it."""
        return Found(
            self._cycles,
            self._flips,
            self._first,
            self._nearest,
            self._error,
            self._step,
            self._differing,
            tuple(self._modes),
            self._reason,
        )


def _pushes(chance: Random, seconds: float, most: float) -> list[tuple[float, float]]:
    """When which force begins to act, N along world x."""
    found, t = [], 4.0
    while t < seconds:
        end = t + chance.uniform(0.1, 0.3)
        found += [(t, chance.uniform(-most, most)), (end, 0.0)]
        t = end + chance.uniform(2.0, 6.0)
    return found


def _towards(now: float, wanted: float, most: float) -> float:
    return max(now - most, min(now + most, wanted))


def recorded(seed: int, rate: float, *, seconds: float, trouble: Trouble, directory: Path) -> tuple[Found, Verdict]:
    """The compensated drive as a session in this directory, and what verify says to that."""
    config, text = robot(rate, compensated=True)
    session = SessionRecording(config, text, "moby.toml", directory=directory, started_wall_ns=STARTED_WALL_NS)
    found = drive(seed, rate, compensated=True, seconds=seconds, trouble=trouble, put=session.put)
    session.close()
    return found, verify(open_session(session.session))

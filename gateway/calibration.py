"""Finds how the floor grips: launches, harder each time, until wheels slip.

How this works
--------------
The friction that the no-slip launch goes by (`gateway.control.launch`) is raised before each pair of launches, so they
push a little harder: with more torque or, where motors are told voltages, from a voltage V0 a step higher (Rojas 2005,
section 8). Once wheels slip, and in one pair harder still, the law tells what the floor gave them: that is what a
launch may count on. (Slip is seen only from some 20 % above, so the last friction that held would be too much.) Each
pair goes out and back; one that has to be done again goes back first, and never on in the same direction: the robot
stays within one launch of where it began. The first round along an axis looks for it in coarse
steps, the others in fine steps from what the first found.
"""

from collections.abc import Callable
from enum import Enum
from math import cos, sin
from typing import Final, NamedTuple

from gateway.client import Client
from gateway.commander import ANSWER_TIMEOUT_S, objection, rest, start, stream, unrested
from gateway.config import RobotConfig
from gateway.control.launch import FRICTION, LEAST_FRICTION, LOOKS, MOST_FRICTION, SAFE
from gateway.core.assembly import build
from gateway.core.settings import LIMITING
from gateway.edges.messages import OdometryMessage, StateMessage
from gateway.types import ZERO_TWIST, Mode, Status

FIRST: Final = 0.5  # of what the robot file says: where the first round along an axis begins
COARSE: Final = 1.25  # from step to step, in the first round
FINE: Final = 1.05  # in the others
HARDER: Final = 1.15  # than where wheels began to slip: what the floor gives is told there
_SAME: Final = 1e-3  # of a friction
DWELL: Final = 0.15  # s of the full push; slip is looked for every 0.04 s
RESTING: Final = (Mode.IDLE, Mode.STARTING, Mode.STOPPING)  # of a robot that was told nothing for a moment
TRIES: Final = 10  # of a launch in which nobody looked for slip: a loop that is late does not, for a while


class CalibrationError(RuntimeError):
    """Why nothing was found; the robot is at rest, or does not obey."""


class LimitError(CalibrationError):
    """Another limit than the floor's would be reached first."""


class Axis(Enum):
    """Along which a pair of launches goes, out and back."""

    X = "forward and back"
    Y = "left and right"


class Launch(NamedTuple):
    """From rest to `speed` (m/s, below 0: back) for so many s, with as much as this friction bears."""

    axis: Axis
    friction: float
    speed: float
    seconds: float


class Found(NamedTuple):
    """Of a round: what the floor gave when the wheels slipped, of the load, and for how much it was taken then."""

    axis: Axis
    friction: float
    taken_for: float


class Plans:
    """Which launch tells of a friction; by the robot's own law and limits."""

    def __init__(self, config: RobotConfig) -> None:
        """Raises CalibrationError for a robot that is not launched by friction."""
        self._law = build(config).law
        if not self._law.features.grip:
            raise CalibrationError("the robot file has no [robot.grip], which is what this finds the friction for")
        self._limits = config.limits
        self._silence = max(source.timeout for source in config.commands.source)
        self.given = self._law.settings[FRICTION]  # by the robot file
        self.first = max(LEAST_FRICTION, FIRST * self.given)

    def launch(self, axis: Axis, friction: float) -> Launch:
        """Raises LimitError."""
        name = "vx" if axis is Axis.X else "vy"
        top, limit, jerk = (getattr(limits, name) for limits in self._limits.axes().values())
        share = self._share(axis, friction, limit)
        if share >= 1.0:
            raise LimitError(
                f"{axis.value}: with a friction of {friction:.2f} the wheels hold all of limits.acceleration.{name} = "
                f"{limit:g} m/s^2: the floor never limits this robot, or that limit is too low to find out"
            )
        if self._share(axis, friction * COARSE, limit) <= share:
            raise LimitError(
                f"{axis.value}: with a friction of {friction:.2f} the wheels hold all that the motors give "
                f"({share * limit:.2f} m/s^2): the floor never limits this robot"
            )
        acceleration = share * limit
        speed = acceleration * (acceleration / jerk + DWELL)
        if speed > top:
            raise LimitError(
                f"{axis.value}: with a friction of {friction:.2f} the wheels hold, and to push harder for {DWELL:g} s "
                f"takes {speed:.2f} m/s, more than limits.velocity.{name} = {top:g}: raise that, or limits.jerk.{name}"
            )
        return Launch(axis, friction, speed, 2.0 * acceleration / jerk + DWELL)

    def _share(self, axis: Axis, friction: float, limit: float) -> float:
        """Of an acceleration limit along the axis, that the floor and the motors bear."""
        self._law.set(FRICTION, friction)
        way = (limit, 0.0, 0.0) if axis is Axis.X else (0.0, limit, 0.0)
        ground = self._law.ground(whole=True)
        return 1.0 if ground is None else ground.effort((0.0, 0.0, 0.0), way, (0.0, 0.0, 0.0))

    def furthest(self) -> float:
        """M from where it begins, in the hardest launch that these limits allow, also if its last command is late."""
        return max(self._furthest(axis) for axis in Axis)

    def _furthest(self, axis: Axis) -> float:
        friction, furthest = self.first, 0.0
        try:
            while friction <= MOST_FRICTION:
                launch = self.launch(axis, friction)
                # Speeding up and slowing down is half of it each; at top speed it goes on as long as nobody says more.
                furthest = max(furthest, launch.speed * (launch.seconds + self._silence))
                friction *= COARSE
        except LimitError:
            return furthest
        return furthest


def find(
    plans: Plans, drive: Callable[[Launch], float], rounds: int, told: Callable[[Found], None] = lambda _: None
) -> list[Found]:
    """What the floor gave in every round along both axes.

    `drive` does a launch and says for which friction the robot takes the floor after it. Raises CalibrationError where
    another limit than the floor's comes first.
    """
    found = []
    for axis in Axis:
        first = _round(plans, drive, axis, plans.first, COARSE)
        begin = max(LEAST_FRICTION, first.friction)
        for _ in range(rounds):
            one = _round(plans, drive, axis, begin, FINE)
            told(one)
            found.append(one)
    return found


def _round(plans: Plans, drive: Callable[[Launch], float], axis: Axis, begin: float, ratio: float) -> Found:
    friction = begin
    while friction <= MOST_FRICTION:
        given = _pair(plans.launch(axis, friction), drive)
        harder = _harder(plans, drive, axis, friction * HARDER) if given else []
        if harder is None or harder:
            return Found(axis, max([*given, *(harder or ())]), friction)
        friction *= ratio
    raise CalibrationError(f"{axis.value}: nothing slipped, and more than a friction of {friction / ratio:.2f} is none")


def _harder(plans: Plans, drive: Callable[[Launch], float], axis: Axis, friction: float) -> list[float] | None:
    """What the floor gives wheels that slip from the start on, which tells it better; None where limits forbid.

    Nothing, where they do not slip: then what was seen before was no slip either.
    """
    try:
        return _pair(plans.launch(axis, friction), drive)
    except LimitError:
        return None


def _pair(out: Launch, drive: Callable[[Launch], float]) -> list[float]:
    """Out and back, whatever the first says: what the floor gave where wheels slipped."""
    left = [drive(out), drive(out._replace(speed=-out.speed))]
    return [one / SAFE for one in left if one < out.friction * (1.0 - _SAME)]


class Driver:
    """Does the launches of a robot that runs, as a commander like any other; one thread.

    `given`: the friction of its robot file.
    """

    def __init__(self, client: Client, source: str, given: float) -> None:
        self._client = client
        self._source = source
        self._given = given
        self._driven = False
        self._began: OdometryMessage | None = None  # where it stood before the first launch

    def __call__(self, launch: Launch) -> float:
        """One launch from rest to rest; the friction the robot goes by after it. Raises CalibrationError.

        One that was not looked at, or not driven to its end, says nothing of the floor, and is done again.
        """
        for _ in range(TRIES):
            before = self._fact(LOOKS)
            if self._launch(self._homewards(launch)):
                friction = self._fact(FRICTION)
                if friction < launch.friction or self._fact(LOOKS) > before:
                    return friction
        raise CalibrationError(
            f"in {TRIES} launches nothing could tell slip: the loop of the service is late too often, or motors tell "
            "their torque less than a hundred times a second"
        )

    def _homewards(self, launch: Launch) -> Launch:
        """The same launch, the other way round from where it would lead away from where the first one began."""
        client = self._client
        client.wait_for_state(lambda _: client.odometry() is not None, ANSWER_TIMEOUT_S)
        here = client.odometry()
        if here is None:
            raise CalibrationError("the robot does not tell where it is")
        self._began = self._began or here
        x, y = here.x - self._began.x, here.y - self._began.y
        ahead = (cos(here.theta), sin(here.theta)) if launch.axis is Axis.X else (-sin(here.theta), cos(here.theta))
        away = (x * ahead[0] + y * ahead[1]) * launch.speed > 0.0
        return launch._replace(speed=-launch.speed) if away else launch

    def _launch(self, launch: Launch) -> bool:
        """Whether it was driven to its end; else a command was late. Nothing that waits stands between its commands."""
        client, source = self._client, self._source
        answer = client.set(FRICTION, launch.friction, ANSWER_TIMEOUT_S)
        if not answer.ok:
            raise CalibrationError(f"setting {FRICTION} = {launch.friction:.3f}: {answer.reason}")
        self._driven = True
        if not start(client, source):
            raise CalibrationError(f"does not start: {objection(client, source) or 'it drove too late'}")
        _check(client.state())
        vx, vy = (launch.speed, 0.0) if launch.axis is Axis.X else (0.0, launch.speed)
        reason = stream(client, source, vx, vy, 0.0, seconds=launch.seconds)
        if not rest(client, source):
            raise CalibrationError(unrested(client))
        if reason is not None and _check(client.state()).mode not in RESTING:
            raise CalibrationError(reason)
        return reason is None

    def _fact(self, name: str) -> float:
        """Of the chassis, as a whole robot tells it. Raises CalibrationError."""
        value = self._whole().chassis.get(name)
        if not isinstance(value, float):
            raise CalibrationError(f"the robot does not tell its {name}")
        return value

    def put_back(self) -> None:
        """After the last launch, however it ended: the robot goes by the friction of its file, as after its start.

        What was tried last may be far more than the floor gives.
        """
        if self._driven:
            self._client.send_twist(*ZERO_TWIST, source=self._source)
        self._client.set(FRICTION, self._given, ANSWER_TIMEOUT_S)

    def _whole(self) -> Status:
        return _check(self._client.status(ANSWER_TIMEOUT_S))


def _check(state: StateMessage | None) -> Status:
    """Of a robot with all its motors and all its speed: no other is launched. Raises CalibrationError."""
    if state is None:
        raise CalibrationError(f"the robot did not tell its state within {ANSWER_TIMEOUT_S:g} s")
    status = state.status
    if status.mode is Mode.DEGRADED:
        raise CalibrationError(f"mode {status.mode.value}: {status.reason}")
    for setting in status.settings:
        if setting.name in LIMITING and setting.value < setting.high:
            raise CalibrationError(f"{setting.name} = {setting.value:g}: must be {setting.high:g} for it")
    return status

"""Whether a robot may drive the way round that a command asks for, and how it gets there first.

How this works
--------------
A command with region "push" or "pull" is driven as it is where the chassis lies so that pushing, or the compensation,
takes on what is left of the error. Otherwise nothing moves until the chassis has been turned round, from rest and by a
manoeuvre (`gateway.control.manoeuvre`): planned, told in `state` and by an event for NOTICE seconds, then driven piece
by piece, each from rest to rest, closed over the measured joint angle and wheel angles. Then the command is driven.

                      out of region, at rest            done
    none <-> held ------------------------> planned -> turning, driving -> done -> held
              |   out of region, moving        |             |
              |-> resting (brakes to rest)     |             |-> ending (brakes along its piece) -> none
              |-> lost (brakes, sticks)        |-> none
              '-> refused (stays at rest, sticks)

Authority only shrinks. Before the limits of the body, `aim` leaves a command as it is, or takes speed from it, down to
zero; behind them the drive law turns the velocity into the piece at work, never faster than the setpoint. So the speed
is within the command and every limit, and whatever stops the setpoint stops the manoeuvre: another command (of another
region, or by more than DIRECTION off), zero, silence, a fault, a lost motor, an angle that is not known, all end it.
It does not go on by itself, and a robot that brakes stays on its piece. Nor is any piece driven by more than a fifth
beyond its way, whatever is measured: an encoder that is stuck leads it no further than that.

A command that meets the robot in motion the wrong way round brakes it to rest first. What was driven in its region and
has left it (a push, a setting) is lost: it brakes, and stays at rest until somebody commands zero. A gain that keeps
nothing pulled is no such accident: the robot is braked while it still lies well, and the region refused.
"""

from collections.abc import Sequence
from enum import Enum
from math import pi, sqrt
from typing import Final, NamedTuple

from gateway.control.manoeuvre import (
    LANDING_TIME,
    REACHED,
    Form,
    Limits,
    Pace,
    Piece,
    Plan,
    Way,
    landing_speed,
    length,
    plan,
)
from gateway.control.pull_region import LEAST_SPEED, examine, wrapped
from gateway.types import Event, Facts, Level, Rates, Region

NOTICE: Final = 0.2  # s, from the plan in `state` to the first motion: time to take the command back. Source: ours
MOST_WAIT: Final = 2.0  # s for rest at the end of a piece; a tenth of it is usual. Source: ours
TAKEN_ON: Final = 1.0  # rad of error with which it drives as it is
HELD_TO: Final = 1.3  # rad of error, while it drives, at which the region is lost; 1.57 is across
_OF_CORRECTED: Final = 0.9  # of the errors that are corrected, with which it drives as it is
_DIRECTION: Final = 0.98  # cosine of 0.2 rad, by which a command may turn and still be the same
_TOO_FAR: Final = 1.2  # times the way of a piece, and what late motors leave: it is not where it seems to be
_STILL: Final = 0.02  # m/s and a tenth of a rad/s of the platform that count as rest
_DEGREES: Final = 180.0 / pi

NO_PACE: Final = Pace(0.0, 0.0, 0.0)
# Members of enumerations, each looked up once: where every cycle does, it takes a tenth of its time.
_ANY: Final = Region.ANY
_PULL: Final = Region.PULL
_TURN: Final = Way.TURN


class Stage(Enum):
    """Where it is, as `state` tells it."""

    NONE = "none"
    HELD = "held"
    RESTING = "resting"
    PLANNED = "planned"
    TURNING = "turning"
    DRIVING = "driving"
    ENDING = "ending"
    DONE = "done"
    REFUSED = "refused"
    LOST = "lost"


_IDLE: Final = Stage.NONE
_HELD: Final = Stage.HELD
_AT_WORK: Final = frozenset({Stage.TURNING, Stage.DRIVING, Stage.ENDING})  # the law drives a piece
_UNDER_WAY: Final = _AT_WORK | {Stage.PLANNED}
_MANOEUVRING: Final = _UNDER_WAY | {Stage.DONE}
_HELD_BACK: Final = frozenset({Stage.RESTING, Stage.REFUSED, Stage.LOST})
_STAGES: Final = {Way.TURN: Stage.TURNING, Way.DRIVE: Stage.DRIVING}


class Wish(NamedTuple):
    """What a command asks for: the way round, the direction in the platform frame, m/s, and rad/s of its path."""

    region: Region
    x: float  # unit vector
    y: float
    speed: float
    path_rate: float


class Seen(NamedTuple):
    """What is measured and known in this cycle; None: not known.

    `joint`: its angle, rad; `way`: mean of the ways of both wheels, m, from anywhere; `velocity`: of the setpoint as it
    was driven; `still`: nothing was told to move, and nothing does; `corrected`: largest error that is corrected, rad,
    at the speed of now, and at any speed; `whole`: every motor is well.
    """

    dt: float
    joint: float | None
    way: float | None
    velocity: tuple[float, float]
    still: bool
    corrected: tuple[float, float]
    whole: bool


class RegionPolicy:
    """State owner: the stage, what was asked for, the plan and how far it is."""

    def __init__(self, *, form: Form, max_footprint: float, limits: Limits, axle_offset: float) -> None:
        """`max_footprint`: m."""
        self._form = form
        self._max_footprint = max_footprint
        self._limits = limits
        self._axle_offset = axle_offset
        self._stage = Stage.NONE
        self._wish: Wish | None = None
        self._reason: str | None = None
        self._plan: Plan | None = None
        self._place = 0  # of the piece at work
        self._joint_goal = 0.0  # angle of the joint when the last turn is done, rad
        self._goal = 0.0  # of the piece at work: its joint angle, rad, or its way, m
        self._reached = False  # the piece is done, and comes to rest
        self._elapsed = 0.0  # s since the plan
        self._waited = 0.0  # s for rest at its end
        self._gone = 0.0  # m that the piece at work was told to go
        self._allowed = 0.0  # m/s in this cycle
        self._after = Stage.NONE  # where it is once it has ended
        self._news: tuple[Event, ...] = ()

    # for the drive law

    @property
    def idle(self) -> bool:
        """Whether nobody asks for a region, and nothing is left of what somebody did."""
        return self._stage is _IDLE

    @property
    def at_work(self) -> bool:
        """Whether a piece is driven, or braked."""
        return self._stage in _AT_WORK

    @property
    def asked(self) -> Region:
        """The way round that it drives, as a command asked for it."""
        return self._wish.region if self._stage is _HELD and self._wish is not None else _ANY

    @property
    def direction(self) -> tuple[float, float]:
        """Of the piece at work: ahead along the chassis, and across to its left; one of them is 1 or -1."""
        way, size = self._piece()
        sign = 1.0 if size > 0.0 else -1.0
        return (0.0, sign) if way is _TURN else (sign, 0.0)

    @property
    def limits(self) -> tuple[str, ...]:
        """Those at work, by name."""
        if self._stage in _MANOEUVRING:
            return ("manoeuvre",)
        return ("region",) if self._stage in _HELD_BACK else ()

    @property
    def facts(self) -> Facts:
        """What there is to tell of this."""
        planned = self._plan if self._stage in _MANOEUVRING else None
        return {
            "manoeuvre": self._stage.value,
            "manoeuvre_footprint": None if planned is None else planned.footprint,
            "manoeuvre_duration": None if planned is None else planned.duration + NOTICE,
            "manoeuvre_reason": self._reason if self._stage in _HELD_BACK else None,
        }

    def news(self) -> tuple[Event, ...]:
        """What has happened since it was asked last."""
        news, self._news = self._news, ()
        return news

    def stop(self) -> None:
        """An emergency stop."""
        self._stage = Stage.NONE

    def brake(self) -> None:
        """The robot is on its way to rest, for whatever reason."""
        if self._stage is Stage.DONE:
            self._stage = Stage.NONE
        elif self._stage in _UNDER_WAY and self._stage is not Stage.ENDING:
            self._end("the robot brakes")

    def aim(self, target: Rates, seen: Seen, *, region: Region, path_rate: float | None) -> Rates:
        """What of this target, m/s and rad/s, may be driven towards now: all of it, less, or nothing yet."""
        if self._stage in _UNDER_WAY:
            return self._go_on(target, seen, _wish(target, region, path_rate))
        wish = _wish(target, region, path_rate) if region is not _ANY else None
        if wish is None:
            self._stage = Stage.NONE
            return target
        if self._sticks(wish):
            return _nothing(target)
        self._stage, self._reason = self._judged(wish, seen)
        self._wish = wish
        return target if self._stage is Stage.HELD else _nothing(target)

    def share(self, speed: float, seen: Seen, *, at_rest: bool) -> float:
        """Of the setpoint's speed, m/s, that the piece at work may have; `at_rest`: nothing is told to move any more.

        Braking, it stays within its piece as long as it is known how far it is. It never stops dead, whatever an angle
        that jumps makes of the way that is left: a fall by twice what is planned is what the limits allow.
        """
        if self._stage is Stage.ENDING:
            if at_rest:
                self._stage = self._after
                return 1.0
            left = self._left(seen)
            allowed = speed if left is None else landing_speed(left, self._pace().braking)
        else:
            allowed = self._allowed
        vx, vy = seen.velocity
        allowed = max(allowed, sqrt(vx * vx + vy * vy) - 2.0 * self._pace().braking * seen.dt)
        self._gone += min(allowed, speed) * seen.dt
        return allowed / speed if allowed < speed else 1.0

    # which way round

    def _sticks(self, wish: Wish) -> bool:
        """Whether it has been refused or lost, and nothing has been asked for since that is another thing."""
        return self._stage is Stage.LOST or (self._stage is Stage.REFUSED and _same(self._wish, wish))

    def _judged(self, wish: Wish, seen: Seen) -> tuple[Stage, str | None]:
        """Where it is now, and why it is held back; None: it is not."""
        error, refusal = self._error(wish, seen)
        if not seen.still:
            driven, lost = self._error_driven(wish, seen), self._largest_driven(wish, seen)
            if self._stage is Stage.HELD and abs(driven) > lost and refusal is None:
                return self._held_back(Stage.LOST, f"the chassis has left the {wish.region.value} region")
            most = HELD_TO if self._stage is Stage.HELD else _largest(wish, seen)
            if refusal is None and abs(error) <= most and abs(driven) <= lost:
                return Stage.HELD, None
            return Stage.RESTING, refusal or f"it moves, and is not in the {wish.region.value} region of the command"
        if refusal is not None:
            return self._held_back(Stage.REFUSED, refusal)
        if abs(error) <= _largest(wish, seen):
            return Stage.HELD, None
        return self._planned(wish, seen, error)

    def _error(self, wish: Wish, seen: Seen) -> tuple[float, str | None]:
        """By which the chassis lies off the balance that is asked for, rad, and why it cannot lie there."""
        if seen.joint is None:
            return 0.0, "the angle of the platform joint is unknown"
        pull = examine(
            wish.x * wish.speed,
            wish.y * wish.speed,
            angle=seen.joint,
            path_rate=wish.path_rate,
            axle_offset=self._axle_offset,
        )
        if pull is None:
            return 0.0, "it is too slow to have a direction"
        if pull.saturated:
            return (
                0.0,
                f"the path turns tighter than axle_offset = {self._axle_offset:g} m: no chassis stays in a region",
            )
        if wish.region is _PULL and seen.corrected[1] <= 0.0:
            return pull.error, "nothing keeps the robot pulled: compensation_gain must be above 1"
        return pull.error if wish.region is _PULL else wrapped(pull.error - pi + 2.0 * pull.goal), None

    def _error_driven(self, wish: Wish, seen: Seen) -> float:
        """The same of the velocity that is driven; without one it has no direction to be off."""
        vx, vy = seen.velocity
        speed = sqrt(vx * vx + vy * vy)
        if speed < LEAST_SPEED:
            return 0.0
        return self._error(wish._replace(x=vx / speed, y=vy / speed), seen)[0]  # off the balance of the command

    @staticmethod
    def _largest_driven(wish: Wish, seen: Seen) -> float:
        return min(HELD_TO, seen.corrected[0]) if wish.region is _PULL else HELD_TO

    def _held_back(self, stage: Stage, reason: str) -> tuple[Stage, str]:
        until = "zero" if stage is Stage.LOST else "zero or another direction"
        self._tell(Level.WARNING, f"region_{stage.value}", f"{reason}; it stays at rest until {until} is commanded")
        return stage, reason

    def _planned(self, wish: Wish, seen: Seen, error: float) -> tuple[Stage, str | None]:
        """At rest and out of region: the manoeuvre, if there may be one."""
        if self._stage is Stage.DONE and _same(self._wish, wish):
            return self._held_back(Stage.REFUSED, f"the manoeuvre has not reached the {wish.region.value} region")
        if not seen.whole:
            return self._held_back(Stage.REFUSED, "a motor is lost: no manoeuvre leads to the region")
        found = plan(self._form, error, self._limits.pace(wish.speed, self._axle_offset), axle_offset=self._axle_offset)
        words = f"it would leave its place by {found.footprint:.3f} m"
        if found.footprint > self._max_footprint:
            bound = f"robot.manoeuvre.max_footprint = {self._max_footprint:g} m"
            return self._held_back(Stage.REFUSED, f"{words} to get into the {wish.region.value} region: {bound}")
        self._plan, self._place, self._elapsed, self._reached = found, -1, 0.0, False
        text = f"turns its chassis by {error * _DEGREES:.0f} degrees first: leaves its place by {found.footprint:.3f} m"
        self._tell(Level.INFO, "manoeuvre_planned", f"{text}, takes {found.duration + NOTICE:.1f} s")
        return Stage.PLANNED, None

    # the manoeuvre

    def _go_on(self, target: Rates, seen: Seen, wish: Wish | None) -> Rates:
        """One cycle of it."""
        self._elapsed += seen.dt
        if self._stage is Stage.ENDING:
            return _nothing(target)
        end = self._why_end(wish, seen)
        if wish is None or end is not None:
            self._end(end or "the command")
            return _nothing(target)
        if self._stage is Stage.PLANNED:
            if self._elapsed >= NOTICE:
                self._begin(0, seen)
            return _nothing(target)
        left = self._left(seen) or 0.0
        self._reached = self._reached or left <= REACHED * self._axle_offset
        if self._reached:
            self._allowed = 0.0
            self._waited += seen.dt
            if seen.still:
                self._begin(self._place + 1, seen)
            return _nothing(target)
        pace = self._pace()
        vx, vy = seen.velocity
        rising = sqrt(vx * vx + vy * vy) + pace.acceleration * seen.dt
        most = min(pace.speed, wish.speed, landing_speed(left, pace.braking))
        self._allowed, share = min(most, rising), most / wish.speed
        return (target[0] * share, target[1] * share, *_nothing(target)[2:])

    def _why_end(self, wish: Wish | None, seen: Seen) -> str | None:
        if wish is None or not _same(self._wish, wish):
            return "another command"
        if not seen.whole:
            return "a motor is lost"
        if seen.joint is None or seen.way is None:
            return "an angle that it goes by is unknown"
        if self._stage in _AT_WORK and self._gone > self._most():
            self._after = Stage.REFUSED
            return "driven further than planned: something holds it, or an angle that it goes by is wrong"
        if self._stage in _AT_WORK and self._waited > MOST_WAIT:
            return "it does not come to rest"
        return None

    def _begin(self, place: int, seen: Seen) -> None:
        """The next piece, from rest; or there is none, and it is done."""
        joint, way = seen.joint, seen.way
        if self._plan is None or joint is None or way is None:
            return
        if place == len(self._plan.pieces):
            self._stage = Stage.DONE
            self._tell(Level.INFO, "manoeuvre_done", f"after {self._elapsed:.1f} s")
            return
        if place == 0:
            self._joint_goal, self._after = joint, Stage.NONE
        self._place, self._reached, self._allowed, self._gone = place, False, 0.0, 0.0
        self._waited = 0.0
        piece = self._plan.pieces[place]
        self._stage = _STAGES[piece.way]
        if piece.way is _TURN:
            self._joint_goal -= piece.size  # the platform keeps its heading, so its joint turns against the chassis
            self._goal = self._joint_goal
        else:
            self._goal = way + piece.size

    def _end(self, reason: str) -> None:
        """Brake along the piece at work; what has not begun is just not begun."""
        self._tell(Level.WARNING, "manoeuvre_ended", reason)
        self._reason = reason
        self._stage = Stage.NONE if self._stage is Stage.PLANNED else Stage.ENDING

    def _left(self, seen: Seen) -> float | None:
        """Way that the joint has to go on this piece, m; None: not known."""
        way, size = self._piece()
        sign = 1.0 if size > 0.0 else -1.0
        if way is _TURN:
            return None if seen.joint is None else sign * (seen.joint - self._goal) * self._axle_offset
        return None if seen.way is None else sign * (self._goal - seen.way)

    def _piece(self) -> Piece:
        pieces: Sequence[Piece] = () if self._plan is None else self._plan.pieces
        return pieces[self._place]

    def _pace(self) -> Pace:
        return NO_PACE if self._plan is None else self._plan.pace

    def _most(self) -> float:
        """Way that a piece may be driven, whatever is measured, m."""
        return _TOO_FAR * length(self._piece(), self._axle_offset) + LANDING_TIME * self._pace().speed

    def _tell(self, level: Level, code: str, text: str) -> None:
        self._news = (*self._news, Event(level, code, text))


def still(told: Sequence[float] | None, rates: Rates | None) -> bool:
    """Whether nothing was told to move, rad/s, and the measured body does not; None: nothing was told, not known."""
    if rates is None or (told is not None and any(told)):
        return False
    vx, vy, wz = rates
    return max(abs(vx), abs(vy), 0.1 * abs(wz)) <= _STILL


def _wish(target: Rates, region: Region, path_rate: float | None) -> Wish | None:
    """None without a direction: the way round does not matter."""
    vx, vy, wz = target
    speed = sqrt(vx * vx + vy * vy)
    if speed < LEAST_SPEED or region is _ANY:
        return None
    return Wish(region, vx / speed, vy / speed, speed, wz if path_rate is None else path_rate)


def _same(before: Wish | None, wish: Wish) -> bool:
    return before is not None and before.region is wish.region and before.x * wish.x + before.y * wish.y >= _DIRECTION


def _largest(wish: Wish, seen: Seen) -> float:
    """Error with which it drives as it is, rad."""
    return min(TAKEN_ON, _OF_CORRECTED * seen.corrected[1]) if wish.region is _PULL else TAKEN_ON


def _nothing(target: Rates) -> Rates:
    return (0.0,) * len(target)

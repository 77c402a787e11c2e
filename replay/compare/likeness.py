"""Two sessions of the same commands: do they drive alike?

How this works
--------------
Both are run through the core, which yields pose, wheel speeds and mode of every cycle, and compared over the time that
both cover, counted from the first command. Equal they cannot be: times of arrival differ, and so did the real robot,
if it was one; the thresholds say what counts as alike.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from itertools import dropwhile, groupby, pairwise
from math import cos, dist, pi, sin, sqrt
from typing import NamedTuple

from gateway.config import RobotConfig, parse
from gateway.types import Mode, Pose
from replay.compare.replay import Replay
from replay.sessions.reader import Session

GRID_NS = 20_000_000

END_M, END_RAD = 0.05, 0.05  # plus 2 % of the path: lateness of single commands, at speed
LARGEST_M = 0.10
PATH_SHARE = 0.02
WHEELS_SHARE = 0.03  # rms of the differences, of the top speed of each wheel


class Moment(NamedTuple):
    """One cycle of a drive, in time since its first command."""

    time_ns: int
    pose: Pose
    wheels: tuple[float | None, ...]
    mode: Mode


class Comparison(NamedTuple):
    """How the second drive differs from the first; `reasons` is empty if they are alike."""

    path_m: float
    end_m: float
    end_rad: float
    largest_m: float
    wheels_rms: float  # share of the top speed, worst wheel
    modes_recorded: tuple[str, ...]
    modes_redriven: tuple[str, ...]
    reasons: tuple[str, ...]
    session: str

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        return {"similar": not self.reasons, **self._asdict()}


def moments(session: Session) -> list[Moment]:
    """Every cycle of a session from its first command on, as the core says it was, up to the first that is missing.

    A session whose beginning is elsewhere begins behind its first snapshot of the core.
    """
    replay = Replay(parse(session.config_text, "robot file of the session"), session.snapshot)
    origin_ns = following = None
    found: list[Moment] = []
    for inputs, _ in session.cycles():
        engine = replay.engine(inputs)
        if engine is None and following is None:
            continue
        if engine is None or inputs.cycle != (following or inputs.cycle):
            break
        following = inputs.cycle + 1
        if origin_ns is None and inputs.commands:
            origin_ns = inputs.commands[0].received_ns
        outputs = engine.step(inputs)
        if origin_ns is not None:
            trace = outputs.trace
            found.append(Moment(inputs.now_ns - origin_ns, trace.pose, trace.wheel_speeds, outputs.mode))
    return found


def compare(first: Sequence[Moment], second: Sequence[Moment], config: RobotConfig, session: str) -> Comparison:
    """Both drives over the time that both cover, each counted from where it began. Raises ValueError: no such time."""
    both = list(pairs(first, second))
    if not both:
        raise ValueError("one of the drives holds no commands")
    here = [(since(one.pose, first[0].pose), since(other.pose, second[0].pose)) for one, other in both]
    path = sum(dist(a[0][:2], b[0][:2]) for a, b in pairwise(here))
    end, other_end = here[-1]
    tops = [config.limits.motor_speed[motor.name] for motor in config.motors_in_order()]
    found = Comparison(
        path_m=round(path, 4),
        end_m=round(dist(end[:2], other_end[:2]), 4),
        end_rad=round(abs(_turn(end.theta - other_end.theta)), 4),
        largest_m=round(max(dist(a[:2], b[:2]) for a, b in here), 4),
        wheels_rms=round(max(_rms(both, index) / top for index, top in enumerate(tops)), 4),
        modes_recorded=_modes(moment.mode for moment in first),
        modes_redriven=_modes(moment.mode for moment in second),
        reasons=(),
        session=session,
    )
    return found._replace(reasons=tuple(_reasons(found)))


def pairs(first: Sequence[Moment], second: Sequence[Moment]) -> Iterator[tuple[Moment, Moment]]:
    """Both drives at the same times."""
    if not first or not second:
        return
    times = [[moment.time_ns for moment in drive] for drive in (first, second)]
    for time_ns in range(max(times[0][0], times[1][0]), min(times[0][-1], times[1][-1]) + 1, GRID_NS):
        yield first[bisect_right(times[0], time_ns) - 1], second[bisect_right(times[1], time_ns) - 1]


def since(pose: Pose, origin: Pose) -> Pose:
    """Where it is, seen from where the drive began."""
    c, s = cos(origin.theta), sin(origin.theta)
    x, y = pose.x - origin.x, pose.y - origin.y
    return Pose(c * x + s * y, c * y - s * x, _turn(pose.theta - origin.theta))


def _turn(angle: float) -> float:
    """The same angle between -pi and pi."""
    return (angle + pi) % (2.0 * pi) - pi


def _rms(both: Sequence[tuple[Moment, Moment]], index: int) -> float:
    differences = [
        (one.wheels[index] or 0.0) - (other.wheels[index] or 0.0)
        for one, other in both
        if one.wheels[index] is not None and other.wheels[index] is not None
    ]
    return sqrt(sum(difference**2 for difference in differences) / max(len(differences), 1))


def _modes(modes: Iterable[Mode]) -> tuple[str, ...]:
    """Each mode once for as long as it lasted; how long it waited before the drive is not part of it."""
    return tuple(mode.value for mode, _ in groupby(dropwhile(lambda mode: mode is Mode.IDLE, modes)))


def _reasons(found: Comparison) -> Iterator[str]:
    """Every threshold that is exceeded, in words."""
    limits = (
        ("the ends lie apart", found.end_m, END_M + PATH_SHARE * found.path_m, "m"),
        ("the headings at the end differ", found.end_rad, END_RAD, "rad"),
        ("the paths are apart", found.largest_m, LARGEST_M + PATH_SHARE * found.path_m, "m"),
        ("the wheel speeds differ by", found.wheels_rms, WHEELS_SHARE, "of the top speed (rms)"),
    )
    for words, value, limit, unit in limits:
        if value > limit:
            yield f"{words}: {value:.3f} {unit}, allowed {limit:.3f}"
    if found.modes_recorded != found.modes_redriven[: len(found.modes_recorded)]:  # a recording may have been cut
        yield f"modes: {' '.join(found.modes_recorded)}, then {' '.join(found.modes_redriven)}"

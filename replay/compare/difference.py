"""Two drives of one course: how far apart their paths are, how differently each wheel turned, and what else differs.

How this works
--------------
`replay.compare.likeness` holds the drives against each other at the same times since their first command. A drive that
was later on the same line is apart there and not aside: so the distance of each place of the second from the line of
the first is told as well, whenever it was there.
"""

from collections.abc import Iterator, Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from gateway.config import RobotConfig, parse
from gateway.types import Pose
from replay.compare.likeness import GRID_NS, Comparison, Moment, compare, moments, pairs, since
from replay.sessions.reader import Session
from replay.sessions.software import COMPUTING, UNKNOWN

STEP_M = 0.005  # between places of a line; nearer ones say nothing more
_AT_ONCE = 512  # places held against the whole line at a time

Line = npt.NDArray[np.float64]


class WheelDifference(NamedTuple):
    """One motor, rad/s: root of the mean square of the differences, the largest and when; None: never both measured."""

    motor: str
    rms: float | None
    largest: float | None
    largest_t: float | None


class Difference(NamedTuple):
    """How the second drive differs from the first. Times: s since the first command of each.

    `seconds`: the time that both cover. `largest_t`: when they were furthest apart. `aside_m`: the largest distance of
    a place of the second from the line of the first, and `aside_rms_m`. `others`: what of robot and software was
    another one.
    """

    first: str
    second: str
    seconds: float
    likeness: Comparison
    largest_t: float
    aside_m: float
    aside_rms_m: float
    wheels: tuple[WheelDifference, ...]
    others: tuple[str, ...]

    def as_json(self) -> dict[str, object]:
        """The documented keys of `--json`."""
        told = self._asdict() | {"wheels": [wheel._asdict() for wheel in self.wheels]}
        return told | {"likeness": self.likeness.as_json()}


def difference(first: Session, second: Session) -> Difference:
    """Hold two drives against each other. Raises ValueError in words, ConfigError."""
    config, other = (parse(one.config_text, "robot file of the session") for one in (first, second))
    motors = [[motor.name for motor in of.motors_in_order()] for of in (config, other)]
    if motors[0] != motors[1] or config.robot.kind != other.robot.kind:
        raise ValueError(f"these are drives of different robots: {first.header.robot} and {second.header.robot}")
    drives = [moments(first), moments(second)]
    for session, drive in zip((first, second), drives, strict=True):
        if not drive:
            raise ValueError(f"{session.path}: nothing was commanded in it that can be run again")
    return _held(config, drives[0], drives[1], (first, second))


def _held(
    config: RobotConfig, one: Sequence[Moment], other: Sequence[Moment], sessions: tuple[Session, Session]
) -> Difference:
    likeness = compare(one, other, config, str(sessions[1].path))
    both = list(pairs(one, other))
    places = [(since(a.pose, one[0].pose), since(b.pose, other[0].pose)) for a, b in both]
    apart = [sqrt((a.x - b.x) ** 2 + (a.y - b.y) ** 2) for a, b in places]
    aside = asides(line([b for _, b in places]), line([since(moment.pose, one[0].pose) for moment in one]))
    names = [motor.name for motor in config.motors_in_order()]
    return Difference(
        first=str(sessions[0].path),
        second=str(sessions[1].path),
        seconds=round((len(both) - 1) * GRID_NS * 1e-9, 3),
        likeness=likeness,
        largest_t=_t(both[apart.index(max(apart))][0]),
        aside_m=round(float(aside.max()), 4),
        aside_rms_m=round(float(np.sqrt(np.mean(aside**2))), 4),
        wheels=tuple(_wheel(name, index, both) for index, name in enumerate(names)),
        others=tuple(_others(*sessions)),
    )


def line(poses: Sequence[Pose]) -> Line:
    """Places at least STEP_M from each other, and the last: (n, 2), m."""
    places = [poses[0][:2]]
    for x, y, _ in poses:
        if (x - places[-1][0]) ** 2 + (y - places[-1][1]) ** 2 >= STEP_M**2:
            places.append((x, y))
    return np.array([*places, poses[-1][:2]])


def asides(places: Line, of: Line) -> npt.NDArray[np.float64]:
    """The distance of each place from the nearest point of a line, m."""
    begins, ways = of[:-1], np.diff(of, axis=0)
    squares = np.maximum(np.sum(ways**2, axis=1), 1e-18)  # a line of one place has no length
    found = []
    for start in range(0, len(places), _AT_ONCE):
        to = places[start : start + _AT_ONCE, None, :] - begins
        along = np.clip(np.sum(to * ways, axis=2) / squares, 0.0, 1.0)
        found.append(np.min(np.sum((to - along[:, :, None] * ways) ** 2, axis=2), axis=1))
    squared: npt.NDArray[np.float64] = np.concatenate(found)
    return np.sqrt(squared)


def _wheel(motor: str, index: int, both: Sequence[tuple[Moment, Moment]]) -> WheelDifference:
    found = []
    for one, other in both:
        speed, other_speed = one.wheels[index], other.wheels[index]
        if speed is not None and other_speed is not None:
            found.append((abs(speed - other_speed), one))
    if not found:
        return WheelDifference(motor, None, None, None)
    largest, when = max(found, key=lambda pair: pair[0])
    rms = sqrt(sum(apart**2 for apart, _ in found) / len(found))
    return WheelDifference(motor, round(rms, 4), round(largest, 4), _t(when))


def _t(moment: Moment) -> float:
    return round(moment.time_ns * 1e-9, 3)


def _others(first: Session, second: Session) -> Iterator[str]:
    """What is told in the headers and is not the same."""
    one, other = first.header, second.header
    if one.config_sha256 != other.config_sha256:
        yield "the robot file"
    for name in COMPUTING:
        then, now = ((h.git_commit if name == "commit" else h.versions.get(name)) or UNKNOWN for h in (one, other))
        if then != now:
            yield f"{name}: {then}, {now}"
    if one.plant != other.plant:
        yield f"by what it moved: {one.plant or 'not told'}, {other.plant or 'not told'}"

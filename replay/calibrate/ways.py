"""How the wheels turned on a measured course, from the session; and where a geometry says that they led.

How this works
--------------
The joint angles that the drivers read are put on one grid of `STEP_S`. A geometry turns their steps into displacements
of the body, each along its exact arc, and these add up to the end. What the odometry errs by chance grows along the way
as in `gateway.core.odometry`, part by part, so that the parts can be weighed.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway.config import RobotConfig, parse
from gateway.kinematics.contract import Kinematics
from gateway.setup.courses import Course, CourseError, Courses
from gateway.types import Inputs
from replay.identify.measured import Series, measured
from replay.sessions.reader import Session

Array = NDArray[np.float64]

STEP_S = 0.01
STILL_S = 0.1
STILL = 0.01  # rad in that time


class Driven(NamedTuple):
    """`angles`: rad of the joints in chassis order (motors, n), at rest first and last. `end`: measured, NaN: not.

    `label`: what it is called in words.
    """

    label: str
    course: Course
    angles: Array
    end: Array


class Traced(NamedTuple):
    """Where the wheels led: x, y, turn at the end, and what a growth of 1 of each kind makes of its covariance."""

    end: Array
    grown: Array  # (3, 3, 3): by the position, by turning, by driving


def driven(session: Session, courses: Sequence[tuple[int, Course]], config: RobotConfig) -> list[Driven]:
    """The courses of a session, each with its place in the file. Raises CourseError, ConfigError, SessionError."""
    recorded = parse(session.config_text, f"robot file of {session.path}")
    if wheels_of(recorded) != wheels_of(config):
        raise CourseError(f"{session.path}: was recorded with other motors (names, gears, directions, zeros) or kind")
    clock: dict[int, int] = {}
    last = max(course.end for _, course in courses)
    series = measured(_until(session, last, clock), recorded)
    return [_driven(place, course, series, clock) for place, course in courses]


def wheels_of(config: RobotConfig) -> tuple[object, ...]:
    """What makes joint angles of what motors tell."""
    return (
        config.robot.kind,
        *((one.name, one.driver, one.gear_ratio, one.direction, one.zero) for one in config.motors_in_order()),
    )


def _until(session: Session, last: int, clock: dict[int, int]) -> Iterator[Inputs]:
    """Inputs up to a cycle; `clock` gets the time of each."""
    for inputs, _ in session.cycles():
        clock[inputs.cycle] = inputs.now_ns
        yield inputs
        if inputs.cycle >= last:
            return


def _driven(place: int, course: Course, series: Sequence[Series], clock: dict[int, int]) -> Driven:
    label = f"course {place} ({course.course.value})"
    missing = next((cycle for cycle in range(course.begin, course.end + 1) if cycle not in clock), None)
    if missing is not None:
        raise CourseError(f"{label}: cycle {missing} is not in the recording")
    first_ns = min(clock.values())
    begin, end = ((clock[cycle] - first_ns) * 1e-9 for cycle in (course.begin, course.end))
    grid = np.linspace(begin, end, max(2, round((end - begin) / STEP_S)) + 1)
    for one in series:
        if not one.times.size or one.times[0] > begin + STILL_S or one.times[-1] < end - STILL_S:
            raise CourseError(f"{label}: motor {one.name} told no angle at its begin or end")
        moved = [abs(np.diff(np.interp([at - STILL_S, at], one.times, one.angles))[0]) for at in (begin, end)]
        if max(moved) > STILL:
            raise CourseError(f"{label}: {one.name} turns at its begin or end: it has to go from rest to rest")
    angles = np.array([np.interp(grid, one.times, one.angles) for one in series])
    ends = [np.nan if one is None else one for one in (course.x, course.y, course.turn)]
    return Driven(label, course, angles, np.array(ends))


def mapping(kinematics: Kinematics) -> Array:
    """Displacement of the body by a rad of each joint (3, motors), at joint angle zero."""
    return np.asarray(np.linalg.pinv(np.array(kinematics.matrix())[:, :3]))


def steps(angles: Array, by_joint: Array, steered: Sequence[int]) -> Array:
    """Displacements of the body in its own frame (3, n - 1); the geometry of mid-way serves a whole step."""
    found = by_joint @ np.diff(angles)
    for joint in steered:  # its angle turns the axes in which `by_joint` is told
        middle = 0.5 * (angles[joint, 1:] + angles[joint, :-1])
        s, c = np.sin(middle), np.cos(middle)
        found[:2] = np.array([c * found[0] + s * found[1], c * found[1] - s * found[0]])
    return np.asarray(found)


def end_of(way: Array) -> Array:
    """X, y and turn, from displacements; see `gateway.core.odometry.advance`."""
    return _poses(way)[:, -1]


def traced(way: Array, sideways: tuple[float, float]) -> Traced:
    """`sideways`: how much more a metre to the side errs, in position and in heading."""
    poses = _poses(way)
    end = poses[:, -1]
    forward, side, turned = np.abs(way)
    levers = np.array([poses[1] - end[1], end[0] - poses[0], np.ones(way.shape[1])])
    by_turning = (levers * turned) @ levers.T
    by_driving = (levers * (forward + sideways[1] * side)) @ levers.T
    position = float(np.sum(forward + sideways[0] * side)) * np.diag([1.0, 1.0, 0.0])
    return Traced(end, np.array([position, by_turning, by_driving]))


def _poses(way: Array) -> Array:
    """After each step, (3, n)."""
    turned = np.cumsum(way[2])
    middle = turned - 0.5 * way[2]
    chord = np.sinc(way[2] / (2.0 * np.pi))
    s, c = np.sin(middle) * chord, np.cos(middle) * chord
    return np.array([np.cumsum(c * way[0] - s * way[1]), np.cumsum(s * way[0] + c * way[1]), turned])


def tape_noise(courses: Courses, end: Array) -> Array:
    """Covariance of a measured end: of lengths and directions, where the start's own direction errs as well."""
    lever = np.array([-end[1], end[0], 1.0])
    own = np.diag([courses.tape**2, courses.tape**2, courses.angle**2])
    return np.asarray(own + courses.angle**2 * np.outer(lever, lever))


def off(measured_end: Array, end: Array) -> Array:
    """Measured less told; of turns that are told by a whole number apart, the nearest."""
    found = measured_end - end
    found[2] = np.remainder(found[2] + np.pi, 2.0 * np.pi) - np.pi
    return np.asarray(found)

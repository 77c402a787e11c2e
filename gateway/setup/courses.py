"""Measured courses: what a robot drives, what a person then measures, and the file in which that is kept. Pure.

A course goes from rest to rest. Its end is measured in the frame of its start: x forward and y to the left of where the
robot's middle (`base_link`) stood, and how far it turned. Which cycles of which session it was says where the wheels
turned how.
"""

from collections.abc import Mapping
from enum import Enum
from math import pi, tau
from typing import Annotated, Any, Final, NamedTuple, Self

import tomlkit
from pydantic import Field, model_validator
from tomlkit.items import AoT, Table

from gateway.config import ConfigError, RobotConfig, parse_as
from gateway.sections import Section, Unit
from gateway.types import Twist

TAPE: Final = 0.003  # m, standard deviation of a length by tape
ANGLE: Final = 0.005  # rad, of a direction marked and read: 5 mm beside a line of 1 m
SPEED, TURN_SPEED = 0.3, 0.6  # m/s, rad/s: slow enough that no wheel slips
LENGTH: Final = 2.0  # m
MOST: Final = 500  # in a file
TURNS: Final = 2.5  # not a whole number: after that the middle is back wherever it was that it turned about


class CourseError(ValueError):
    """Courses that say nothing, or not enough; the text says why."""


def in_words(refused: Mapping[str, str]) -> str:
    """Reasons by name, each once, with all the names it is of."""
    names: dict[str, list[str]] = {}
    for name, reason in refused.items():
        names.setdefault(reason, []).append(name)
    return "; ".join(f"{', '.join(some)}: {reason}" for reason, some in names.items())


class CourseName(Enum):
    """What is driven, the robot looking the same way all the time but for the turns."""

    FORWARD = "forward"
    BACKWARD = "backward"
    LEFT = "left"
    RIGHT = "right"
    TURN_LEFT = "turn_left"
    TURN_RIGHT = "turn_right"
    SQUARE_LEFT = "square_left"  # counter-clockwise
    SQUARE_RIGHT = "square_right"


_SIDES: Final = {
    CourseName.FORWARD: (1.0, 0.0),
    CourseName.BACKWARD: (-1.0, 0.0),
    CourseName.LEFT: (0.0, 1.0),
    CourseName.RIGHT: (0.0, -1.0),
}
_SQUARES: Final = {
    CourseName.SQUARE_LEFT: (CourseName.FORWARD, CourseName.LEFT, CourseName.BACKWARD, CourseName.RIGHT),
    CourseName.SQUARE_RIGHT: (CourseName.FORWARD, CourseName.RIGHT, CourseName.BACKWARD, CourseName.LEFT),
}
_TURNS: Final = {CourseName.TURN_LEFT: 1.0, CourseName.TURN_RIGHT: -1.0}
_CROSS: Final = (CourseName.FORWARD, CourseName.LEFT, CourseName.BACKWARD, CourseName.RIGHT)
# Platform and joint of an offset-differential robot turn without its wheels, whose chassis turns on the squares.
GEOMETRY: Final = {
    "offset_differential": (*_CROSS, CourseName.SQUARE_LEFT, CourseName.SQUARE_RIGHT),
    "omni": (*_CROSS, CourseName.TURN_LEFT, CourseName.TURN_RIGHT),
    "mecanum": (*_CROSS, CourseName.TURN_LEFT, CourseName.TURN_RIGHT),
}
REPEATED: Final = (CourseName.SQUARE_LEFT, CourseName.SQUARE_RIGHT, CourseName.TURN_LEFT, CourseName.TURN_RIGHT)


class Leg(NamedTuple):
    """One twist for so many s."""

    twist: Twist
    seconds: float


def legs(course: CourseName, length: float, config: RobotConfig) -> tuple[Leg, ...]:
    """From rest to rest each; no faster than the robot file lets it."""
    if course in _TURNS:
        speed = min(TURN_SPEED, config.limits.velocity.wz)
        return (Leg(Twist(0.0, 0.0, _TURNS[course] * speed), TURNS * tau / speed),)
    speed = min(SPEED, config.limits.velocity.vx, config.limits.velocity.vy)
    sides = [_SIDES[side] for side in _SQUARES.get(course, (course,))]
    return tuple(Leg(Twist(x * speed, y * speed, 0.0), length / speed) for x, y in sides)


class Course(Section):
    """One course, and its end as it was measured; what was not measured is left out."""

    course: Annotated[CourseName, Field(description="what was driven")]
    length: Annotated[float, Field(gt=0.0, le=100.0, description="of a side, as it was asked for"), Unit("m")] = LENGTH
    session: Annotated[str | None, Field(max_length=1024, description="folder of the session it is in")] = None
    begin: Annotated[int, Field(ge=0, description="cycle, the robot standing still")]
    end: Annotated[int, Field(ge=0, description="cycle, the robot standing still again")]
    x: Annotated[float | None, Field(ge=-100.0, le=100.0, description="forward, of its start"), Unit("m")] = None
    y: Annotated[float | None, Field(ge=-100.0, le=100.0, description="to the left of it"), Unit("m")] = None
    turn: Annotated[
        float | None, Field(ge=-1000.0, le=1000.0, description="counter-clockwise, with or without whole turns")
    ] = None

    @model_validator(mode="after")
    def _goes_on(self) -> Self:
        if self.end <= self.begin:
            message = f"end = {self.end}: must be a later cycle than begin = {self.begin}"
            raise ValueError(message)
        return self

    @property
    def measured(self) -> bool:
        """Whether anything of its end was."""
        return any(one is not None for one in (self.x, self.y, self.turn))


class Courses(Section):
    """The file of measured courses. How well it was measured are standard deviations."""

    robot: Annotated[str, Field(description="its name")]
    tape: Annotated[float, Field(ge=1e-5, le=0.1, description="to which lengths were measured"), Unit("m")] = TAPE
    angle: Annotated[float, Field(ge=1e-5, le=0.2, description="to which directions were"), Unit("rad")] = ANGLE
    course: Annotated[list[Course], Field(min_length=1, max_length=MOST, description="a table for each")]


def read_courses(text: str, origin: str, config: RobotConfig) -> Courses:
    """From its text. Raises ConfigError, also for courses of another robot."""
    found = parse_as(Courses, text, origin)
    if found.robot != config.robot.name:
        raise ConfigError(origin, [f"robot = {found.robot!r}: the robot file is that of {config.robot.name}"])
    return found


def unmeasured(courses: Courses) -> list[str]:
    """Courses of which nothing was measured, in words."""
    return [
        f"course.{place} ({one.course.value}): nothing measured: give x, y (m) and turn (rad)"
        for place, one in enumerate(courses.course)
        if not one.measured
    ]


def courses_text(courses: Courses) -> str:
    """The text of the file."""
    document = tomlkit.document()
    document.add(
        tomlkit.comment("Measured courses: x (m, forward) and y (m, left) of the robot's middle, and its turn")
    )
    document.add(tomlkit.comment("(rad, counter-clockwise), at the end, in the frame of the start."))
    document.add("robot", tomlkit.item(courses.robot))
    document.add("tape", tomlkit.item(courses.tape).comment("m, standard deviation of a length"))
    document.add("angle", tomlkit.item(courses.angle).comment("rad, of a direction"))
    tables = tomlkit.aot()
    for course in courses.course:
        tables.append(_table(course))
    document.add("course", tables)
    return tomlkit.dumps(document)


def with_course(text: str, course: Course) -> str:
    """The text of a file of courses with one more, everything else as it was."""
    document: Any = tomlkit.parse(text)
    if isinstance(document["course"], AoT):
        document["course"].append(_table(course))
    else:
        document["course"].append(course.model_dump(mode="json", exclude_none=True))
    return tomlkit.dumps(document)


def _table(course: Course) -> Table:
    table = tomlkit.table()
    table.update(course.model_dump(mode="json", exclude_none=True))
    return table


def geometry_courses(config: RobotConfig) -> tuple[CourseName, ...]:
    """What shows the geometry of this chassis. Raises CourseError for one that courses do not show."""
    if config.robot.kind not in GEOMETRY:
        raise CourseError(f"kind {config.robot.kind}: measured courses are for {', '.join(GEOMETRY)}")
    return GEOMETRY[config.robot.kind]


assert abs(TURNS % 1.0 * tau - pi) < 1e-12

"""What `drivegate setup calibrate` and `drivegate setup covariance` share: courses, driven or recorded; the file."""

import sys
from collections.abc import Sequence
from importlib import import_module
from math import cos, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from gateway.cli.asking import NotAllowedError, allow, ask
from gateway.cli.operate import open_client
from gateway.cli.output import complain, errors
from gateway.cli.rewriting import RewriteError, create, drafted, rewrite, rewrite_keeping
from gateway.client import Client
from gateway.commander import config_of
from gateway.config import ConfigError, RobotConfig, read
from gateway.core.examination import examine_text
from gateway.course_drive import CourseDriveError, Driven, drive_course, session_of
from gateway.edges.messages import TruthMessage
from gateway.setup.correction import CorrectionError, Entry, difference, with_entries
from gateway.setup.courses import (
    LENGTH,
    MOST,
    SPEED,
    TURNS,
    Course,
    CourseError,
    CourseName,
    Courses,
    courses_text,
    legs,
    read_courses,
    unmeasured,
    with_course,
)

if TYPE_CHECKING:
    from replay.calibrate import ways

TOLD_TIMEOUT_S = 5.0
FAR, TURNED = 100.0, 36_000.0  # m and degrees: more is mistyped
RECORDED_S = 2.0  # after which the recorder has surely written a cycle

Measured = Annotated[
    Path | None,
    typer.Option(help="Courses driven earlier, with what was measured of them (TOML). Nothing moves."),
]
SessionFolder = Annotated[
    Path | None, typer.Option("--session", help="With --measured: the session of courses that name none.")
]
Names = Annotated[
    list[CourseName] | None, typer.Option("--course", help="To drive, in this order; again for more. Else the usual.")
]
Length = Annotated[float, typer.Option(min=0.2, max=50.0, help="Of a line, or of a square's side, m.")]
Repeat = Annotated[int, typer.Option(min=1, max=50, help="How often to drive them all.")]
SourceName = Annotated[str, typer.Option(help="Command source as named in the robot file.")]
Truth = Annotated[bool, typer.Option("--truth", help="A simulated robot tells where it really is: nobody measures.")]
Out = Annotated[
    Path | None, typer.Option(help="File of the measured courses, added to those in it; else beside the robot file.")
]
USUAL_LENGTH = LENGTH


class Wanted(NamedTuple):
    """What the command line asks for."""

    measured: Path | None
    session: Path | None
    courses: Sequence[CourseName]
    length: float
    repeat: int
    source: str
    truth: bool
    out: Path | None
    connect: str | None
    yes: bool


class Gathered(NamedTuple):
    """Courses, how the wheels turned on them, and the file that has them."""

    courses: Courses
    driven: "list[ways.Driven]"
    file: Path


class UnmeasuredError(RuntimeError):
    """Courses were driven, and nobody measured them: they are in the file, to be measured and given again."""


REFUSALS = (  # of both commands: nothing was changed
    *(CourseError, CourseDriveError, UnmeasuredError, CorrectionError, NotAllowedError, RewriteError, OSError),
    KeyboardInterrupt,
)


def gather(file: Path, config: RobotConfig, text: str, wanted: Wanted) -> Gathered:
    """From a file, or driven now.

    Raises CourseError, CourseDriveError, UnmeasuredError, NotAllowedError, RewriteError.
    """
    if wanted.measured is not None:
        courses, place = read_courses(read(wanted.measured), str(wanted.measured), config), wanted.measured
    elif wanted.session is not None:
        raise CourseError("--session needs --measured: what was measured of its courses")
    else:
        place = wanted.out or file.with_name(f"{file.stem}.courses.toml")
        with drafted(file, text):
            pass  # so that it is not driven for nothing
        _check_writable(place)
        courses = _drive(file, config, wanted, place)
    missing = unmeasured(courses)
    if missing and wanted.measured is None:
        raise UnmeasuredError(
            f"{place}: {len(missing)} courses wait for x, y and turn; then call again with --measured {place}"
        )
    if missing:
        raise ConfigError(str(place), missing)
    return Gathered(courses, _recorded(courses, wanted.session, config), place)


def write(file: Path, text: str, entries: Sequence[Entry], *, yes: bool) -> Path:
    """Shown, asked, written; the copy that is kept.

    Raises CorrectionError, NotAllowedError, RewriteError, CourseError.
    """
    new = with_entries(text, entries, str(file))
    try:
        examine_text(new, str(file))
    except ConfigError as error:
        raise CourseError(f"with what was found the robot could not be driven: {'; '.join(error.problems)}") from None
    allow(difference(text, new, str(file)), f"to write this into {file}", yes=yes)
    kept = rewrite_keeping(file, text, new)
    errors.print(f"{file} is corrected; as it was before: {kept}. It counts from the next start on", highlight=False)
    return kept


def _recorded(courses: Courses, session: Path | None, config: RobotConfig) -> "list[ways.Driven]":
    """How the wheels turned, in the order of the file. Raises CourseError."""
    reader, module = import_module("replay.sessions.reader"), import_module("replay.calibrate.ways")
    places: dict[Path, list[tuple[int, Course]]] = {}
    for number, course in enumerate(courses.course):
        folder = session if course.session is None else Path(course.session)
        if folder is None:
            raise CourseError(f"course.{number}: no session: name it there, or give --session")
        places.setdefault(folder, []).append((number, course))
    found: dict[int, ways.Driven] = {}
    with errors.status("reading"):
        for folder, some in places.items():
            try:
                driven = module.driven(reader.open_session(folder), some, config)
            except reader.SessionError as error:
                raise CourseError(str(error)) from None
            found |= {number: one for (number, _), one in zip(some, driven, strict=True)}
    return [found[number] for number in range(len(courses.course))]


def _drive(file: Path, config: RobotConfig, wanted: Wanted, place: Path) -> Courses:
    """Each course, kept in the file as soon as it was driven and measured."""
    before = read_courses(read(place), str(place), config).course if place.exists() else []
    plan = list(wanted.courses) * wanted.repeat
    if len(before) + len(plan) > MOST:
        raise CourseError(f"{place}: has {len(before)} courses; with {len(plan)} more they are more than {MOST}")
    with open_client(str(file), wanted.connect, zero_on_exit=True) as client:
        if config_of(client) != config:
            raise CourseDriveError(
                f"the running robot was started with another robot file than {file} is now: start it anew"
            )
        _check_told(client, truth=wanted.truth)
        names = ", ".join(name.value for name in wanted.courses)
        allow(
            f"{config.robot.name} will drive {len(plan)} courses from rest to rest ({names}), each up to "
            f"{wanted.length:g} m along and to the side, or {TURNS:g} turns, at up to {SPEED:g} m/s. Clear the floor "
            "all around, and keep the emergency stop at hand.",
            "to let it move",
            yes=wanted.yes,
        )
        for number, name in enumerate(plan, 1):
            errors.print(f"{number} of {len(plan)}: {name.value}", highlight=False)
            driven = _one(client, config, name, wanted)
            keep_course(place, config, driven)
        last = driven.end + round(RECORDED_S * config.loop.rate)
        client.wait_for_state(lambda state: state.status.cycle >= last, 2.0 * RECORDED_S)
    return read_courses(read(place), str(place), config)


def _check_writable(place: Path) -> None:
    """Raises OSError."""
    new = not place.exists()
    with place.open("a", encoding="utf-8"):
        pass
    if new:
        place.resolve().unlink()  # a link to a file that is still to come stays


def _check_told(client: Client, *, truth: bool) -> None:
    """So that it is not driven for nothing. Raises CourseDriveError."""
    state = client.wait_for_state(lambda _: not truth or client.truth() is not None, TOLD_TIMEOUT_S)
    if state is None:
        what = "where it really is, as a simulated robot does" if truth else "its state"
        raise CourseDriveError(f"the robot does not tell {what}")
    session_of(state)


def _one(client: Client, config: RobotConfig, name: CourseName, wanted: Wanted) -> Course:
    """One course, driven and, where somebody can, measured."""
    person = not wanted.truth and sys.stdin is not None and sys.stdin.isatty()
    if person:
        ask("Mark on the floor where its middle (base_link) is and which way it looks; then Enter.")
    start = client.truth()
    driven = drive_course(client, wanted.source, legs(name, wanted.length, config), rate=config.loop.rate)
    x = y = turn = None
    if wanted.truth:
        x, y, turn = _moved(start, client.truth())
    elif person:
        x, y, turn = _measured()
    return _course(name, wanted.length, driven, (x, y, turn))


def _course(name: CourseName, length: float, driven: Driven, end: tuple[float | None, ...]) -> Course:
    session = Path(driven.session)
    x, y, turn = end
    return Course(
        course=name,
        length=length,
        session=str(session.resolve() if session.exists() else session),
        begin=driven.begin,
        end=driven.end,
        x=x,
        y=y,
        turn=turn,
    )


def _moved(start: TruthMessage | None, end: TruthMessage | None) -> tuple[float, float, float]:
    """In the frame of the start."""
    if start is None or end is None:
        raise CourseDriveError("the robot told no ground truth")
    c, s = cos(start.theta), sin(start.theta)
    x, y = end.x - start.x, end.y - start.y
    return c * x + s * y, c * y - s * x, end.theta - start.theta


def _measured() -> tuple[float | None, ...]:
    """Until the answer can be."""
    while True:
        answer = ask(
            "Where is its middle now? Forward and left of the mark (m), and how far it is turned to the left (degrees; "
            "whole turns do not count), - for what was not measured:"
        )
        words = answer.replace(",", " ").split()
        try:
            x, y, turn = (None if word == "-" else float(word) for word in words)
        except ValueError:
            complain(f"{answer!r}: must be three numbers, such as 1.987 -0.012 0.5, or - in place of one")
            continue
        if all(one is None or abs(one) <= most for one, most in ((x, FAR), (y, FAR), (turn, TURNED))):
            return x, y, None if turn is None else radians(turn)
        complain(f"{answer!r}: must be lengths up to {FAR:g} m and a turn up to {TURNED:g} degrees, either way")


def keep_course(place: Path, config: RobotConfig, driven: Course) -> None:
    """Behind those that are in the file by now: somebody may have written into it what he measured."""
    if not place.exists():
        create(place.resolve(), courses_text(Courses(robot=config.robot.name, course=[driven])))
        return
    text = read(place)
    read_courses(text, str(place), config)
    rewrite(place, text, with_course(text, driven))

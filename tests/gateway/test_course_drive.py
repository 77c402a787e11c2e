"""A course as a commander drives it: legs from rest to rest, and every reason for which it does not count."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from gateway import course_drive
from gateway.course_drive import CourseDriveError, Driven, drive_course
from gateway.setup.courses import Leg
from gateway.types import Mode, Twist

LEGS = (Leg(Twist(0.3, 0.0, 0.0), 2.0), Leg(Twist(0.0, 0.3, 0.0), 1.0))
RATE = 100.0


class Robot:
    """What a client tells of it; every question takes a second."""

    def __init__(self) -> None:
        self.cycle = 1000
        self.session: str | None = "sessions/one"
        self.mode = Mode.IDLE
        self.standing: bool | None = True
        self.done: list[tuple[Twist, float] | str] = []
        self.starts = self.rests = True
        self.objection: str | None = None

    def state(self, *_: object) -> Any:  # noqa: ANN401  # of a message what is looked at
        self.cycle += round(RATE)
        status = SimpleNamespace(cycle=self.cycle, mode=self.mode, standing=self.standing, reason="a motor is lost")
        return SimpleNamespace(status=status, extras={"recording": {"session": self.session}})

    def wait(self, condition: Callable[[Any], bool], _: float) -> Any:  # noqa: ANN401
        state = self.state()
        return state if condition(state) else None

    def stream(self, _client: object, _source: str, vx: float, vy: float, wz: float, *, seconds: float) -> str | None:
        self.done.append((Twist(vx, vy, wz), seconds))
        return self.objection

    def rest(self, *_: object) -> bool:
        self.done.append("rest")
        return self.rests


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch) -> Robot:
    found = Robot()
    monkeypatch.setattr(course_drive, "start", lambda *_: found.starts)
    monkeypatch.setattr(course_drive, "stream", found.stream)
    monkeypatch.setattr(course_drive, "rest", found.rest)
    monkeypatch.setattr(course_drive, "objection", lambda *_: "mode estop")
    return found


def driven(robot: Robot) -> Driven:
    client = Mock(state=robot.state, status=robot.state, wait_for_state=robot.wait, alive=True)
    return drive_course(client, "teleop", LEGS, rate=RATE)


def test_each_leg_ends_at_rest(robot: Robot) -> None:
    found = driven(robot)
    assert robot.done == [(LEGS[0].twist, 2.0), "rest", (LEGS[1].twist, 1.0), "rest"]
    assert found.session == "sessions/one"
    assert found.end - found.begin >= RATE / 2  # it stood for a while behind it


def refusal(robot: Robot) -> str:
    with pytest.raises(CourseDriveError) as error:
        driven(robot)
    return str(error.value)


def test_what_does_not_start_does_not_move(robot: Robot) -> None:
    robot.starts = False
    assert refusal(robot) == "does not start: mode estop"
    assert robot.done == []


def test_a_course_that_was_ended_does_not_count_and_ends_at_rest(robot: Robot) -> None:
    robot.objection = "mode estop"
    assert refusal(robot) == "mode estop"
    assert robot.done == [(LEGS[0].twist, 2.0), "rest"]


def test_a_robot_that_does_not_come_to_rest(robot: Robot) -> None:
    robot.rests = False
    assert refusal(robot).startswith("did not come to rest")
    assert len(robot.done) == 2


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"mode": Mode.DEGRADED}, "mode degraded: a motor is lost"),
        ({"standing": False}, "the robot does not stand still"),
    ],
)
def test_how_a_robot_does_not_begin(robot: Robot, change: dict[str, object], said: str) -> None:
    for name, value in change.items():
        setattr(robot, name, value)
    assert refusal(robot) == said
    assert robot.done == []


def test_what_is_not_recorded_does_not_count(robot: Robot) -> None:
    robot.session = None
    assert refusal(robot).startswith("the robot does not record")
    assert robot.done == []

"""What a drive along a path does when the robot does not do as told: a robot that says what the test wants."""

from collections.abc import Callable
from typing import cast

import pytest

from gateway.client import Client
from gateway.commander import INTERRUPTED, PathResult, drive_path
from gateway.config import ConfigError
from gateway.edges.messages import OdometryMessage, StateMessage
from gateway.paths import path_file
from gateway.types import ZERO_TWIST, Mode, SettingStatus, SourceStatus, Twist, TwistFrame
from tests.gateway.test_messages import STATUS
from tests.world import robot_text

LINE = "[[piece]]\nkind = 'line'\nlength = 3.0\n"
CORNER = LINE + "[[piece]]\nkind = 'corner'\nangle = 1.0\n"
STILL = OdometryMessage(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, (0.0,) * 9, None)


class FakeRobot:
    """Stands still and drives for `autonomy`, until `then` changes it with the given number of commands."""

    alive = True

    def __init__(
        self, name: str = "omni4", then: Callable[["FakeRobot"], None] = lambda _: None, after: int = 5
    ) -> None:
        self.text: str | None = robot_text(name)
        self.winner = "autonomy"
        self.place: OdometryMessage | None = STILL
        self.moving = True
        self.override = 1.0
        self.sent: list[tuple[Twist, TwistFrame | None, float | None]] = []
        self._then, self._after = then, after

    def config_text(self, timeout: float) -> str | None:
        return self.text

    def wait_for_state(self, predicate: Callable[[StateMessage], bool], timeout: float) -> StateMessage | None:
        state = self.state()
        return state if predicate(state) else None

    def state(self) -> StateMessage:
        reason = None if self.winner == "autonomy" else f"outranked by {self.winner}"
        setting = SettingStatus("speed_override", self.override, "", 0.05, 1.0)
        status = STATUS._replace(
            mode=Mode.DRIVE,
            reason=None,
            winner=self.winner,
            sources=(SourceStatus("autonomy", 0.1, reason),),
            settings=(setting,),
            standing=True,
            limits_active=(),
        )
        return StateMessage(0.0, status, {"channels": {"position.platform": 0.0}})

    def odometry(self) -> OdometryMessage | None:
        if self.moving and self.place is not None:
            self.place = self.place._replace(t=self.place.t + 0.02)
        return self.place

    def send_twist(
        self,
        vx: float,
        vy: float,
        wz: float,
        *,
        source: str,
        frame: TwistFrame | None = None,
        path_rate: float | None = None,
    ) -> None:
        assert source == "autonomy"
        self.sent.append((Twist(vx, vy, wz), frame, path_rate))
        if len(self.sent) == self._after:
            self._then(self)


def drive(robot: FakeRobot, text: str = LINE, speed: float = 0.3) -> PathResult:
    return drive_path(cast(Client, robot), path_file.parse(text, "p.toml"), "p.toml", source="autonomy", speed=speed)


def outranked(robot: FakeRobot) -> None:
    robot.winner = "joy"


def far_away(robot: FakeRobot) -> None:
    robot.place = STILL._replace(x=5.0, y=0.25)


def silent(robot: FakeRobot) -> None:
    robot.moving = False


def interrupted(_: FakeRobot) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("then", "reason"),
    [
        (outranked, "source autonomy: outranked by joy"),
        (far_away, "lost after "),
        (silent, "no odometry for 0.5 s"),
        (interrupted, INTERRUPTED),
    ],
    ids=lambda one: getattr(one, "__name__", ""),
)
def test_it_ends_with_a_zero_and_says_why(then: Callable[[FakeRobot], None], reason: str) -> None:
    robot = FakeRobot(then=then)
    result = drive(robot)
    assert (result.reason or "").startswith(reason)
    assert result.mode is Mode.DRIVE
    assert robot.sent[0][0] == robot.sent[-1][0] == ZERO_TWIST
    assert robot.sent[3][0].vx > 0.0, "it drove"
    assert all(
        frame is TwistFrame.ODOM and rate is not None for twist, frame, rate in robot.sent if twist != ZERO_TWIST
    )


def test_the_end_missed_is_no_success() -> None:
    """This robot stands still, aside, and the way is so short that no plan is made that could lead it back."""
    robot = FakeRobot()
    robot.place = STILL._replace(y=0.15)
    result = drive(robot, LINE.replace("3.0", "0.04"))
    assert result.reason == "did not reach the end: 0.155 m off"
    assert result.end_deviation == pytest.approx(0.15524, abs=1e-5)
    assert result.max_deviation == pytest.approx(0.15)


@pytest.mark.parametrize(
    ("robot", "text", "problem"),
    [
        (FakeRobot("moby"), CORNER, r"p.toml: piece\[1\] \(corner\), 3.000 m from the start: turns by 1 rad"),
        (FakeRobot(), "[start]\nx = 2.0\n" + LINE, "p.toml: start: x 2 m, y 0 m is 2.000 m from the robot"),
    ],
    ids=["corner", "elsewhere"],
)
def test_what_cannot_be_driven_sends_nothing(robot: FakeRobot, text: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        drive(robot, text)
    assert robot.sent == []


def test_a_robot_that_tells_nothing_of_itself_gets_nothing() -> None:
    dumb, blind = FakeRobot(), FakeRobot()
    dumb.text, blind.place = None, None
    with pytest.raises(ConfigError, match="the robot did not tell it within 2 s"):
        drive(dumb)
    assert drive(blind).reason == "the robot does not tell where it is"
    assert dumb.sent == blind.sent == []


def test_the_speed_override_slows_it() -> None:
    """5 % of 1.5 m/s; it stands still, and over more way it would be led back without end."""
    robot = FakeRobot()
    robot.override = 0.05
    drive(robot, LINE.replace("3.0", "0.04"), speed=0.3)
    assert max(twist.vx for twist, _, _ in robot.sent) == pytest.approx(0.075)

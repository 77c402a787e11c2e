"""`drivegate setup tune` as it is called, on the simulated robot; what it finds is in tests/replay/test_tuning.py."""

import json
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from io import StringIO
from math import pi
from pathlib import Path
from typing import cast
from unittest.mock import patch

import pytest
import typer
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.cli.app import build
from gateway.config import parse
from gateway.core.examination import examine_text
from gateway.edges.claims import Claims, InUseError
from gateway.setup.course import Course, stairs, trapezoid
from gateway.setup.excitation import LOW, RISE, SECONDS, STEP, Excitation
from gateway.setup.jog import FURTHEST, Ending, JogError, Outcome
from tests.gateway.test_jog import FAULTS
from tests.gateway.test_setup_inputs import Terminal, Told, simulated
from tests.jogging import Bench
from tests.setup_robots import TRUE
from tests.world import robot_text


class Stand:
    """A robot on a stand, and its file; `true`: how it really is."""

    def __init__(self, directory: Path, text: str, true: str | None = None) -> None:
        self.text = text
        self.file = directory / "robot.toml"
        self.file.write_text(text)
        self.bench = Bench(parse(true or text, "robot"))
        self.motor = self.bench.config.motor[0].name
        self.told = Told()
        self.said = ""

    def tunes(
        self,
        *options: str,
        motor: str | None = None,
        typed: Sequence[str] = (),
        terminal: bool = False,
        disturb: Callable[[Bench], None] = lambda _: None,
    ) -> tuple[int, dict[str, object]]:
        out, err, code = StringIO(), StringIO(), 1
        arguments = ["setup", "tune", str(self.file), motor or self.motor, "--json", *options]
        with (
            simulated(self.bench, self.told, disturb),
            patch.object(sys, "stdin", Terminal(typed, terminal=terminal)),
            redirect_stdout(out),
            redirect_stderr(err),
            suppress(typer.Exit),
        ):
            code = build("setup")(arguments, standalone_mode=False) or 0
        return code, json.loads(out.getvalue())

    @property
    def untouched(self) -> bool:
        return self.file.read_text() == self.text and len(list(self.file.parent.glob("*.toml*"))) == 1


def test_the_gains_are_written_and_the_file_before_is_kept(tmp_path: Path) -> None:
    stand = Stand(tmp_path, robot_text("omni4"))
    code, found = stand.tunes("--yes", "--plot", str(tmp_path / "tune.png"))
    assert (code, found["ok"]) == (0, True)
    loops = cast("list[dict[str, float]]", found["loops"])
    loop = parse(stand.file.read_text(), "robot").motor[0].speed_loop
    assert loop is not None
    assert {(loop.kp, loop.ki)} == {(one["kp"], one["ki"]) for one in loops if str(one["loop"]).startswith("after")}
    assert all(one["phase"] >= 59.5 and one["gain"] >= 2.95 for one in loops[2:])
    assert Path(str(found["kept"])).read_text() == stand.text
    assert parse(stand.file.read_text(), "robot").motor[1:] == parse(stand.text, "robot").motor[1:]
    assert (tmp_path / "tune.png").read_bytes().startswith(b"\x89PNG")
    ((way, _),) = stand.told.ways
    assert way < FURTHEST


def test_it_can_be_repeated(tmp_path: Path) -> None:
    """Excited by what was found it finds the same."""
    stand = Stand(tmp_path, robot_text("omni4"))
    stand.tunes("--yes")
    first = parse(stand.file.read_text(), "robot").motor[0].speed_loop
    again = Stand(tmp_path, stand.file.read_text())
    again.tunes("--yes")
    second = parse(again.file.read_text(), "robot").motor[0].speed_loop
    assert first is not None
    assert second is not None
    assert (second.kp, second.ki) == pytest.approx((first.kp, first.ki), rel=0.03)


def test_gains_that_check_refuses_are_tuned_one_by_one(tmp_path: Path) -> None:
    stand = Stand(tmp_path, TRUE["rectangular"]())
    names = [motor.name for motor in stand.bench.config.motor]
    for name in names:
        assert stand.tunes("--yes", motor=name)[0] == 0
    examine_text(stand.file.read_text(), "robot")


def test_gains_that_check_would_refuse_are_not_written(tmp_path: Path) -> None:
    """The body of the file is so light that its wheels would swing with them."""
    true = robot_text("omni4")
    light = {
        "mass = 25.0": "mass = 1.0",
        "inertia = 0.9": "inertia = 0.01",
        "joint_inertia = 0.004": "joint_inertia = 0.001",
    }
    text = true.replace("kp = 3.5", "kp = 0.3")
    for old, new in light.items():
        text = text.replace(f"\n{old}", f"\n{new}")
    stand = Stand(tmp_path, text, true)
    code, found = stand.tunes("--yes")
    assert (code, "of a speed error in one cycle" in str(found["reason"])) == (1, True), found
    assert stand.untouched


@pytest.mark.parametrize(
    ("robot", "motor", "words"),
    [
        ("moby", "left", "a controller of odrive 0.6 has a speed loop of its own"),
        ("omni4_vesc", "front_left", "a controller of vesc vesc has a speed loop of its own"),
        ("omni4", "wing", "no such"),
    ],
)
def test_what_has_no_loop_of_ours_is_not_tuned(tmp_path: Path, robot: str, motor: str, words: str) -> None:
    stand = Stand(tmp_path, robot_text(robot))
    code, found = stand.tunes("--yes", motor=motor)
    assert (code, words in str(found["reason"])) == (1, True), found
    assert stand.untouched
    assert stand.bench.sent == []


def test_gains_that_do_not_turn_it_are_told(tmp_path: Path) -> None:
    stand = Stand(tmp_path, TRUE["rectangular"]().replace("kp = 3.5, ki = 14.0", "kp = 0.01, ki = 0.01"))
    code, found = stand.tunes("--yes")
    assert (code, "is too weak for its friction: raise it" in str(found["reason"])) == (1, True), found
    assert stand.untouched


def test_gains_with_which_it_swings_are_put_right(tmp_path: Path) -> None:
    """It swings within its bounds, which excites it well."""
    found = []
    for kp in (3.0, 90.0):
        stand = Stand(tmp_path, TRUE["rectangular"]().replace("kp = 3.5, ki = 14.0", f"kp = {kp}, ki = 14.0"))
        assert stand.tunes("--yes")[0] == 0
        loop = parse(stand.file.read_text(), "robot").motor[0].speed_loop
        assert loop is not None
        found.append((loop.kp, loop.ki))
    assert found[1] == pytest.approx(found[0], rel=0.1)


def test_what_runs_away_may_be_too_strong_a_loop(tmp_path: Path) -> None:
    stand = Stand(tmp_path, robot_text("omni4"))
    FAULTS["phases swapped"](stand.bench, stand.motor)
    code, found = stand.tunes("--yes")
    assert (code, "is too strong: a tenth of it" in str(found["reason"])) == (1, True), found
    assert stand.untouched


@pytest.mark.parametrize("fault", ["no power", "a twin", "turned by force", "phases swapped"])
def test_what_breaks_leaves_the_file(tmp_path: Path, fault: str) -> None:
    stand = Stand(tmp_path, robot_text("omni4"))
    begun_ns = stand.bench.now_ns

    def disturb(bench: Bench) -> None:
        if bench.now_ns > begun_ns + 1_200_000_000:
            FAULTS[fault](bench, stand.motor)

    code, found = stand.tunes("--yes", disturb=disturb)
    assert (code, found["ok"]) == (1, False)
    assert stand.untouched


def test_a_wheel_that_rubs_is_told(tmp_path: Path) -> None:
    """By turns it is held and free: no inertia and friction explain that."""
    stand = Stand(tmp_path, robot_text("omni4"))

    def disturb(bench: Bench) -> None:
        bench.plant._drag = 0.045 + (0.1 if bench.now_ns // 90_000_000 % 2 else 0.0)

    code, found = stand.tunes("--yes", disturb=disturb)
    assert (code, "something rub" in str(found["reason"])) == (1, True), found
    assert stand.untouched


def test_the_robot_file_does_not_become_a_picture(tmp_path: Path) -> None:
    stand = Stand(tmp_path, robot_text("omni4"))
    code, found = stand.tunes("--yes", "--plot", str(stand.file))
    assert (code, "must end in .png" in str(found["reason"])) == (1, True), found
    assert stand.untouched
    assert stand.bench.sent == []


def test_one_that_may_still_hold_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    held = Outcome("front_left", Ending.TURNED, "", 2.0, released=False)
    monkeypatch.setattr("gateway.cli.setup_tune.run", lambda *_: held)
    stand = Stand(tmp_path, robot_text("omni4"))
    code, found = stand.tunes("--yes")
    assert (code, "cut its power" in str(found["reason"])) == (1, True), found
    assert stand.untouched


@pytest.mark.parametrize(("typed", "terminal"), [((), False), (("yes", "yes"), False), (("y",), True), ((), True)])
def test_without_a_yes_nothing_turns(tmp_path: Path, typed: tuple[str, ...], terminal: bool) -> None:
    stand = Stand(tmp_path, robot_text("omni4"))
    code, found = stand.tunes(typed=typed, terminal=terminal)
    assert (code, found["ok"]) == (1, False)
    assert stand.bench.sent == []
    assert stand.untouched


def test_a_yes_to_turn_it_is_none_to_write(tmp_path: Path) -> None:
    stand = Stand(tmp_path, robot_text("omni4"))
    code, found = stand.tunes(typed=("yes", "no"), terminal=True)
    assert (code, found["reason"]) == (1, "nobody let it happen")
    assert stand.bench.sent != []
    assert stand.untouched


def test_a_gateway_on_the_bus_is_left_alone(tmp_path: Path) -> None:
    stand = Stand(tmp_path, robot_text("omni4").replace('channel = "can0"', 'channel = "held_tune"'))
    claims = Claims("socketcan", "held_tune", [0x7FF])
    with pytest.raises(InUseError):
        stand.tunes("--yes")
    claims.release()
    assert stand.bench.sent == []


def test_it_turns_no_further_than_a_jog_may() -> None:
    config = parse(robot_text("omni4"), "omni4")
    assert Excitation(config, "front_left").way < FURTHEST <= pi
    slow = parse(robot_text("omni4").replace("front_left = 45.0", "front_left = 0.3"), "omni4")
    assert Excitation(slow, "front_left").top == slow.limits.motor_speed["front_left"]
    with pytest.raises(JogError, match="no such"):
        Excitation(config, "wing")


courses = st.one_of(
    st.builds(lambda top, seconds: trapezoid(top, seconds, ramp=0.25), st.floats(0.05, 1.0), st.floats(0.2, 5.0)),
    st.builds(lambda top: stairs(top, SECONDS, low=LOW, ramp=RISE, step=STEP), st.floats(0.05, 1.0)),
)


@settings(deadline=None)
@given(course=courses, share=st.floats(0.0, 1.2))
def test_the_way_is_the_sum_of_the_speeds(course: Course, share: float) -> None:
    end, steps = share * course.seconds, 2000
    speeds = [course.at((place + 0.5) / steps * end)[0] for place in range(steps)]
    assert 0.0 <= min(speeds) <= max(speeds) <= course.top + 1e-12
    assert course.at(end)[1] == pytest.approx(sum(speeds) / steps * end, abs=4e-3)
    assert course.at(course.seconds + 9.0) == (0.0, course.at(course.seconds)[1])

"""Courses of the ODD's experiments through the service on MuJoCo's plant: where they end, also as the width changes.

Only the hardest of each; by hand all of them ended alike: on casters within 0.25 cm, balancing within 3.3 cm.
"""

from pathlib import Path

import pytest

from gateway.chassis.odd import OddRobot
from replay.reproduce import odd, odd_robot
from replay.reproduce.odd_robot import CASTERS, LEVEL, Course, Floor, Form, Leg, Rates, Seen
from replay.reproduce.result import Stage
from replay.sim.plants.odd_dynamics import leaning_of
from tests.replay.mujoco_odd import MujocoOdd


def driven(form: Form, course: Course, directory: Path, patch: pytest.MonkeyPatch) -> Seen:
    def on_mujoco(robot: OddRobot, _: Floor) -> MujocoOdd:
        return MujocoOdd(robot, leaning_of(robot))

    patch.setattr(odd_robot, "plant_on", on_mujoco)
    return odd_robot.drive_odd(Stage(directory, 1_700_000_000_000_000_000, lambda _: None), form, LEVEL, course)


@pytest.mark.parametrize("place", [2, 3])
def test_circles_end_where_the_paper_has_them(place: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both circles of figure 9, on casters, within 2.42 and 2.67 cm."""
    path = odd._paths()[place]
    assert path.paper is not None
    samples = driven(CASTERS, path.course, tmp_path, monkeypatch).samples
    assert 100.0 * odd_robot.apart(samples[0], samples[-1]) < path.paper[0]


def test_a_width_that_changes_moves_no_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On casters, while it goes on and turns: figure 10."""
    change = odd._changes()[-1]
    widening = [Leg(start, length, Rates(width=rate)) for start, length, rate in odd._WIDENING]
    seen = driven(CASTERS, Course([*change.base, *widening]), tmp_path, monkeypatch)
    poses = odd_robot.ideal(odd_robot.robot_of(CASTERS), Course(change.base))
    beside = max(odd._beside(seen.samples[at], poses, at) for at in range(0, len(poses), 25))
    assert beside < 0.01
    assert max(seen.widths) - min(seen.widths) == pytest.approx(0.24, abs=0.01)

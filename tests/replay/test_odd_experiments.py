"""What the experiments of the ODD are made of: courses, ideal wheels, and room between walls.

The drives themselves take minutes: `python -m tests.experiments odd-fig8 odd-fig9 odd-fig10 odd-fig11`.
"""

from math import pi
from pathlib import Path

import pytest

from gateway.types import Mode, Pose
from replay.reproduce.odd import _Change, _changes, _outside, _Path, _paths, _room
from replay.reproduce.odd_robot import (
    CASTERS,
    LEVEL,
    TILTED,
    Course,
    Leg,
    Rates,
    Seen,
    apart,
    drive_odd,
    ideal,
    one_by_one,
    plant_on,
    robot_of,
)
from replay.reproduce.result import Stage
from replay.reproduce.service import Driven, Sample


def test_a_leg_makes_its_rates_times_its_seconds_and_keeps_their_ratio() -> None:
    course = Course([Leg(0.5, 2.0, Rates(0.3, -0.1, 0.0, 0.05)), Leg(1.0, 1.0, Rates(0.3))], ramp=0.4)
    assert course.at(0.4) == course.at(2.95) == Rates()
    assert course.at(0.7) == pytest.approx((0.15, -0.05, 0.0, 0.025))
    assert course.at(1.5) == pytest.approx((0.6, -0.1, 0.0, 0.05))
    assert course.seconds == pytest.approx(2.9 + 1.0)
    made = [sum(course.at((n + 0.5) * 1e-3)[axis] * 1e-3 for n in range(3900)) for axis in range(4)]
    assert made == pytest.approx([0.9, -0.2, 0.0, 0.1], abs=1e-6)
    after = one_by_one([(1.0, Rates(0.3)), (2.0, Rates(0.0, 0.2))])
    assert after.at(1.2) == pytest.approx((0.15, 0.0, 0.0, 0.0))
    assert after.at(1.6) == pytest.approx((0.0, 0.1, 0.0, 0.0))


@pytest.mark.parametrize("path", _paths(), ids=lambda path: str(path.words))
def test_all_four_paths_close_on_ideal_wheels(path: _Path) -> None:
    """O3 of science 6."""
    course = path.course
    poses = ideal(robot_of(CASTERS), course)
    assert apart(poses[0], poses[-1]) < 1e-6
    assert max(apart(poses[0], pose) for pose in poses) > 0.9


@pytest.mark.parametrize("change", _changes(), ids=lambda change: str(change.words))
def test_the_width_does_not_move_the_path_of_ideal_wheels(change: _Change) -> None:
    """O5 of science 6."""
    base = change.base
    wide = ideal(robot_of(CASTERS), Course([*base, Leg(1.0, 1.2, Rates(width=0.12))]))
    plain = ideal(robot_of(CASTERS), Course(base))
    assert max(apart(one, other) for one, other in zip(wide, plain, strict=True)) < 1e-9
    assert plain[-1] != Pose(0.0, 0.0, 0.0)


def test_room_between_walls() -> None:
    assert _outside(0.0, 0.0, (3.0, 5.0, 4.0, 6.0)) == 5.0
    assert _outside(4.0, 3.0, (3.0, 5.0, 4.0, 6.0)) == 1.0
    assert _outside(4.0, 4.5, (3.0, 5.0, 4.0, 6.0)) == -0.5
    sample = Sample(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, (), (), None, None, None, Mode.DRIVE, ())
    seen = Seen(Driven([sample], (), Path()), [0.4], [0.0])
    assert _room(seen, [(-1.0, 1.0, 0.3, 1.0)], 0.17, 0.1) == pytest.approx(0.3 - 0.27)
    turned = seen._replace(drive=Driven([sample._replace(heading=pi / 2.0)], (), Path()))
    assert _room(turned, [(-1.0, 1.0, 0.3, 1.0)], 0.17, 0.1) == pytest.approx(0.3 - 0.17)
    (left,), (right,) = turned.pairs()
    assert left == pytest.approx((-0.2, 0.0), abs=1e-12)
    assert right == pytest.approx((0.2, 0.0), abs=1e-12)


def test_the_floor_is_what_the_plant_gets() -> None:
    plant = plant_on(robot_of(CASTERS), TILTED)
    left, _, _, right = plant.loads
    assert sum(plant.loads) == pytest.approx(20.0 * 9.81)
    assert left > right
    level = plant_on(robot_of(CASTERS), LEVEL)
    assert level.loads == pytest.approx((5.0 * 9.81,) * 4)
    assert level.slipping == ()


def test_a_short_drive_through_the_service(tmp_path: Path) -> None:
    """Forward while the width goes; the service and ideal wheels end at one place."""
    course = Course([Leg(0.0, 1.0, Rates(0.3)), Leg(0.0, 0.6, Rates(width=0.1))])
    seen = drive_odd(Stage(tmp_path, 1_700_000_000_000_000_000, lambda words: None), CASTERS, TILTED, course)
    assert len(seen.widths) == len(seen.width_rates) == len(seen.samples)
    assert seen.widths[0] == pytest.approx(0.4, abs=1e-4)
    assert seen.widths[-1] == pytest.approx(0.46, abs=4e-3)
    assert apart(seen.samples[-1], ideal(robot_of(CASTERS), course)[-1]) < 5e-3

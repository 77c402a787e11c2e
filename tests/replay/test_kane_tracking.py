"""Wheel control of Amarasiri et al. 2022 on its own robot: K5 to K8 of science 6, in the paper's units."""

from pathlib import Path as File

import numpy as np
import pytest

from gateway.paths import path_file
from gateway.paths.path import Path
from replay.reproduce.kane_model import WHEEL_GAINS, Moment, Response, gains_for, poles, track
from replay.reproduce.kane_paths import figure_eight as eight_of_arcs
from replay.reproduce.kane_paths import square
from replay.reproduce.kane_tracking import figure_eight, pushes, sharp_corners

PATHS = File(__file__).parent.parent.parent / "deploy" / "paths"
STEP = 4e-3  # s: the fastest pole is at -100 1/s, and Runge-Kutta is true to it


def largest(found: list[Moment], field: str) -> float:
    """Of a field of all moments, whether it is one number or one of each wheel."""
    return float(np.max(np.abs([getattr(moment, field) for moment in found])))


def test_a_figure_eight_k5() -> None:
    """|T| <= 0.6 (ref 0.577), errors <= 1e-3 in (ref 3.6e-5), spin <= 6e-6 rad; the second half is as the first."""
    found = track(figure_eight, seconds=25.0, step=STEP, every=5)
    assert largest(found, "torques") == pytest.approx(0.577, abs=2e-3)
    assert largest(found, "error_x") <= 1e-4
    assert largest(found, "error_y") <= 1e-4
    assert largest(found, "spin") <= 6e-6


def test_sharp_corners_k6() -> None:
    """Peak 20 to 40 (ref 34.3), wheels within 0.1 rad (ref 0.077); without a torque that is a state the peak is 133."""
    found = track(sharp_corners, seconds=6.0, step=1e-3, every=1)
    assert largest(found, "torques") == pytest.approx(34.3, abs=0.1)
    assert largest(found, "wheel_errors") == pytest.approx(0.077, abs=1e-3)
    direct = track(sharp_corners, seconds=5.2, step=1e-3, every=1, state_form=False)
    assert largest(direct, "torques") > 100.0


def test_pushed_on_the_figure_eight_k7() -> None:
    """|T| <= 20 (ref 18.2), wheels within 0.009 rad (ref 0.0089), places within 0.06 in."""
    found = track(figure_eight, seconds=37.0, force=pushes, step=STEP, every=1)
    assert largest(found, "torques") == pytest.approx(18.2, abs=0.1)
    assert largest(found, "wheel_errors") == pytest.approx(0.0089, abs=1e-4)
    assert max(largest(found, "error_x"), largest(found, "error_y")) <= 0.06


@pytest.mark.parametrize("wheel", range(4))
def test_where_the_gains_put_the_poles_k8(wheel: int) -> None:
    """-100 and -8 +- 12.566j within 0.1 %: of the printed gains with the digit of E-004-3 put right."""
    gains = WHEEL_GAINS[wheel]
    placed = poles(gains, gains_for(gains.derivative, Response())[1])
    assert placed[0] == pytest.approx(-100.0, rel=1e-3)
    assert placed[1] == pytest.approx(complex(-8.0, 12.566), rel=1e-3)
    assert placed[2] == pytest.approx(complex(-8.0, -12.566), rel=1e-3)


@pytest.mark.parametrize(("name", "made"), [("omni4_eight", eight_of_arcs()), ("omni4_square", square())])
def test_the_paths_of_the_comparison_are_those_of_deploy(name: str, made: Path) -> None:
    """Every 7 mm, so that no sample lies in a corner."""
    file = path_file.parse((PATHS / f"{name}.toml").read_text(), name)
    assert file.length == made.length
    for number in range(int(file.length / 0.007)):
        assert made.at(0.007 * number) == pytest.approx(file.at(0.007 * number), abs=1e-12)

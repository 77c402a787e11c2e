"""A slice of the random drives in the pull region; `python -m tests.bench.pulled` drives ten minutes of each."""

from pathlib import Path

import pytest

from tests.pulled_drives import TROUBLE, drive, recorded


@pytest.mark.parametrize("rate", [250.0, 50.0], ids=["4 ms", "20 ms"])
def test_compensated_it_stays_pulled_and_no_motor_is_told_more_than_its_limit(rate: float) -> None:
    """Pushes of up to 250 N, 2 % of the frames lost and every one a cycle late; a second core says the same."""
    found = drive(2, rate, compensated=True, seconds=25.0)
    assert found.flips == 0
    assert found.nearest > 0.3
    assert found.error < 0.6
    assert found.step <= 1.0 + 1e-6
    assert found.differing == 0
    assert [mode.value for mode in found.modes] == ["idle", "starting", "drive"]


@pytest.mark.parametrize("rate", [250.0, 50.0], ids=["4 ms", "20 ms"])
def test_the_same_drive_flips_without_and_keeps_the_limits_too(rate: float) -> None:
    found = drive(2, rate, compensated=False, seconds=8.0)
    assert found.flips == 1
    assert found.sound


def test_its_session_verifies(tmp_path: Path) -> None:
    found, verdict = recorded(2, 50.0, seconds=12.0, trouble=TROUBLE, directory=tmp_path)
    assert found.sound
    assert verdict.identical
    assert verdict.cycles == found.cycles == 600


def test_a_push_beyond_what_the_wheels_can_hold_flips_it_all_the_same() -> None:
    """The two wheel motors hold 1500 N together; of 1000 N and less nothing is seen."""
    assert drive(2, 50.0, compensated=True, seconds=25.0, trouble=TROUBLE._replace(push=1000.0)).flips == 0
    assert drive(2, 50.0, compensated=True, seconds=25.0, trouble=TROUBLE._replace(push=3000.0)).flips > 0

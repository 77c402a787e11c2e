"""What `python -m tests.bench damage` does by the hundred, a few times: nothing is lost that had been written."""

from pathlib import Path

from tests.damage import FLUSHED, RATE, cut, flip, kill_recorders, kill_services, recorded

CYCLES = 4 * FLUSHED


def test_a_recorder_killed_at_random_moments(tmp_path: Path) -> None:
    session, losses = kill_recorders(tmp_path, 3, seed=1)
    assert len(losses) == 3
    found = [inputs.cycle for inputs, _ in session.cycles()]
    missing = {cycle for gap in session.gaps for cycle in range(gap.first_cycle, gap.last_cycle + 1)}
    assert sorted([*found, *missing]) == list(range(found[-1] + 1))
    assert {gap.reason for gap in session.gaps} <= {"the recorder process ended (exit code -9)"}
    assert not [problem for problem in session.problems if "chain" in problem or "as it was written" in problem]


def test_a_service_killed_at_random_moments(tmp_path: Path) -> None:
    """How much that may be for want of time is for the bench to say; here, that nothing in between is missing."""
    assert [loss.refused for loss in kill_services(tmp_path, 2, 1, recorder_too=False)] == [None, None]


def test_both_killed_at_random_moments(tmp_path: Path) -> None:
    assert [loss.refused for loss in kill_services(tmp_path, 2, 2, recorder_too=True)] == [None, None]


def test_files_cut_at_random_bytes(tmp_path: Path) -> None:
    path, records = recorded(tmp_path, CYCLES)
    losses = list(cut(path, records, 40, seed=1))
    assert {loss.seconds for loss in losses} == {0.0, FLUSHED / RATE}
    assert 0 < sum(loss.refused is not None for loss in losses) < 40


def test_flipped_bits(tmp_path: Path) -> None:
    path, records = recorded(tmp_path, CYCLES)
    flips = flip(path, records, 60, seed=1)
    assert (flips.unnoticed, flips.altered) == (0, 0)
    assert max(flips.lost_s) <= FLUSHED / RATE

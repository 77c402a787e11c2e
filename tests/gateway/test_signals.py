"""Every signal has one meaning, and what ends the robot is only noted by its handler."""

import os
import signal
from collections.abc import Iterator

import pytest

from gateway.edges.signals import ENDING, IGNORED, LEFT, EndRequest

CAUGHT = [*ENDING, *IGNORED]


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in CAUGHT}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_every_signal_is_in_exactly_one_table() -> None:
    tables = (set(ENDING), set(IGNORED), set(LEFT))
    assert set.union(*tables) == set(map(int, signal.valid_signals()))
    assert sum(map(len, tables)) == len(set.union(*tables))


@pytest.mark.parametrize("number", ENDING, ids=lambda number: f"signal {number}")
def test_an_ending_signal_is_noted_also_twice(number: int) -> None:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    request = EndRequest()
    request.listen()
    os.kill(os.getpid(), number)
    os.kill(os.getpid(), signal.SIGTERM)
    os.kill(os.getpid(), number)
    assert request.by == f"signal {number}"


@pytest.mark.parametrize("number", IGNORED)
def test_an_ignored_signal_changes_nothing(number: int) -> None:
    request = EndRequest()
    request.listen()
    os.kill(os.getpid(), number)
    assert request.by is None


def test_under_nohup_a_hangup_stays_ignored() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    request = EndRequest()
    request.listen()
    os.kill(os.getpid(), signal.SIGHUP)
    assert request.by is None


def test_what_is_heeded_for_a_while_is_as_before_afterwards() -> None:
    numbers = (*ENDING, *IGNORED)
    before = [signal.getsignal(number) for number in numbers]
    request = EndRequest()
    with request.heeded():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGUSR1)
    assert request.by == f"signal {signal.SIGINT.value}"
    assert [signal.getsignal(number) for number in numbers] == before

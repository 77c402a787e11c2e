"""What the commands for people make of keys, states and refusals; the real robot is in `tests.e2e`."""

from dataclasses import dataclass, field
from math import inf
from typing import cast

import pytest

from gateway.cli.operate import STALE_S, _present, _stopped, is_refusal, mode_words, source_words
from gateway.client import Client
from gateway.commander import objection, rest, start, stream, unrested
from gateway.edges.messages import EventMessage, StateMessage
from gateway.types import ZERO_TWIST, Level, Mode, SourceStatus, Twist
from tests.gateway.test_messages import STATUS


@dataclass
class FakeClient:
    """A robot that says one state after the other, one per command."""

    states: list[StateMessage | None] = field(default_factory=list)
    age: float = 0.1
    alive: bool = True
    sent: list[Twist] = field(default_factory=list)
    widths: set[tuple[float | None, float | None]] = field(default_factory=set)

    def state(self) -> StateMessage | None:
        return self.states[min(len(self.sent), len(self.states) - 1)] if self.states else None

    def state_age(self) -> float:
        return self.age

    def send_twist(
        self,
        vx: float,
        vy: float,
        wz: float,
        *,
        source: str,
        width_rate: float | None = None,
        width: float | None = None,
    ) -> None:
        assert source
        self.widths.add((width_rate, width))
        self.sent.append(Twist(vx, vy, wz))


def _client(fake: FakeClient) -> Client:
    return cast(Client, fake)


def _state(mode: Mode, *, winner: str | None = "teleop", reason: str | None = None) -> StateMessage:
    sources = (SourceStatus("teleop", 0.1, None if winner == "teleop" else f"outranked by {winner}"),)
    return StateMessage(0.0, STATUS._replace(mode=mode, winner=winner, reason=reason, sources=sources), {})


# words


def test_the_mode_of_a_robot_that_died_is_unknown() -> None:
    fake = FakeClient([_state(Mode.DRIVE)])
    assert mode_words(_client(fake)) == "drive"
    fake.age = STALE_S + 0.3
    assert mode_words(_client(fake)) == "unknown: no state for 0.8 s (was drive)"
    fake.alive = False
    assert mode_words(_client(fake)) == "unknown: the robot is gone (was drive 0.8 s ago)"
    assert mode_words(_client(FakeClient(age=inf))) == "unknown: no state received"


@pytest.mark.parametrize(
    ("state", "source", "words"),
    [
        (_state(Mode.DRIVE), "teleop", None),
        (_state(Mode.DEGRADED), "teleop", None),
        (_state(Mode.DRIVE), "ghost", "no source ghost: the sources are teleop"),
        (_state(Mode.DRIVE), "telop", "no source telop: the sources are teleop; did you mean 'teleop'?"),
        (_state(Mode.ESTOP, reason="needs a reset"), "teleop", "mode estop: needs a reset"),
        (_state(Mode.DRIVE, winner="joy"), "teleop", "source teleop: outranked by joy"),
        (None, "teleop", "no state received"),
    ],
)
def test_why_a_source_does_not_drive(state: StateMessage | None, source: str, words: str | None) -> None:
    assert objection(_client(FakeClient([state])), source) == words


def test_a_robot_that_is_gone_does_not_drive() -> None:
    assert objection(_client(FakeClient([_state(Mode.DRIVE)], alive=False)), "teleop") == "the robot is gone"


def test_a_robot_that_is_gone_is_waited_for_by_nobody() -> None:
    gone = FakeClient([_state(Mode.DRIVE)], alive=False)
    assert not start(_client(gone), "teleop")
    assert not rest(_client(gone), "teleop")
    assert gone.sent == []
    assert unrested(_client(gone)) == "the robot is gone: whether it came to rest is not known"
    assert unrested(_client(FakeClient())) == "did not come to rest within 10 s"


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (SourceStatus("teleop", 0.12, None), "teleop: drives (120 ms old)"),
        (SourceStatus("teleop", None, "silent"), "teleop: silent"),
    ],
)
def test_what_is_shown_of_a_source(source: SourceStatus, words: str) -> None:
    assert source_words(source) == words


def test_what_holds_now_is_told_as_events() -> None:
    status = STATUS._replace(mode=Mode.FAULT, reason="coming to rest", faults=("left: silent for 0.30 s",))
    told = [(event.level, event.code, event.text) for event in _present(status, 1.0)]
    assert told == [(Level.INFO, "mode_fault", "coming to rest"), (Level.ERROR, "fault", "left: silent for 0.30 s")]


@pytest.mark.parametrize(
    ("standing", "words"),
    [(True, "it stands"), (False, "it is braking"), (None, "whether it stands is not known")],
)
def test_what_is_said_of_a_stop(standing: bool | None, words: str) -> None:
    state = StateMessage(0.0, STATUS._replace(standing=standing), {})
    assert _stopped(_client(FakeClient([state])), "moby") == f"{words}; latched until `drivegate stop moby --reset`"


def test_refusals_of_a_source_are_known_by_code_and_name() -> None:
    refused = EventMessage(0.0, Level.WARNING, "refused_second_sender", "teleop: sender a: sender b holds this source")
    assert is_refusal(refused, "teleop")
    assert not is_refusal(refused, "tele")
    assert not is_refusal(refused._replace(code="fault_bus"), "teleop")


# commands


def test_start_sends_zeros_and_believes_no_state_of_before() -> None:
    before = _state(Mode.DRIVE)
    fake = FakeClient([before, before, _state(Mode.IDLE), _state(Mode.STARTING), _state(Mode.DRIVE)])
    assert start(_client(fake), "teleop", timeout=10.0)
    assert fake.sent == [ZERO_TWIST] * 4


@pytest.mark.parametrize(("mode", "source"), [(Mode.ESTOP, "teleop"), (Mode.IDLE, "ghost")])
def test_start_gives_up_at_once_where_it_cannot_succeed(mode: Mode, source: str) -> None:
    fake = FakeClient([None, _state(mode)])
    assert not start(_client(fake), source, timeout=1000.0)


@pytest.mark.parametrize("mode", [Mode.ESTOP, Mode.FAULT])
def test_a_stream_ends_with_the_drive_and_says_why(mode: Mode) -> None:
    fake = FakeClient([_state(Mode.DRIVE), _state(Mode.DRIVE), _state(mode, reason="why")])
    assert stream(_client(fake), "teleop", 0.1, 0.0, 0.0, seconds=1000.0) == f"mode {mode.value}: why"
    assert len(fake.sent) == 2


def test_a_stream_goes_on_after_a_moment_in_which_another_source_won() -> None:
    fake = FakeClient([_state(Mode.DRIVE), _state(Mode.DRIVE, winner="joy"), _state(Mode.DRIVE)])
    assert stream(_client(fake), "teleop", 0.1, 0.0, 0.0, seconds=0.1) is None

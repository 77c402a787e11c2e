"""The gate of a source with a clock of its own: who may command, in which order, and how old is too old."""

import itertools
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.edges.source_gate import SourceGate
from gateway.types import ZERO_TWIST, Refusal, RefusalCode, TwistCommand, TwistFrame

MS = 1_000_000
SECOND = 1000 * MS
TIMEOUT_NS = 200 * MS
DRIFT_PPM = 500
OFFSET_NS = 5000 * SECOND  # between the two clocks: whatever it is, it must not matter
DAY = 24 * 3600 * SECOND


def _command(received_ns: int, *, sequence: int | None = None, sender: str | None = "joy") -> TwistCommand:
    return TwistCommand("teleop", ZERO_TWIST, TwistFrame.BODY, sequence, received_ns, sender)


def _stamped(gate: SourceGate, sent_ns: int, delay_ns: int, *, sender: str | None = "joy") -> TwistCommand | Refusal:
    """A command sent at `sent_ns` of the gateway's clock, stamped by that of the sender."""
    return gate.admit(_command(sent_ns + delay_ns, sender=sender), sent_ns + OFFSET_NS)


def _code(outcome: TwistCommand | Refusal) -> RefusalCode | None:
    return outcome.code if isinstance(outcome, Refusal) else None


# sequence


def test_sequences_grow() -> None:
    gate = SourceGate(TIMEOUT_NS)
    assert gate.admit(_command(1, sequence=5), None) == _command(1, sequence=5)
    assert gate.admit(_command(2, sequence=9), None) == _command(2, sequence=9)
    assert gate.admit(_command(3, sequence=9), None) == Refusal(
        "teleop", RefusalCode.OLD_SEQUENCE, "seq = 9: must be greater than the last accepted one, 9", 3
    )


@pytest.mark.parametrize(("silence_ns", "admitted"), [(TIMEOUT_NS, False), (TIMEOUT_NS + 1, True)])
def test_a_restarted_commander_is_admitted_after_the_timeout(silence_ns: int, admitted: bool) -> None:
    gate = SourceGate(TIMEOUT_NS)
    gate.admit(_command(1, sequence=100), None)
    gate.admit(_command(1 + silence_ns // 2, sequence=0), None)  # refused, and no sign of life of the former one
    assert isinstance(gate.admit(_command(1 + silence_ns, sequence=1), None), TwistCommand) is admitted


def test_commands_without_sequence_pass_and_keep_the_source_awake() -> None:
    gate = SourceGate(TIMEOUT_NS)
    gate.admit(_command(1, sequence=100), None)
    assert isinstance(gate.admit(_command(TIMEOUT_NS), None), TwistCommand)
    assert isinstance(gate.admit(_command(TIMEOUT_NS + 2, sequence=100), None), Refusal)


# stamp


def test_the_first_command_of_a_sender_cannot_be_judged() -> None:
    outcome = _stamped(SourceGate(TIMEOUT_NS), SECOND, 700 * MS)
    assert outcome == _command(SECOND + 700 * MS)
    assert not outcome.stamped


def test_age_counts_from_arrival_less_the_delay() -> None:
    gate = SourceGate(TIMEOUT_NS)
    _stamped(gate, 0, 3 * MS)
    outcome = _stamped(gate, 20 * MS, 153 * MS)
    assert isinstance(outcome, TwistCommand)
    assert outcome.stamped
    assert outcome.received_ns == pytest.approx(23 * MS, abs=0.1 * MS)  # as if it had taken 3 ms like the fastest


@pytest.mark.parametrize(("delay_ns", "code"), [(TIMEOUT_NS, None), (TIMEOUT_NS + MS, RefusalCode.STALE)])
def test_what_waited_longer_than_the_timeout_is_stale(delay_ns: int, code: RefusalCode | None) -> None:
    gate = SourceGate(TIMEOUT_NS)
    _stamped(gate, 0, 0)
    assert _code(_stamped(gate, 20 * MS, delay_ns)) is code


def test_a_stale_command_is_refused_in_words() -> None:
    gate = SourceGate(TIMEOUT_NS)
    _stamped(gate, 0, 0)
    assert _stamped(gate, 20 * MS, 900 * MS) == Refusal(
        "teleop",
        RefusalCode.STALE,
        "sender joy: 0.900 s on its way, by its stamp: must be at most the timeout of 0.2 s",
        920 * MS,
    )


def _stream(gate: SourceGate, sent: Iterable[int]) -> int:
    """A healthy stream with 2 to 5 ms on its way; returns when it ended."""
    last_ns = 0
    for last_ns, delay_ms in zip(sent, itertools.cycle((2, 5, 3, 4)), strict=False):
        assert isinstance(_stamped(gate, last_ns, delay_ms * MS), TwistCommand)
    return last_ns


def test_the_burst_after_a_stall_is_stale_but_for_its_last_commands() -> None:
    """The link stands still for 0.9 s, then delivers all at once; the commander died meanwhile or not."""
    gate = SourceGate(TIMEOUT_NS)
    begin_ns = _stream(gate, range(0, 2 * SECOND, 20 * MS))
    released_ns = begin_ns + 900 * MS
    held_back = range(begin_ns + 20 * MS, released_ns, 20 * MS)
    outcomes = [
        _stamped(gate, sent_ns, released_ns + index * 50_000 - sent_ns) for index, sent_ns in enumerate(held_back)
    ]
    passed = [one for one in outcomes if isinstance(one, TwistCommand)]
    assert {_code(one) for one in outcomes} == {RefusalCode.STALE, None}
    assert len(passed) <= TIMEOUT_NS // (20 * MS) + 1
    # Those that pass are dated when they were sent, so they end the drive when their commander's silence does.
    assert all(
        sent_ns <= one.received_ns <= sent_ns + 6 * MS
        for one, sent_ns in zip(passed, held_back[-len(passed) :], strict=True)
    )


def test_a_reader_that_was_stopped_does_not_take_old_samples_for_new() -> None:
    """SIGSTOP, SIGCONT: the thread reads a sample of before and looks at the clock of now."""
    gate = SourceGate(TIMEOUT_NS)
    before_ns = _stream(gate, range(0, SECOND, 20 * MS))
    for index in range(5):
        assert _code(_stamped(gate, before_ns + (index + 1) * 20 * MS, 3 * SECOND)) is RefusalCode.STALE


def test_after_a_stall_a_living_commander_goes_on_as_the_same_sender() -> None:
    gate = SourceGate(TIMEOUT_NS)
    begin_ns = _stream(gate, range(0, SECOND, 20 * MS))
    assert _code(_stamped(gate, begin_ns + 20 * MS, 900 * MS)) is RefusalCode.STALE
    outcome = _stamped(gate, begin_ns + 920 * MS, 3 * MS)
    assert isinstance(outcome, TwistCommand)
    assert (outcome.sender, outcome.stamped) == ("joy", True)


@pytest.mark.parametrize(("beyond_ns", "code"), [(0, None), (1, RefusalCode.STALE)])
def test_the_timeout_is_the_longest_delay_that_passes(beyond_ns: int, code: RefusalCode | None) -> None:
    gate = SourceGate(TIMEOUT_NS)
    _stamped(gate, 0, 0)
    drift_ns = 200_000  # 500 ppm of the 400 ms between the arrivals
    delay_ns = TIMEOUT_NS + drift_ns + beyond_ns
    assert _code(_stamped(gate, 400 * MS - delay_ns, delay_ns)) is code


def test_a_command_without_a_stamp_between_others_changes_nothing() -> None:
    gate = SourceGate(TIMEOUT_NS)
    assert isinstance(gate.admit(_command(0), None), TwistCommand)
    assert isinstance(_stamped(gate, MS, 0), TwistCommand)
    assert isinstance(gate.admit(_command(2 * MS), None), TwistCommand)
    assert _code(_stamped(gate, 3 * MS, 900 * MS)) is RefusalCode.STALE


def test_two_commands_of_one_moment_are_of_one_clock() -> None:
    gate = SourceGate(TIMEOUT_NS)
    _stamped(gate, 0, 0)
    assert _stamped(gate, 0, MS)[5:7] == ("joy", True)


def test_a_clock_is_trusted_as_long_as_it_drifts_by_no_more_than_the_timeout() -> None:
    gate = SourceGate(TIMEOUT_NS)
    _stamped(gate, 0, 0)
    assert _stamped(gate, 400 * SECOND, 0)[5:7] == ("joy", True)  # 500 ppm of 400 s are 0.2 s


def test_a_sender_without_a_name_begins_like_any_other() -> None:
    gate = SourceGate(TIMEOUT_NS)
    assert _stamped(gate, SECOND, 0, sender=None)[5:7] == (None, False)
    gate = SourceGate(TIMEOUT_NS)
    for received_ns, sequence in ((1, None), (2, 0), (3, 1)):
        assert isinstance(gate.admit(_command(received_ns, sequence=sequence, sender=None), None), TwistCommand)


@pytest.mark.parametrize("ppm", [-DRIFT_PPM, -100, 100, DRIFT_PPM])
def test_a_day_of_drift_makes_nobody_stale(ppm: int) -> None:
    gate = SourceGate(TIMEOUT_NS)
    worst_ns = 0
    for arrival_ns in range(0, DAY, SECOND // 2):
        outcome = gate.admit(_command(arrival_ns), OFFSET_NS + arrival_ns + arrival_ns * ppm // 1_000_000)
        assert isinstance(outcome, TwistCommand)
        assert outcome.sender == "joy"
        worst_ns = max(worst_ns, arrival_ns - outcome.received_ns)
    assert worst_ns < MS


def test_after_a_day_of_drift_a_stall_is_still_noticed() -> None:
    """The allowance for drift is of the time since the last look, not of all time."""
    gate = SourceGate(TIMEOUT_NS)
    for sent_ns in range(0, DAY, SECOND):
        _stamped(gate, sent_ns, 3 * MS)
    assert _code(_stamped(gate, DAY, 900 * MS)) is RefusalCode.STALE


def test_more_drift_than_clocks_have_is_a_delay() -> None:
    gate = SourceGate(TIMEOUT_NS)
    codes = [
        _code(gate.admit(_command(arrival_ns), OFFSET_NS + arrival_ns - arrival_ns * 2 * DRIFT_PPM // 1_000_000))
        for arrival_ns in range(0, 500 * SECOND, 20 * MS)
    ]
    assert codes[-1] is RefusalCode.STALE


def test_a_silence_in_which_clocks_may_drift_too_far_begins_anew() -> None:
    gate = SourceGate(TIMEOUT_NS)
    _stamped(gate, 0, 0)
    _stamped(gate, 20 * MS, 0)
    silence_ns = TIMEOUT_NS * 1_000_000 // DRIFT_PPM
    outcome = _stamped(gate, 21 * MS + silence_ns, 0)
    assert isinstance(outcome, TwistCommand)
    assert (outcome.sender, outcome.stamped) == ("joy#1", False)  # to the core another sender, whose zero is wanted
    assert _stamped(gate, 41 * MS + silence_ns, 0)[5:7] == ("joy#1", True)


def test_a_stamp_that_goes_back_is_out_of_order() -> None:
    gate = SourceGate(TIMEOUT_NS)
    gate.admit(_command(20 * MS), 9 * SECOND)
    assert gate.admit(_command(40 * MS), 9 * SECOND - 1) == Refusal(
        "teleop",
        RefusalCode.OLD_SEQUENCE,
        "stamp = 9.000: must not be smaller than the last accepted one, 9.000",
        40 * MS,
    )
    assert isinstance(gate.admit(_command(60 * MS), 9 * SECOND), TwistCommand)


def test_a_clock_that_began_anew_is_another_sender_after_the_timeout() -> None:
    gate = SourceGate(TIMEOUT_NS)
    for arrival_ns in (0, 20 * MS):
        gate.admit(_command(arrival_ns), 900 * SECOND + arrival_ns)
    assert _code(gate.admit(_command(100 * MS), 0)) is RefusalCode.OLD_SEQUENCE
    for arrival_ns, stamped in ((300 * MS, False), (320 * MS, True)):
        outcome = gate.admit(_command(arrival_ns), arrival_ns - 300 * MS)
        assert isinstance(outcome, TwistCommand)
        assert (outcome.sender, outcome.stamped) == ("joy#1", stamped)


def test_a_stamp_from_the_future_locks_its_sender_out_only_for_a_while() -> None:
    gate = SourceGate(TIMEOUT_NS)
    _stamped(gate, 0, 0)
    gate.admit(_command(20 * MS), OFFSET_NS + DAY)
    assert _code(_stamped(gate, 40 * MS, 0)) is RefusalCode.OLD_SEQUENCE
    outcome = _stamped(gate, 20 * MS + TIMEOUT_NS + MS, 0)
    assert isinstance(outcome, TwistCommand)
    assert outcome.sender == "joy#1"


@given(
    steps=st.lists(st.tuples(st.integers(1, 2000), st.integers(0, 3000)), min_size=1, max_size=60),
    ppm=st.integers(-100, 100),
)
def test_nothing_passes_later_than_the_timeout_after_it_was_sent(steps: list[tuple[int, int]], ppm: int) -> None:
    """Whatever the delays: nothing older than the fastest by more than the timeout passes, nothing gets younger."""
    gate, sent_ns, arrival_ns, fastest_ns = SourceGate(TIMEOUT_NS), 0, 0, None
    for gap_ms, delay_ms in steps:
        sent_ns += gap_ms * MS
        arrival_ns = max(arrival_ns, sent_ns + delay_ms * MS)  # a link keeps the order
        outcome = gate.admit(_command(arrival_ns), OFFSET_NS + sent_ns + sent_ns * ppm // 1_000_000)
        waited_ns = arrival_ns - sent_ns
        fastest_ns = waited_ns if fastest_ns is None else min(fastest_ns, waited_ns)
        allowance_ns = arrival_ns * (DRIFT_PPM + 100) // 1_000_000 + MS
        if isinstance(outcome, TwistCommand):
            assert waited_ns - fastest_ns <= TIMEOUT_NS + allowance_ns
            assert outcome.received_ns <= arrival_ns
            assert not outcome.stamped or outcome.received_ns <= sent_ns + fastest_ns + allowance_ns


# senders


def test_the_first_of_two_senders_keeps_the_source_until_it_is_silent() -> None:
    gate = SourceGate(TIMEOUT_NS)
    gate.admit(_command(0, sender="joy"), None)
    gate.admit(_command(50 * MS, sender="planner"), None)  # refused, and does not count as the first one's life
    assert gate.admit(_command(TIMEOUT_NS, sender="planner"), None) == Refusal(
        "teleop",
        RefusalCode.SECOND_SENDER,
        "sender planner: sender joy holds this source until it is silent for 0.2 s",
        TIMEOUT_NS,
    )
    outcome = gate.admit(_command(TIMEOUT_NS + 1, sender="planner"), None)
    assert outcome == _command(TIMEOUT_NS + 1, sender="planner")
    assert _code(gate.admit(_command(TIMEOUT_NS + 2, sender="joy"), None)) is RefusalCode.SECOND_SENDER


@pytest.mark.parametrize(("first", "second"), [(None, "joy"), ("joy", None)])
def test_a_sender_without_a_name_is_one_too(first: str | None, second: str | None) -> None:
    gate = SourceGate(TIMEOUT_NS)
    gate.admit(_command(0, sender=first), None)
    outcome = gate.admit(_command(MS, sender=second), None)
    assert isinstance(outcome, Refusal)
    assert outcome.code is RefusalCode.SECOND_SENDER
    assert "a sender without a name" in outcome.text
    assert "sender joy" in outcome.text
    assert isinstance(gate.admit(_command(2 * MS, sender=first), None), TwistCommand)


def test_a_sender_whose_commands_are_stale_does_not_keep_the_source() -> None:
    gate = SourceGate(TIMEOUT_NS)
    _stamped(gate, 0, 0)
    assert _code(_stamped(gate, 20 * MS, 281 * MS)) is RefusalCode.STALE
    assert isinstance(_stamped(gate, 302 * MS, 0, sender="planner"), TwistCommand)


def test_the_next_sender_inherits_neither_numbers_nor_clock() -> None:
    gate = SourceGate(TIMEOUT_NS)
    gate.admit(_command(0, sequence=900, sender="joy"), 900 * SECOND)
    for arrival_ns, sequence in ((SECOND, None), (SECOND + MS, 1)):
        outcome = gate.admit(_command(arrival_ns, sequence=sequence, sender="planner"), arrival_ns)
        assert isinstance(outcome, TwistCommand)
        assert outcome.sender == "planner"


def test_the_burst_of_a_former_sender_does_not_pass_while_another_commands() -> None:
    gate = SourceGate(TIMEOUT_NS)
    _stream(gate, range(0, SECOND, 20 * MS))
    for sent_ns in range(2 * SECOND, 3 * SECOND, 20 * MS):
        assert isinstance(_stamped(gate, sent_ns, 0, sender="planner"), TwistCommand)
        assert _code(_stamped(gate, sent_ns - SECOND, SECOND + MS)) is RefusalCode.SECOND_SENDER


def test_memory_does_not_grow_with_senders() -> None:
    gate = SourceGate(TIMEOUT_NS)
    for number in range(1000):
        outcome = _stamped(gate, number * SECOND, 0, sender=f"sender{number}")
        assert isinstance(outcome, TwistCommand)
    assert not hasattr(gate, "__dict__")
    assert gate == SourceGate(
        TIMEOUT_NS, "sender999", 0, 999 * SECOND, None, 999 * SECOND + OFFSET_NS, -OFFSET_NS, 999 * SECOND
    )

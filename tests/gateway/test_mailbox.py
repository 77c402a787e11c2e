"""Between the threads and the loop: newest wins, bounded, nothing from the future, nothing too late."""

import timeit
from functools import partial

import pytest

from gateway.edges.mailbox import MAX_EVENTS, MAX_QUESTIONS, MAX_REFUSALS, NOTHING, QUESTION_EXPIRY_NS, Mailbox, Outbox
from gateway.edges.messages import decode_event
from gateway.types import (
    ZERO_TWIST,
    Event,
    Level,
    Refusal,
    RefusalCode,
    Request,
    RequestKind,
    TwistCommand,
    TwistFrame,
)


def _command(received_ns: int, *, source: str = "teleop") -> TwistCommand:
    return TwistCommand(source, ZERO_TWIST, TwistFrame.BODY, None, received_ns)


def test_the_newest_command_of_each_source_in_the_order_of_the_robot_file() -> None:
    mailbox = Mailbox(["teleop", "autonomy"])
    mailbox.commands["autonomy"].append(_command(1, source="autonomy"))
    for received_ns in range(2, 6):
        mailbox.commands["teleop"].append(_command(received_ns))
    assert mailbox.drain(10).commands == (_command(5), _command(1, source="autonomy"))
    assert mailbox.drain(11) is NOTHING


def test_nothing_is_dated_after_the_cycle_that_sees_it() -> None:
    mailbox = Mailbox(["teleop"])
    mailbox.commands["teleop"].append(_command(12))
    mailbox.stops.append(Request(RequestKind.ESTOP, 0, 13))
    drained = mailbox.drain(10)
    assert drained.commands == (_command(10),)
    assert drained.requests == (Request(RequestKind.ESTOP, 0, 10),)


def test_a_stop_comes_after_a_reset_of_the_same_cycle() -> None:
    mailbox = Mailbox([])
    stop, reset = Request(RequestKind.ESTOP, 0, 1), Request(RequestKind.RESET, 1, 2)
    mailbox.stops.append(stop)
    mailbox.questions.append(reset)
    assert mailbox.drain(3).requests == (reset, stop)


@pytest.mark.parametrize("kind", [RequestKind.RESET, RequestKind.REFERENCE])
def test_a_loop_that_stalled_takes_the_stop_but_no_question(kind: RequestKind) -> None:
    mailbox = Mailbox([])
    stop = Request(RequestKind.ESTOP, 0, 1)
    mailbox.stops.append(stop)
    mailbox.questions.append(Request(kind, 1, 1))
    assert mailbox.drain(2 + QUESTION_EXPIRY_NS).requests == (stop,)


def test_questions_of_several_askers_reach_the_loop_in_one_cycle() -> None:
    mailbox = Mailbox([])
    asked = [Request(RequestKind.RESET, request_id, 1) for request_id in range(1, MAX_QUESTIONS + 1)]
    mailbox.questions.extend(asked)
    assert mailbox.drain(2).requests == tuple(asked)


def test_refusals_are_bounded() -> None:
    mailbox = Mailbox([])
    refusals = [Refusal("x", RefusalCode.MALFORMED, "", received_ns) for received_ns in range(2 * MAX_REFUSALS)]
    mailbox.refusals.extend(refusals)
    assert mailbox.drain(10_000).refusals == tuple(refusals[-MAX_REFUSALS:])


def test_an_empty_drain_is_cheap() -> None:
    mailbox = Mailbox([f"source{index}" for index in range(32)])
    best_s = min(timeit.repeat(partial(mailbox.drain, 0), number=1000, repeat=20)) / 1000
    assert best_s < 5e-6


def test_the_outbox_keeps_the_newest_state_and_all_events() -> None:
    outbox = Outbox()
    outbox.leave("state", lambda: b"old")
    outbox.leave_events([Event(Level.INFO, "a", "")], 1)
    outbox.leave("state", lambda: b"new")
    taken = list(outbox.take())
    assert [name for name, _ in taken] == ["event", "state"]
    assert taken[1] == ("state", b"new")
    assert list(outbox.take()) == []


def test_one_call_waits_however_much_is_left() -> None:
    outbox = Outbox()
    for _ in range(10):
        outbox.leave("odometry", lambda: b"")
    assert outbox.calls.qsize() == 1


def test_events_without_room_are_counted_once() -> None:
    outbox = Outbox()
    outbox.leave_events([Event(Level.INFO, f"number{index}", "") for index in range(MAX_EVENTS + 3)], 7_000_000_000)
    events = [decode_event(payload) for _, payload in outbox.take()]
    assert [event.code for event in events[:2] if event] == ["number0", "number1"]
    assert events[-1] == (7.0, Level.WARNING, "events_lost", "3 events could not be published in time")
    assert list(outbox.take()) == []

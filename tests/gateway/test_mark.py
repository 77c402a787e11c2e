"""A person's mark: words of one line that reach the recording, and of which nothing comes."""

import json
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.edges import messages
from gateway.types import Event, Level, Outputs, Reply, Request, RequestKind, SensorSample, Twist, TwistCommand
from replay.drive.closed_loop import Cycle
from tests.gateway.test_snapshot import goes_on_byte_for_byte
from tests.world import BUNDLED, World

WORDS = "it squeals in the bend, ünd wie"
BAD = ["", " ", "two\nlines", "\x1b[31mred", "a\u2028b", "x" * 201, "\ud800", "nul\0", "\u202eturned"]


@pytest.mark.parametrize("text", ["x", WORDS, "x" * 200, "🤖" * 200, '"quoted" \\'])
def test_words_go_there_and_come_back(text: str) -> None:
    assert messages.parse_mark(messages.encode_mark(text)) == messages.Mark(text)


@pytest.mark.parametrize("text", BAD)
def test_what_is_no_line_of_words_is_refused_on_both_sides(text: str) -> None:
    with pytest.raises(ValueError, match=r"text = .*: must be 1 to 200 printable characters in one line"):
        messages.encode_mark(text)
    assert isinstance(messages.parse_mark(json.dumps({"text": text}).encode()), str)


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "must be a JSON object"),
        (b"{}", "text is missing: must be 1 to 200"),
        (b'{"text": 1}', "text = 1: must be 1 to 200"),
        (b'{"text": "a", "more": 1}', "unknown key 'more'"),
        (b'{"text": "' + b"x" * 2000 + b'"}', "must be at most 1024 bytes"),
    ],
)
def test_a_wrong_payload_is_refused_in_words(payload: bytes, words: str) -> None:
    assert words in str(messages.parse_mark(payload))


@given(st.binary(max_size=300) | st.text(max_size=300).map(lambda text: json.dumps({"text": text}).encode()))
def test_no_payload_raises(payload: bytes) -> None:
    found = messages.parse_mark(payload)
    assert isinstance(found, str) or (found.text.isprintable() and 0 < len(found.text) <= messages.MAX_WORDS)


def mark(world: World, text: str = WORDS) -> Request:
    return Request(RequestKind.MARK, 8, world.now_ns + world.period_ns, text=text)


class Marking(World):
    """Marks every third cycle."""

    def cycle(
        self,
        *,
        commands: Iterable[TwistCommand] = (),
        requests: Iterable[Request] = (),
        samples: Iterable[SensorSample] = (),
    ) -> Outputs:
        marks = [mark(self)] if len(self.records) % 3 == 0 else []
        return super().cycle(commands=commands, requests=[*requests, *marks], samples=samples)


def driven(world: World) -> list[Cycle]:
    """Through start, drive, stop and reset."""
    world.start()
    world.run(0.5, Twist(0.2, 0.0, 0.1))
    world.request(RequestKind.ESTOP)
    world.run(1.0, None)
    world.request(RequestKind.RESET)
    world.run(0.2, None)
    return world.records


@pytest.mark.parametrize("name", BUNDLED)
def test_a_mark_is_told_and_changes_nothing(name: str) -> None:
    plain, marked = driven(World(name, rate_hz=100.0)), driven(Marking(name, rate_hz=100.0))
    assert len(plain) == len(marked)
    told = 0
    for (inputs, before), (asked, after) in zip(plain, marked, strict=True):
        answers = [reply for reply in after.replies if reply not in before.replies]
        there = any(request.kind is RequestKind.MARK for request in asked.requests)
        if there and not before.replies:
            assert answers == [Reply(8, ok=True, reason=None)]
        others = tuple(event for event in after.events if event.code != "mark")
        told += len(after.events) - len(others)
        assert (after.frames, after.mode, after.odometry, after.trace) == (
            before.frames,
            before.mode,
            before.odometry,
            before.trace,
        )
        assert others == before.events
        assert asked._replace(requests=inputs.requests) == inputs
    assert told >= 2  # once a second


def test_a_mark_is_an_event_with_its_words() -> None:
    world = World("moby")
    world.run(0.1)
    outputs = world.cycle(requests=[mark(world)])
    assert outputs.events == (Event(Level.INFO, "mark", WORDS),)
    assert outputs.status is not None


def test_a_drive_with_marks_goes_on_from_a_snapshot_byte_for_byte() -> None:
    world = World("omni4", rate_hz=100.0)
    world.start()
    for _ in range(20):
        world.cycle(requests=[mark(world)], commands=[world.command(Twist(0.2, 0.0, 0.0))])
    assert goes_on_byte_for_byte(world.records, world.config, every=5) > 5

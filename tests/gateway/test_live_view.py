"""The live view on the wire: only while somebody looks on, bounded, and of one version of the software."""

import hashlib
import logging
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from enum import Enum
from itertools import pairwise
from typing import get_args, get_type_hints

import msgspec
import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from gateway.client import Client
from gateway.config import RobotConfig
from gateway.core.samples import Sampler
from gateway.edges.live_view import MAX_SAMPLES, VIEW_SCHEMA, Batch, decode_batch, encode_batch
from gateway.edges.zenoh_link import ZenohLink
from gateway.recording.packets import Record
from gateway.types import Event, Level, Sample
from tests.drives import drive
from tests.gateway.test_zenoh_link import TIMEOUT_S, eventually
from tests.gateway.test_zenoh_link import _robot as robot

RECORDS = list(drive(4000))
SAMPLES = [
    sample
    for sampler in [Sampler()]
    for one in RECORDS
    if (sample := sampler.step(one.inputs, one.outputs, one.timing)) is not None
]
# One that never reads: its ring is full, its thread in Zenoh stands still with the process. It says so for an hour.
SUBSCRIBER = """
import sys, zenoh, json
config = zenoh.Config()
for key, value in {"mode": "client", "connect/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False,
                   "transport/link/tx/lease": 3_600_000}.items():
    config.insert_json5(key, json.dumps(value))
with zenoh.open(config) as session:
    subscriber = session.declare_subscriber("moby/view", zenoh.handlers.RingChannel(1))
    sys.stdin.read()
"""


class Loop:
    """Shows one cycle after the other, for ever."""

    def __init__(self, link: ZenohLink) -> None:
        self.shown: list[Record] = []
        self._link = link
        self._records = drive(10**6)

    def cycle(self) -> None:
        record = next(self._records)
        self._link.show(record.inputs, record.outputs, record.timing)
        self.shown.append(record)

    def until(self, probe: Callable[[], object]) -> None:
        def cycled() -> object:
            self.cycle()
            return probe()

        eventually(cycled)


@pytest.fixture
def endpoint(free_port: int) -> str:
    return f"tcp/127.0.0.1:{free_port}"


@pytest.fixture
def link(endpoint: str) -> Iterator[ZenohLink]:
    with ZenohLink(fast(endpoint), "# the robot file\n") as opened:
        yield opened


def fast(endpoint: str) -> RobotConfig:
    config = robot(endpoint)
    return config.model_copy(update={"zenoh": config.zenoh.model_copy(update={"view_rate": 50.0})})


@contextmanager
def onlooker(endpoint: str, seen: list[Sample]) -> Iterator[Client]:
    with Client("moby", connect=[endpoint]) as client:
        assert client.wait_alive(TIMEOUT_S)

        def take(payload: bytes) -> None:
            batch = decode_batch(payload)
            assert isinstance(batch, Batch)
            seen.extend(batch.samples)

        client.look(take)
        yield client


def test_while_nobody_looks_on_nothing_is_kept(link: ZenohLink) -> None:
    loop = Loop(link)
    for _ in range(500):
        loop.cycle()
    assert link._view._sampler is None
    assert not link._view._waiting


def test_who_looks_on_sees_what_is_drawn_of_every_cycle_from_then_on(link: ZenohLink, endpoint: str) -> None:
    loop, seen = Loop(link), list[Sample]()
    with onlooker(endpoint, seen):
        loop.until(lambda: len(seen) > 100)
    first = seen[0].cycle
    sampler = Sampler()
    all_of_them = [sampler.step(one.inputs, one.outputs, one.timing) for one in loop.shown[first:]]
    expected = [sample for sample in all_of_them if sample is not None]
    assert seen == expected[: len(seen)]


def test_when_the_last_one_goes_it_ends_and_the_next_one_begins_anew(link: ZenohLink, endpoint: str) -> None:
    loop = Loop(link)
    for _ in range(2):
        seen = list[Sample]()
        with onlooker(endpoint, seen):
            loop.until(lambda seen=seen: seen)  # type: ignore[misc]
        loop.until(lambda: link._view._sampler is None)
        assert seen[0].since == seen[0].cycle


def test_ten_look_on_and_each_sees_the_same(link: ZenohLink, endpoint: str) -> None:
    loop, all_seen = Loop(link), [list[Sample]() for _ in range(10)]
    with ExitStack() as stack:
        for seen in all_seen:
            stack.enter_context(onlooker(endpoint, seen))
        loop.until(lambda: min(map(len, all_seen)) > 50)
    whole = {sample.cycle: sample for sample in max(all_seen, key=len)}
    for seen in all_seen:
        assert all(whole[sample.cycle] == sample for sample in seen if sample.cycle in whole)
        assert all(sample.since == before.cycle + 1 for before, sample in pairwise(seen))


def test_one_that_is_frozen_or_killed_costs_the_others_nothing(link: ZenohLink, endpoint: str) -> None:
    loop, seen = Loop(link), list[Sample]()
    command = [sys.executable, "-c", SUBSCRIBER, endpoint]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as process:
        loop.until(lambda: link._view._watched)
        with onlooker(endpoint, seen):
            loop.until(lambda: seen)
            process.send_signal(signal.SIGSTOP)
            count = len(seen)
            loop.until(lambda: len(seen) > count + 200)
            assert link._view._watched
            process.kill()
            count = len(seen)
            loop.until(lambda: len(seen) > count + 50)
        assert all(sample.since == before.cycle + 1 for before, sample in pairwise(seen))


def test_one_whose_connection_is_full_is_waited_for_by_nobody(link: ZenohLink, endpoint: str) -> None:
    """More than the sockets of both sides hold."""
    assert link._view._publisher.congestion_control == zenoh.CongestionControl.DROP
    long = (Event(Level.INFO, "long", "x" * 60_000),)
    records, seen = drive(10**6), list[Sample]()
    with subprocess.Popen([sys.executable, "-c", SUBSCRIBER, endpoint], stdin=subprocess.PIPE) as process:
        eventually(lambda: link._view._watched)
        process.send_signal(signal.SIGSTOP)
        with onlooker(endpoint, seen):

            def much() -> bool:
                record = next(records)
                link.show(record.inputs, record.outputs._replace(events=long), record.timing)
                return sum(len(sample.events) for sample in seen) > 500

            eventually(much)
        process.kill()


def test_what_cannot_be_sent_in_time_is_dropped_oldest_first(link: ZenohLink) -> None:
    view = link._view
    view._ended.set()  # its thread comes no more
    view._changed.set()
    view._thread.join(TIMEOUT_S)
    view._watched = True
    for record in RECORDS:
        view.show(record.inputs, record.outputs, record.timing)
    assert len(view._waiting) == MAX_SAMPLES < len(SAMPLES)
    assert list(view._waiting) == SAMPLES[-MAX_SAMPLES:]


def test_a_value_that_no_payload_holds_costs_a_batch(
    link: ZenohLink, endpoint: str, caplog: pytest.LogCaptureFixture
) -> None:
    loop, seen = Loop(link), list[Sample]()
    first = RECORDS[0]
    huge = first.timing._replace(wall_ns=2**70)
    with onlooker(endpoint, seen), caplog.at_level(logging.WARNING):
        loop.until(lambda: seen)

        def told() -> bool:
            link.show(first.inputs, first.outputs, huge)
            return "cannot be told" in caplog.text

        eventually(told)
        count = len(seen)
        loop.until(lambda: len(seen) > count)
    assert caplog.text.count("cannot be told") == 1


def test_it_ends_with_the_link_while_somebody_looks_on(endpoint: str) -> None:
    seen = list[Sample]()
    link = ZenohLink(fast(endpoint), "")
    with onlooker(endpoint, seen):
        Loop(link).until(lambda: seen)
        link.close()
        assert not link._view._thread.is_alive()
    link.show(*(getattr(RECORDS[0], name) for name in ("inputs", "outputs", "timing")))
    assert link._view._sampler is None


def test_the_wire_gives_back_what_was_put_on_it() -> None:
    batch = Batch("a run", tuple(SAMPLES))
    assert decode_batch(encode_batch(batch)) == batch


def test_another_version_is_refused_in_words() -> None:
    payload = msgspec.msgpack.encode((VIEW_SCHEMA + 1, "9.9 (of tomorrow)", "a run", {"something": "else"}))
    said = decode_batch(payload)
    assert isinstance(said, str)
    assert f"another version: '9.9 (of tomorrow)' tells views of schema {VIEW_SCHEMA + 1}" in said
    assert f"reads schema {VIEW_SCHEMA}" in said


@given(st.binary(max_size=200) | st.integers(1, 50).map(lambda at: encode_batch(Batch("r", tuple(SAMPLES[:3])))[at:]))
def test_what_is_no_view_is_refused_in_words(payload: bytes) -> None:
    assert isinstance(decode_batch(payload), str)


def test_a_payload_of_a_million_brackets_is_refused_in_words() -> None:
    for payload in (b"\x91" * 10**6, b"\x94\x01\xa1x\xa1y" + b"\x91" * 10**6):
        assert isinstance(decode_batch(payload), str)


def words(kind: object, seen: dict[object, str]) -> str:
    """Every name and type that a payload consists of."""
    if kind in seen:
        return seen[kind]
    seen[kind] = kind.__name__ if isinstance(kind, type) and not get_args(kind) else ""
    if isinstance(kind, type) and issubclass(kind, Enum):
        told = [f"{one.name}={one.value}" for one in kind]
    elif isinstance(kind, type) and hasattr(kind, "_fields"):
        hints = get_type_hints(kind)
        told = [f"{name}:{words(hints[name], seen)}" for name in kind._fields]
    else:
        told = [words(one, seen) for one in get_args(kind)]
    return f"{seen[kind]}({','.join(told)})"


def test_whoever_changes_a_field_of_a_sample_changes_the_number_of_the_schema() -> None:
    """Then write the new number and the new digest here: an old viewer would take one field for another."""
    digest = hashlib.sha256(words(Sample, {}).encode()).hexdigest()[:16]
    assert (VIEW_SCHEMA, digest) == (1, "556d71513750184b")

"""The loop with fake edges: deadlines, overruns, shutdown, and what a bug in the core leads to."""

import itertools
import logging
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence

import pytest

from drivers.interface import CanFrame
from gateway import service as service_module
from gateway.config import parse
from gateway.service import EXIT_CORE_BUG, Service
from gateway.systemd import Notifier
from gateway.types import (
    BusEvent,
    CycleTiming,
    Event,
    Inputs,
    Odometry,
    Outputs,
    Refusal,
    Reply,
    Request,
    Status,
    TwistCommand,
)
from replay.sim.bus import SimulatedBus
from tests.world import robot_text

CONFIG = parse(robot_text("moby"), "moby")
PERIOD_NS = 4_000_000


class FakeTime:
    """A clock that moves only when somebody sleeps, or when a test makes a cycle slow."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000_000
        self.CLOCK_REALTIME = 0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += max(1, round(seconds * 1e9))

    def clock_gettime_ns(self, _clock: int) -> int:
        return self.now_ns


class FakeLink:
    def __init__(self) -> None:
        self.published: list[tuple[int, Status | None]] = []

    def drain(self, now_ns: int) -> tuple[Sequence[TwistCommand], Sequence[Refusal], Sequence[Request]]:
        assert now_ns > 0
        return (), (), ()

    def reply(self, reply: Reply) -> None:
        raise AssertionError(reply)

    def publish(
        self,
        *,
        odometry: Odometry | None,
        status: Status | None,
        events: Sequence[Event],
        now_ns: int,
        extras: Mapping[str, object],
    ) -> None:
        assert odometry or status or events
        assert extras or status is None
        self.published.append((now_ns, status))


class FakeRecorder:
    def __init__(self) -> None:
        self.records: list[tuple[Inputs, Outputs, CycleTiming]] = []
        self.dropped = 0

    def put(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming) -> None:
        self.records.append((inputs, outputs, timing))

    def poll(self) -> None:
        """Nothing to take in."""

    def health(self) -> dict[str, object]:
        return {"session": None}


class SpyBus(SimulatedBus):
    """The simulated bus, remembering what was sent; `before` is called at the start of every cycle."""

    def __init__(self, before: Callable[[int], None]) -> None:
        super().__init__(CONFIG)
        self.sent: list[list[CanFrame]] = []
        self.before = before
        self.cycles = itertools.count()

    def receive(self, now_ns: int) -> tuple[list[CanFrame], list[BusEvent]]:
        self.before(next(self.cycles))
        return super().receive(now_ns)

    def send(self, frames: Sequence[CanFrame], now_ns: int) -> None:
        self.sent.append(list(frames))
        super().send(frames, now_ns)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeTime]:
    fake = FakeTime()
    monkeypatch.setattr(service_module, "time", fake)
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield fake
    for number, handler in before.items():
        signal.signal(number, handler)


def run(before: Callable[[Service, int], None]) -> tuple[int, SpyBus, FakeRecorder, FakeLink]:
    """Run the service; `before(service, cycle)` may stop it, slow it down or break it."""
    recorder, link = FakeRecorder(), FakeLink()
    bus = SpyBus(lambda cycle: before(service, cycle))
    service = Service(CONFIG, bus=bus, link=link, recorder=recorder, notifier=Notifier({}))
    return service.run(), bus, recorder, link


def test_cycles_keep_absolute_deadlines_and_end_on_request(clock: FakeTime) -> None:
    def before(service: Service, cycle: int) -> None:
        clock.now_ns += 700_000
        if cycle == 50:
            service.stop()

    code, bus, recorder, link = run(before)
    assert code == 0
    times = [inputs.now_ns for inputs, _, _ in recorder.records]
    assert {after - before for before, after in itertools.pairwise(times)} == {PERIOD_NS}
    assert [inputs.cycle for inputs, _, _ in recorder.records] == list(range(len(times)))
    assert recorder.records[-1][1].finished
    assert bus.sent[-1], "motors are released last"
    assert link.published


def test_overruns_are_counted_and_deadlines_skipped_not_made_up(clock: FakeTime) -> None:
    def before(service: Service, cycle: int) -> None:
        if cycle == 10:
            clock.now_ns += 3 * PERIOD_NS + 1_000_000
        if cycle == 20:
            service.stop()

    _, _, recorder, _ = run(before)
    overruns = [inputs.overruns for inputs, _, _ in recorder.records]
    assert overruns[10] == 0
    assert overruns[11] == 2, "two deadlines passed unseen, the third is served late"
    assert overruns[-1] == 2
    late = [timing.late_ns for _, _, timing in recorder.records]
    assert late[11] < PERIOD_NS


def test_a_bug_in_the_core_stops_the_motors_and_is_told(clock: FakeTime, caplog: pytest.LogCaptureFixture) -> None:
    def before(service: Service, cycle: int) -> None:
        clock.now_ns += 1000
        if cycle == 5:
            service._engine.step = lambda _inputs: 1 / 0  # type: ignore[assignment,method-assign,return-value]

    with caplog.at_level(logging.CRITICAL):
        code, bus, recorder, _ = run(before)
    assert code == EXIT_CORE_BUG
    assert len(recorder.records) == 5
    names = [frame.id & 0x1F for frame in bus.sent[-2]]
    assert set(names) == {0x0D}, "velocity zero to every axis"
    assert 0x07 in {frame.id & 0x1F for frame in bus.sent[-1]}, "then released"


def test_a_robot_that_will_not_rest_does_not_keep_the_process_alive(
    clock: FakeTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    def before(service: Service, cycle: int) -> None:
        clock.now_ns += 1000
        if cycle == 0:
            step = service._engine.step
            monkeypatch.setattr(service._engine, "step", lambda inputs: step(inputs)._replace(finished=False))
            service.stop()

    code, _, recorder, _ = run(before)
    assert code == 0
    assert (recorder.records[-1][0].now_ns - recorder.records[0][0].now_ns) / 1e9 == pytest.approx(8.0, abs=0.1)

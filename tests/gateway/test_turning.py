"""The loop that turns motors leaves none turning, however it ends; with a clock of its own."""

from collections.abc import Callable, Sequence

import pytest

from drivers.contract import CanFrame
from gateway.config import parse
from gateway.edges.signals import EndRequest
from gateway.edges.turning import turn
from gateway.setup.jog import Ending, Jog, Phase
from gateway.types import BusEvent, BusEventKind
from tests.jogging import CYCLE_NS, ENDS_NS, Bench
from tests.setup_robots import TRUE


class Bus:
    """The simulated bus as the loop sees it; `disturb` is called before each of its receives."""

    def __init__(self, bench: Bench, jog: Jog, disturb: Callable[[], None]) -> None:
        self._bench = bench
        self._jog = jog
        self._disturb = disturb
        self.events: list[BusEvent] = []

    def receive(self, now_ns: int) -> tuple[list[CanFrame], list[BusEvent]]:
        self._disturb()
        events, self.events = self.events, []
        return self._bench.bus.receive(now_ns)[0], events

    def send(self, frames: Sequence[CanFrame], now_ns: int) -> None:
        self._bench.bus.send(frames, now_ns)

    def close(self) -> None:
        pass


class Stand:
    """A jog under way, with virtual time for the loop."""

    def __init__(self, name: str, disturb: Callable[["Stand"], None]) -> None:
        config = parse(TRUE[name](), name)
        self.bench = Bench(config)
        self.jog = Jog(config, config.motors_in_order()[0].name, speed=1.0, seconds=3.0)
        self.ending = EndRequest()
        self.bus = Bus(self.bench, self.jog, lambda: disturb(self))
        self.disturbed_ns: int | None = None

    @property
    def fast(self) -> bool:
        """Once, when it turns fast."""
        first = self.disturbed_ns is None and self.bench.bus.robot.truth.joint_rates[0] > 0.8
        self.disturbed_ns = self.bench.now_ns if first else self.disturbed_ns
        return first

    def run(self) -> None:
        def sleep(seconds: float) -> None:
            self.bench.now_ns += max(1, round(seconds * 1e9))

        clock = lambda: self.bench.now_ns  # noqa: E731  # a clock is one line
        turn(self.bus, self.jog, self.ending, period_ns=CYCLE_NS, clock=clock, sleep=sleep)

    def rests(self) -> bool:
        """Within a fifth of a second, and for good."""
        assert self.disturbed_ns is not None
        assert self.bench.now_ns - self.disturbed_ns < ENDS_NS + 600_000_000
        self.bench.wait(1.0)
        return self.bench.bus.robot.truth.joint_rates == (0.0,) * len(self.bench.config.motor)


class BugError(Exception):
    """Of ours."""


@pytest.mark.parametrize("name", TRUE)
def test_a_bug_ends_in_frames_that_stop_and_release(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def break_it(stand: Stand) -> None:
        if stand.fast:
            monkeypatch.setattr(Jog, "_objection", raise_bug)

    def raise_bug(*_: object) -> None:
        raise BugError

    stand = Stand(name, break_it)
    with pytest.raises(BugError):
        stand.run()
    assert stand.rests()


@pytest.mark.parametrize("name", TRUE)
def test_whatever_raises_in_the_bus_ends_so_too(name: str) -> None:
    def interrupt(stand: Stand) -> None:
        if stand.fast:
            raise KeyboardInterrupt

    stand = Stand(name, interrupt)
    with pytest.raises(KeyboardInterrupt):
        stand.run()
    assert stand.rests()


@pytest.mark.parametrize("name", TRUE)
def test_a_signal_ends_it_in_order(name: str) -> None:
    def ask(stand: Stand) -> None:
        if stand.fast:
            stand.ending.ask("signal 15")

    stand = Stand(name, ask)
    stand.run()
    assert stand.jog.outcome is not None
    assert (stand.jog.outcome.ending, stand.jog.outcome.reason) == (Ending.ASKED, "signal 15")
    assert stand.jog.outcome.released
    assert stand.rests()


def test_a_bus_that_fails_ends_it_and_one_that_is_still_being_opened_does_not() -> None:
    def fail(stand: Stand) -> None:
        if stand.jog.phase is Phase.LISTEN:
            stand.bus.events = [BusEvent("can0", BusEventKind.DOWN, 1, "socketcan can0 is being opened")]
        if stand.fast:
            stand.bus.events = [BusEvent("can0", BusEventKind.DOWN, 1, "controller is bus-off")]

    stand = Stand("kiwi", fail)
    stand.run()
    assert stand.jog.outcome is not None
    assert (stand.jog.outcome.ending, stand.jog.outcome.reason) == (Ending.ASKED, "can0: controller is bus-off")
    assert stand.rests()

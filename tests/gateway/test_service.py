"""The loop with fake edges: deadlines, overruns, shutdown, and what a bug in the core leads to."""

import itertools
import logging
from collections.abc import Callable, Mapping, Sequence

import pytest

from drivers.contract import CanFrame
from gateway import service as service_module
from gateway.config import RobotConfig, parse
from gateway.control.limits import stopping_time
from gateway.core.snapshot import State
from gateway.edges.estop_latch import Kept
from gateway.edges.signals import EndRequest
from gateway.edges.systemd import Notifier
from gateway.service import EXIT_CORE_BUG, EXIT_LINK_LOST, Drained, Service
from gateway.types import (
    ZERO_TWIST,
    BusEvent,
    CycleTiming,
    Event,
    Inputs,
    Level,
    Mode,
    Odometry,
    Outputs,
    Reply,
    Request,
    RequestKind,
    Status,
    Twist,
    TwistCommand,
    TwistFrame,
)
from replay.sim.bus import SimulatedBus
from tests.world import robot_text

CONFIG = parse(robot_text("moby"), "moby")
PERIOD_NS = 4_000_000
STOPPING_S = stopping_time(
    velocity=CONFIG.limits.velocity.as_twist(),
    acceleration=CONFIG.limits.acceleration.as_twist(),
    jerk=CONFIG.limits.jerk.as_twist(),
)


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
    """A commander that starts the robot and then streams `twist`; `broken` names what raises."""

    def __init__(self) -> None:
        self.published: list[tuple[int, Status | None]] = []
        self.events: list[Event] = []
        self.extras: Mapping[str, object] = {}
        self.shown: list[tuple[Inputs, Outputs, CycleTiming]] = []
        self.twist: Twist | None = None
        self.requests: list[Request] = []
        self.broken = ""

    def drain(self, now_ns: int) -> Drained:
        assert now_ns > 0
        if self.broken == "drain":
            raise RuntimeError("a thread of the link ended")
        requests, self.requests = self.requests, []
        if self.twist is None:
            return (), (), requests, ()
        return [TwistCommand("teleop", self.twist, TwistFrame.BODY, None, now_ns)], (), requests, ()

    def reply(self, reply: Reply) -> None:
        if self.broken == "reply":
            raise RuntimeError("no replies any more")
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
        if self.broken == "publish":
            raise RuntimeError("no publishing any more")
        self.published.append((now_ns, status))
        self.events += events
        self.extras = extras or self.extras

    def show(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming) -> None:
        if self.broken == "show":
            raise RuntimeError("no view any more")
        self.shown.append((inputs, outputs, timing))

    def codes(self) -> list[str]:
        return [event.code for event in self.events]


class FakeRecorder:
    def __init__(self) -> None:
        self.records: list[tuple[Inputs, Outputs, CycleTiming]] = []
        self.dropped = 0
        self.news: list[Event] = []

        self.broken = ""

    def put(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming, state: Callable[[], State]) -> None:
        if self.broken == "put":
            raise RuntimeError("no records any more")
        self.records.append((inputs, outputs, timing))

    def poll(self) -> Sequence[Event]:
        if self.broken == "poll":
            raise RuntimeError("no reports any more")
        news, self.news = self.news, []
        return news

    def health(self) -> dict[str, object]:
        if self.broken == "health":
            raise RuntimeError("no health any more")
        return {"session": None}


class FakeLatch:
    def __init__(self, kept: Kept | None = None) -> None:
        self.kept = kept
        self.on_disk = False
        self.problem: str | None = None
        self.wanted: list[bool] = []

    def want(self, *, stopped: bool) -> None:
        if self.wanted[-1:] != [stopped]:
            self.wanted.append(stopped)

    def health(self) -> dict[str, object]:
        return {"on_disk": self.on_disk}


class SpyBus(SimulatedBus):
    """The simulated bus, remembering what was sent; `before` is called at the start of every cycle."""

    def __init__(self, config: RobotConfig, before: Callable[[int], None]) -> None:
        super().__init__(config)
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
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeTime:
    fake = FakeTime()
    monkeypatch.setattr(service_module, "time", fake)
    return fake


class Stand:
    """A service with fake edges; `before(stand, cycle)` may stop it, slow it down or break it."""

    def __init__(
        self, before: Callable[["Stand", int], None], *, robot: str = "moby", kept: Kept | None = None
    ) -> None:
        config = parse(robot_text(robot), robot)
        self.bus = SpyBus(config, lambda cycle: before(self, cycle))
        self.link, self.recorder, self.latch = FakeLink(), FakeRecorder(), FakeLatch(kept)
        self.ending = EndRequest()
        self.service = Service(
            config,
            bus=self.bus,
            link=self.link,
            recorder=self.recorder,
            latch=self.latch,
            notifier=Notifier({}),
            ending=self.ending,
        )
        self.code: int | None = None

    def run(self) -> "Stand":
        self.code = self.service.run()
        return self

    def break_core(self) -> None:
        self.service._engine.step = lambda _inputs: 1 / 0  # type: ignore[assignment,method-assign,return-value]

    def true_speed(self) -> float:
        return max(map(abs, self.bus.robot.truth.twist))

    def modes(self) -> list[Mode]:
        return [mode for mode, _ in itertools.groupby(outputs.mode for _, outputs, _ in self.recorder.records)]


def drive(stand: Stand, cycle: int, twist: Twist, *, from_cycle: int = 200) -> None:
    """Zero until ready, then this twist."""
    stand.link.twist = twist if cycle >= from_cycle else ZERO_TWIST if cycle >= 75 else None


def test_cycles_keep_absolute_deadlines_and_end_on_request(clock: FakeTime) -> None:
    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 700_000
        if cycle == 50:
            stand.ending.ask("a test")

    stand = Stand(before).run()
    assert stand.code == 0
    records = stand.recorder.records
    times = [inputs.now_ns for inputs, _, _ in records]
    assert {after - before for before, after in itertools.pairwise(times)} == {PERIOD_NS}
    assert [inputs.cycle for inputs, _, _ in records] == list(range(len(times)))
    assert records[-1][1].finished
    assert stand.bus.sent[-1], "motors are released last"
    assert stand.link.published


def test_overruns_are_counted_and_deadlines_skipped_not_made_up(clock: FakeTime) -> None:
    def before(stand: Stand, cycle: int) -> None:
        if cycle == 10:
            clock.now_ns += 3 * PERIOD_NS + 1_000_000
        if cycle == 20:
            stand.service.stop()

    stand = Stand(before).run()
    overruns = [inputs.overruns for inputs, _, _ in stand.recorder.records]
    assert overruns[10] == 0
    assert overruns[11] == 2, "two deadlines passed unseen, the third is served late"
    assert overruns[-1] == 2
    late = [timing.late_ns for _, _, timing in stand.recorder.records]
    assert late[11] < PERIOD_NS


def test_an_end_asked_for_before_the_first_cycle_drives_nothing(clock: FakeTime) -> None:
    def before(stand: Stand, cycle: int) -> None:
        stand.link.twist = ZERO_TWIST
        clock.now_ns += 1000

    stand = Stand(before)
    stand.ending.ask("signal 15")
    stand.ending.ask("signal 1")
    stand.run()
    assert stand.code == 0
    assert len(stand.recorder.records) == 1
    assert stand.modes() == [Mode.IDLE]


CRASH_CYCLE = 900


def test_a_bug_in_the_core_brakes_a_driving_robot_to_rest_and_then_releases_it(clock: FakeTime) -> None:
    at_crash: list[float] = []

    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        drive(stand, cycle, Twist(0.8, 0.0, 0.0))
        if cycle == CRASH_CYCLE:
            assert stand.true_speed() > 0.78
            at_crash.append(stand.bus.robot.truth.pose.x)
            stand.break_core()

    stand = Stand(before).run()
    assert stand.code == EXIT_CORE_BUG
    assert len(stand.recorder.records) == CRASH_CYCLE
    assert stand.true_speed() < 0.005
    assert stand.bus.robot.truth.pose.x - at_crash[0] < 0.05
    last = stand.bus.sent[CRASH_CYCLE:]
    assert all({frame.id & 0x1F for frame in frames} == {0x0D} for frames in last[:-1]), "velocity zero to every axis"
    assert 0x07 in {frame.id & 0x1F for frame in last[-1]}, "then released"
    assert 250_000_000 < len(last) * PERIOD_NS < 1_000_000_000, "at rest for a while, not after a fixed time"
    assert "core_bug" in stand.link.codes()


def test_a_bug_in_the_core_brakes_motors_that_know_no_speed_command(clock: FakeTime) -> None:
    """A C620 takes only a current: its driver brakes from the measured speed."""
    at_crash: list[float] = []

    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        drive(stand, cycle, Twist(0.8, 0.0, 0.0))
        if cycle == CRASH_CYCLE:
            at_crash.append(stand.bus.robot.truth.pose.x)
            stand.break_core()

    stand = Stand(before, robot="omni4").run()
    assert stand.code == EXIT_CORE_BUG
    assert stand.true_speed() < 0.05
    assert stand.bus.robot.truth.pose.x - at_crash[0] < 0.25
    assert stand.bus.sent[-1][0].data == bytes(8), "released"


def test_a_broken_core_that_cannot_hear_its_motors_stops_them_for_the_stopping_time(clock: FakeTime) -> None:
    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        if cycle == 5:
            stand.break_core()
        if cycle > 5:
            raise OSError("deaf")

    stand = Stand(before).run()
    assert stand.code == EXIT_CORE_BUG
    seconds = len(stand.bus.sent[5:]) * PERIOD_NS * 1e-9
    assert seconds == pytest.approx(STOPPING_S + 0.25, abs=0.05)
    assert 0x07 in {frame.id & 0x1F for frame in stand.bus.sent[-1]}, "released in the end"


def test_a_motor_that_says_nothing_is_not_taken_for_one_that_stands(clock: FakeTime) -> None:
    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        if cycle == 5:
            stand.bus.robot.devices["left"].unplug()
            stand.break_core()

    stand = Stand(before).run()
    seconds = len(stand.bus.sent[5:]) * PERIOD_NS * 1e-9
    assert seconds == pytest.approx(STOPPING_S + 0.25, abs=0.05)


def test_a_bus_that_cannot_send_does_not_keep_a_broken_core_alive(
    clock: FakeTime, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def deaf(frames: Sequence[CanFrame], now_ns: int) -> None:
        raise OSError(f"no {len(frames)} frames at {now_ns > 0}")

    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        if cycle == 5:
            monkeypatch.setattr(stand.bus, "send", deaf)

    with caplog.at_level(logging.ERROR):
        assert Stand(before).run().code == EXIT_CORE_BUG
    assert 1 <= len([record for record in caplog.records if "while ending" in record.message]) <= 2


@pytest.mark.parametrize("broken", ["drain", "publish"])
def test_a_link_that_has_gone_is_silence_and_then_the_end(clock: FakeTime, broken: str) -> None:
    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        drive(stand, cycle, Twist(0.5, 0.0, 0.0))
        if cycle == 700:
            assert stand.true_speed() > 0.45
            stand.link.broken = broken

    stand = Stand(before).run()
    assert stand.code == EXIT_LINK_LOST
    assert stand.modes()[-3:] == [Mode.DRIVE, Mode.STOPPING, Mode.IDLE]
    assert stand.true_speed() < 0.005
    setpoints = [outputs.trace.setpoint.vx for _, outputs, _ in stand.recorder.records[700:]]
    assert max(map(abs, map(float.__sub__, setpoints[1:], setpoints[:-1]))) < 0.8 * 0.004 * 1.01, "a ramp"
    assert ("link_lost" in stand.link.codes()) == (broken == "drain")


def test_a_link_that_fails_to_reply_is_gone_too(clock: FakeTime) -> None:
    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        if cycle == 50:
            stand.link.broken = "reply"
            stand.link.requests = [Request(RequestKind.RESET, 1, clock.now_ns)]

    stand = Stand(before).run()
    assert stand.code == EXIT_LINK_LOST
    assert stand.modes()[-1] is Mode.IDLE


@pytest.mark.parametrize("broken", ["put", "poll", "health"])
def test_a_recorder_that_raises_is_told_and_driven_without(clock: FakeTime, broken: str) -> None:
    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        drive(stand, cycle, Twist(0.5, 0.0, 0.0))
        if cycle == 600:
            stand.recorder.broken = broken
        if cycle == 700:
            assert stand.true_speed() > 0.45
            stand.ending.ask("a test")

    stand = Stand(before).run()
    assert stand.code == 0
    assert stand.link.codes().count("recorder_lost") == 1
    assert ("dropped_records" in stand.link.codes()) == (broken == "put")
    recording = stand.link.extras["recording"]
    assert isinstance(recording, dict)
    assert "any more" in str(recording["error"])


def test_a_live_view_that_raises_is_told_and_driven_without(clock: FakeTime) -> None:
    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        drive(stand, cycle, Twist(0.5, 0.0, 0.0))
        if cycle == 600:
            stand.link.broken = "show"
        if cycle == 700:
            assert stand.true_speed() > 0.45
            stand.link.broken = ""
            stand.ending.ask("a test")

    stand = Stand(before).run()
    assert stand.code == 0
    assert stand.link.codes().count("view_lost") == 1
    assert stand.link.shown == stand.recorder.records[:600], "as recorded, and not again once it has failed"


def test_what_the_recorder_has_kept_is_told(clock: FakeTime) -> None:
    news = Event(Level.INFO, "incident", "incidents/moby-1.rrd")

    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        if cycle == 50:
            stand.recorder.news = [news]
        if cycle == 150:
            stand.ending.ask("a test")

    stand = Stand(before).run()
    assert stand.link.events.count(news) == 1


@pytest.mark.pure_python
def test_a_robot_that_will_not_rest_does_not_keep_the_process_alive(
    clock: FakeTime, monkeypatch: pytest.MonkeyPatch
) -> None:
    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        if cycle == 0:
            step = stand.service._engine.step
            monkeypatch.setattr(stand.service._engine, "step", lambda inputs: step(inputs)._replace(finished=False))
            stand.service.stop()

    stand = Stand(before).run()
    assert stand.code == 0
    records = stand.recorder.records
    seconds = (records[-1][0].now_ns - records[0][0].now_ns) / 1e9
    assert seconds == pytest.approx(2.0 * STOPPING_S + 4.0 + 1.0, abs=0.1)


def test_a_kept_emergency_stop_is_one_from_the_first_cycle(clock: FakeTime) -> None:
    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        drive(stand, cycle, Twist(0.5, 0.0, 0.0))
        if cycle == 300:
            stand.ending.ask("a test")

    stand = Stand(before, kept=Kept("emergency stop requested, set yesterday, before this start", sound=True))
    stand.latch.on_disk = True
    stand.run()
    assert stand.modes() == [Mode.ESTOP]
    assert [request.kind for request in stand.recorder.records[0][0].requests] == [RequestKind.ESTOP]
    (event,) = [event for event in stand.link.events if event.code == "estop_kept"]
    assert "yesterday" in event.text
    assert stand.latch.wanted == [True]


def test_an_emergency_stop_acts_at_once_and_is_told_when_it_is_on_disk(clock: FakeTime) -> None:
    told: list[int] = []

    def before(stand: Stand, cycle: int) -> None:
        clock.now_ns += 1000
        drive(stand, cycle, Twist(0.5, 0.0, 0.0))
        if cycle == 700:
            stand.link.requests = [Request(RequestKind.ESTOP, 0, clock.now_ns)]
        if cycle == 760:
            assert stand.latch.wanted == [False, True]
            assert stand.true_speed() < 0.1, "the robot does not wait for the disk"
            stand.latch.on_disk = True
        if "mode_estop" in stand.link.codes() and not told:
            told.append(cycle)
        if cycle == 800:
            stand.ending.ask("a test")

    stand = Stand(before).run()
    assert told == [761]
    assert stand.recorder.records[700][1].mode is Mode.ESTOP
    statuses = [(now_ns, status.mode) for now_ns, status in stand.link.published if status is not None]
    assert min(now_ns for now_ns, mode in statuses if mode is Mode.ESTOP) == stand.recorder.records[700][0].now_ns
    assert [now_ns for now_ns, _ in statuses] == sorted(now_ns for now_ns, _ in statuses), (
        "nothing is lost or reordered"
    )

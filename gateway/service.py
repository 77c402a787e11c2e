"""The live loop: one thread that owns the core. Drain, step, send, publish, record; absolute deadlines.

How this works
--------------
Everything outside the core is an edge given to the constructor. The loop never waits for one of them: buses drop,
the link hands over to its own threads, log lines go through a queue, the recorder is another process, the latch of the
emergency stop has a thread. An edge that raises is an edge that has gone: without the link the robot comes to rest as
for a silent commander and the service ends, without the recorder or the live view it drives on.
A bug in the core ends in one handler, here: stop frames in every period until the motors report rest, then release,
exit code 70; the motors' own watchdogs guard what is left.
"""

import gc
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Protocol, TypeVar

from drivers.contract import CanFrame
from gateway.config import ConfigError, RobotConfig
from gateway.control.limits import stopping_time
from gateway.core.channels import layout_of
from gateway.core.engine import Engine
from gateway.core.snapshot import State
from gateway.core.standstill import REST_DWELL_NS, REST_TIMEOUT_NS
from gateway.edges.can_bus import BusEdge
from gateway.edges.estop_gate import EstopGate, News
from gateway.edges.estop_latch import Kept
from gateway.edges.signals import EndRequest
from gateway.edges.systemd import Notifier, Readiness
from gateway.types import (
    CycleTiming,
    Event,
    Inputs,
    Level,
    Mode,
    Odometry,
    Outputs,
    Refusal,
    Reply,
    Request,
    RequestKind,
    SensorSample,
    Status,
    Trace,
    TwistCommand,
)

logger = logging.getLogger(__name__)
_T = TypeVar("_T")

EXIT_CORE_BUG = 70  # EX_SOFTWARE of sysexits.h
EXIT_LINK_LOST = 69  # EX_UNAVAILABLE
SHUTDOWN_GRACE_NS = 1_000_000_000
Drained = tuple[Sequence[TwistCommand], Sequence[Refusal], Sequence[Request], Sequence[SensorSample]]
_NOTHING: Drained = ((), (), (), ())
_LOG_LEVELS = {Level.INFO: logging.INFO, Level.WARNING: logging.WARNING, Level.ERROR: logging.ERROR}


class Link(Protocol):
    """What the loop needs of the commanding side (Zenoh)."""

    def drain(self, now_ns: int) -> Drained: ...

    def reply(self, reply: Reply) -> None: ...

    def publish(
        self,
        *,
        odometry: Odometry | None,
        status: Status | None,
        events: Sequence[Event],
        now_ns: int,
        extras: Mapping[str, object],
    ) -> None: ...

    def show(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming) -> None: ...


class RecorderEdge(Protocol):
    """What the loop needs of the recorder."""

    @property
    def dropped(self) -> int: ...

    def put(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming, state: Callable[[], State]) -> None: ...

    def poll(self) -> Sequence[Event]: ...

    def health(self) -> dict[str, object]: ...


class LatchEdge(Protocol):
    """What the loop needs of the latch of the emergency stop."""

    @property
    def kept(self) -> Kept | None: ...

    @property
    def on_disk(self) -> bool: ...

    @property
    def problem(self) -> str | None: ...

    def want(self, *, stopped: bool) -> None: ...

    def health(self) -> dict[str, object]: ...


class Service:
    """Runs one robot until `ending` asks for its end, or a bug. `after_cycle` is called last in every cycle."""

    def __init__(
        self,
        config: RobotConfig,
        *,
        bus: BusEdge,
        link: Link,
        recorder: RecorderEdge,
        latch: LatchEdge,
        notifier: Notifier,
        ending: EndRequest,
        after_cycle: Callable[[int, Outputs], None] | None = None,
    ) -> None:
        self._engine = Engine(config)
        self._channels = layout_of(config)
        self._trace: Trace | None = None  # of the newest cycle
        self._bus = bus
        self._link = link
        self._recorder = recorder
        self._latch = latch
        self._notifier = notifier
        self._ending = ending
        self._after_cycle = after_cycle
        self._period_ns = round(1e9 / config.loop.rate)
        self._stopping_ns = _stopping_ns(config)
        self._ending_ns = ending_ns(config)
        self._cycle = 0
        self._overruns = 0
        self._unrecorded = 0  # cycles the recorder raised at
        self._recorder_error: str | None = None
        self._link_lost = False
        self._view_lost = False
        self._bus_error: str | None = None
        self._stop_since_ns: int | None = None
        self._exit_code = 0
        self._readiness = Readiness(notifier, time.monotonic_ns())
        self._gate = EstopGate()
        self._own_events: list[Event] = []
        if latch.kept is not None:
            self._own_events.append(Event(Level.ERROR, "estop_kept", f"the emergency stop is kept: {latch.kept.note}"))

    def stop(self) -> None:
        """Ask for an orderly end: ramp to rest, release, return from `run`."""
        self._ending.ask("the service itself")

    def run(self) -> int:
        """The loop; returns the exit code. Raises ConfigError for what only the first use of an interface can tell."""
        gc.collect()
        gc.freeze()
        try:
            self._loop()
        except ConfigError:
            self._end_broken()
            raise
        except Exception as error:
            self._end_broken(error)
            return EXIT_CORE_BUG
        self._send(self._engine.coast_frames)
        return self._exit_code

    def _loop(self) -> None:
        deadline_ns = time.monotonic_ns()
        while True:
            now_ns = self._wait(deadline_ns)
            late_ns = now_ns - deadline_ns
            outputs = self._one_cycle(now_ns, late_ns)
            if outputs.finished or self._shutdown_overdue(now_ns):
                return
            deadline_ns += self._period_ns
            missed = (time.monotonic_ns() - deadline_ns) // self._period_ns
            if missed > 0:
                self._overruns += missed
                deadline_ns += missed * self._period_ns

    @staticmethod
    def _wait(deadline_ns: int) -> int:
        """Sleep to the absolute deadline; the time read at its end is the time of the cycle."""
        now_ns = time.monotonic_ns()
        while now_ns < deadline_ns:
            time.sleep((deadline_ns - now_ns) * 1e-9)
            now_ns = time.monotonic_ns()
        return now_ns

    def _one_cycle(self, now_ns: int, late_ns: int) -> Outputs:
        frames, bus_events = self._bus.receive(now_ns)
        if bus_events:
            self._readiness.hear(bus_events)
        commands, refusals, requests, samples = self._drain(now_ns)
        inputs = Inputs(
            cycle=self._cycle,
            now_ns=now_ns,
            frames=tuple(frames),
            commands=tuple(commands),
            refusals=tuple(refusals),
            requests=(*requests, *self._kept_stop(now_ns), *self._shutdown_request(now_ns)),
            bus_events=tuple(bus_events),
            samples=tuple(samples),
            overruns=self._overruns,
            dropped_records=self._dropped_records(),
        )
        outputs = self._engine.step(inputs)
        self._bus.send(outputs.frames, now_ns)
        self._trace = outputs.trace
        self._cycle += 1
        self._tell(outputs, now_ns)
        wall_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        done_ns = time.monotonic_ns()
        work_ns = done_ns - now_ns
        timing = CycleTiming(late_ns, work_ns, wall_ns - work_ns)
        self._record(inputs, outputs, timing)
        if not self._view_lost:
            self._try(partial(self._link.show, inputs, outputs, timing), None, self._lose_view)
        return outputs

    def _kept_stop(self, now_ns: int) -> tuple[Request, ...]:
        """The emergency stop of before the start, in the first cycle."""
        if self._cycle > 0 or self._latch.kept is None:
            return ()
        return (Request(RequestKind.ESTOP, 0, now_ns),)

    def _shutdown_request(self, now_ns: int) -> tuple[Request, ...]:
        if self._ending.by is None or self._stop_since_ns is not None:
            return ()
        logger.info("%s: coming to rest", self._ending.by)
        self._stop_since_ns = now_ns
        self._notifier.stopping()
        return (Request(RequestKind.SHUTDOWN, 0, now_ns),)

    def _shutdown_overdue(self, now_ns: int) -> bool:
        """A robot that will not come to rest must not keep the process alive for ever."""
        return self._stop_since_ns is not None and now_ns - self._stop_since_ns > self._ending_ns

    # what is told

    def _tell(self, outputs: Outputs, now_ns: int) -> None:
        stopped = outputs.mode is Mode.ESTOP
        self._latch.want(stopped=stopped)
        events, self._own_events = (*self._own_events, *outputs.events), []
        news = News(now_ns, outputs.replies, events, outputs.status)
        on_disk, problem = self._latch.on_disk, self._latch.problem
        for due in self._gate.step(news, stopped=stopped, on_disk=on_disk, problem=problem):
            self._announce(due)
        if outputs.odometry is not None:
            self._publish(now_ns, odometry=outputs.odometry)
        self._notifier.feed_watchdog(now_ns)
        if outputs.status is not None:
            nothing: Sequence[Event] = ()
            self._own_events += self._try(self._recorder.poll, nothing, self._lose_recorder)
        if self._after_cycle is not None:
            self._try(partial(self._after_cycle, now_ns, outputs), None, self._lose_link)

    def _announce(self, news: News) -> None:
        for reply in news.replies:
            self._try(partial(self._link.reply, reply), None, self._lose_link)
        for event in news.events:
            logger.log(_LOG_LEVELS[event.level], "%s: %s", event.code, event.text)
        if news.status is not None or news.events:
            self._publish(news.now_ns, status=news.status, events=news.events)
        if news.status is not None:
            self._readiness.tell(news.status, news.now_ns)

    def _publish(
        self,
        now_ns: int,
        *,
        odometry: Odometry | None = None,
        status: Status | None = None,
        events: Sequence[Event] = (),
    ) -> None:
        """Also tried once commands cannot come any more: whoever still listens should know."""
        extras = {} if status is None else self._extras()
        call = partial(
            self._link.publish, odometry=odometry, status=status, events=events, now_ns=now_ns, extras=extras
        )
        self._try(call, None, self._lose_link)

    def _extras(self) -> dict[str, object]:
        none: dict[str, object] = {}
        recording = self._try(self._recorder.health, none, self._lose_recorder)
        if self._recorder_error is not None:
            recording = recording | {"error": self._recorder_error}
        channels = none if self._trace is None else self._channels.named(self._trace)
        return {"recording": recording, "estop_latch": self._latch.health(), "channels": channels}

    # edges that may have gone

    @staticmethod
    def _try(call: Callable[[], _T], otherwise: _T, lost: Callable[[Exception], None]) -> _T:
        """What an edge answers; `otherwise` if it raises."""
        try:
            return call()
        except Exception as error:
            lost(error)
            return otherwise

    def _drain(self, now_ns: int) -> Drained:
        if self._link_lost:
            return _NOTHING
        return self._try(partial(self._link.drain, now_ns), _NOTHING, self._lose_link)

    def _lose_link(self, error: Exception) -> None:
        """Nobody can command any more, which is silence; a new process may do better."""
        if self._link_lost:
            return
        self._link_lost = True
        self._own_events.append(Event(Level.ERROR, "link_lost", f"no commands can come any more: {error}"))
        if self._ending.by is None:
            self._exit_code = EXIT_LINK_LOST
        self._ending.ask(f"link lost ({error})")

    def _lose_view(self, error: Exception) -> None:
        self._view_lost = True
        self._own_events.append(Event(Level.WARNING, "view_lost", f"nobody can look on any more: {error}"))

    def _dropped_records(self) -> int:
        return self._unrecorded + self._try(lambda: self._recorder.dropped, 0, self._lose_recorder)

    def _record(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming) -> None:
        self._try(partial(self._recorder.put, inputs, outputs, timing, self._engine.snapshot), None, self._lose_record)

    def _lose_record(self, error: Exception) -> None:
        self._unrecorded += 1
        self._lose_recorder(error)

    def _lose_recorder(self, error: Exception) -> None:
        text = f"the recorder's edge failed: {error}"
        if text != self._recorder_error:
            self._recorder_error = text
            self._own_events.append(Event(Level.WARNING, "recorder_lost", text))

    # the end of a core that is broken

    def _end_broken(self, error: Exception | None = None) -> None:
        """Stop frames, which do not need the core, until the motors report rest or the time is over; then release."""
        self._send_stop(time.monotonic_ns())
        if error is not None:
            logger.critical("bug in the core: stopping the motors", exc_info=error)
            event = Event(Level.ERROR, "core_bug", f"{type(error).__name__}: {error}")
            self._publish(time.monotonic_ns(), events=(event,))
        standing_ns: int | None = None
        for now_ns in self._periods(self._stopping_ns + REST_DWELL_NS):
            standing_ns = (standing_ns or now_ns) if self._at_rest(now_ns) else None
            if standing_ns is not None and now_ns - standing_ns >= REST_DWELL_NS:
                break
            self._send_stop(now_ns)
            self._notifier.feed_watchdog(now_ns)
        self._send(self._engine.coast_frames)

    def _periods(self, limit_ns: int) -> Iterator[int]:
        """The time of each period from now on, for so long."""
        deadline_ns = time.monotonic_ns()
        end_ns = deadline_ns + limit_ns
        while deadline_ns < end_ns:
            deadline_ns += self._period_ns
            yield self._wait(deadline_ns)

    def _at_rest(self, now_ns: int) -> bool:
        """As far as the motors can still be heard."""

        def read() -> bool:
            frames, _ = self._bus.receive(now_ns)
            return self._engine.at_rest(frames, now_ns=now_ns)

        return self._try(read, False, self._lose_bus)

    def _send_stop(self, now_ns: int) -> None:
        self._send(partial(self._engine.stop_frames, now_ns=now_ns))

    def _send(self, frames: Callable[[], Sequence[CanFrame]]) -> None:
        """Whatever becomes of it, the end goes on."""
        self._try(lambda: self._bus.send(frames(), time.monotonic_ns()), None, self._lose_bus)

    def _lose_bus(self, error: Exception) -> None:
        text = f"{type(error).__name__}: {error}"
        if text != self._bus_error:
            self._bus_error = text
            logger.error("while ending: %s", text)


def ending_ns(config: RobotConfig) -> int:
    """How long a robot may take to come to rest once its service is told to end."""
    # Twice: degraded driving has half the acceleration.
    return 2 * _stopping_ns(config) + REST_TIMEOUT_NS + SHUTDOWN_GRACE_NS


def _stopping_ns(config: RobotConfig) -> int:
    return round(1e9 * (stopping_time(**config.limits.as_stopping()) + config.limits.motors_stop()))

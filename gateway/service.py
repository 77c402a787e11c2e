"""The live loop: one thread that owns the core. Drain, step, send, publish, record; absolute deadlines.

How this works
--------------
Everything outside the core is an edge given to the constructor. The loop never waits for one of them: buses drop,
the link hands over to its own threads, the recorder is another process. A bug in the core ends in one handler, here:
stop frames, flush, exit code 70; the motors' own watchdogs guard what is left.
"""

import gc
import logging
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from types import FrameType
from typing import Protocol

from gateway.can_bus import BusEdge
from gateway.config import RobotConfig
from gateway.engine import Engine
from gateway.systemd import Notifier, Readiness
from gateway.types import (
    CycleTiming,
    Event,
    Inputs,
    Level,
    Odometry,
    Outputs,
    Refusal,
    Reply,
    Request,
    RequestKind,
    Status,
    TwistCommand,
)

logger = logging.getLogger(__name__)

EXIT_CORE_BUG = 70  # EX_SOFTWARE of sysexits.h
SHUTDOWN_LIMIT_NS = 8_000_000_000  # a robot that will not come to rest must not keep the process alive for ever
_LOG_LEVELS = {Level.INFO: logging.INFO, Level.WARNING: logging.WARNING, Level.ERROR: logging.ERROR}


class Link(Protocol):
    """What the loop needs of the commanding side (Zenoh)."""

    def drain(self, now_ns: int) -> tuple[Sequence[TwistCommand], Sequence[Refusal], Sequence[Request]]: ...

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


class RecorderEdge(Protocol):
    """What the loop needs of the recorder."""

    @property
    def dropped(self) -> int: ...

    def put(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming) -> None: ...

    def poll(self) -> None: ...

    def health(self) -> dict[str, object]: ...


class Service:
    """Runs one robot until a signal, a finished shutdown or a bug. `after_cycle` is called last in every cycle."""

    def __init__(
        self,
        config: RobotConfig,
        *,
        bus: BusEdge,
        link: Link,
        recorder: RecorderEdge,
        notifier: Notifier,
        after_cycle: Callable[[int, Outputs], None] | None = None,
    ) -> None:
        self._engine = Engine(config)
        self._bus = bus
        self._link = link
        self._recorder = recorder
        self._notifier = notifier
        self._after_cycle = after_cycle
        self._period_ns = round(1e9 / config.loop.rate)
        self._cycle = 0
        self._overruns = 0
        self._stop_since_ns: int | None = None
        self._stop_requested = False
        self._readiness = Readiness(notifier, time.monotonic_ns())

    def stop(self) -> None:
        """Ask for an orderly end: ramp to rest, release, return from `run`. Safe in a signal handler."""
        self._stop_requested = True

    def run(self) -> int:
        """The loop; returns the exit code."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._on_signal)
        gc.collect()
        gc.freeze()
        try:
            self._loop()
        except Exception:
            logger.exception("bug in the core: stopping the motors")
            self._emergency_stop()
            return EXIT_CORE_BUG
        self._bus.send(self._engine.coast_frames(), time.monotonic_ns())
        return 0

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        logger.info("signal %d: coming to rest", number)
        self.stop()

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
        commands, refusals, requests = self._link.drain(now_ns)
        inputs = Inputs(
            cycle=self._cycle,
            now_ns=now_ns,
            frames=tuple(frames),
            commands=tuple(commands),
            refusals=tuple(refusals),
            requests=(*requests, *self._shutdown_request(now_ns)),
            bus_events=tuple(bus_events),
            overruns=self._overruns,
            dropped_records=self._recorder.dropped,
        )
        outputs = self._engine.step(inputs)
        self._bus.send(outputs.frames, now_ns)
        self._cycle += 1
        self._tell(outputs, now_ns)
        wall_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        done_ns = time.monotonic_ns()
        work_ns = done_ns - now_ns
        self._recorder.put(inputs, outputs, CycleTiming(late_ns, work_ns, wall_ns - work_ns))
        return outputs

    def _shutdown_request(self, now_ns: int) -> tuple[Request, ...]:
        if not self._stop_requested or self._stop_since_ns is not None:
            return ()
        self._stop_since_ns = now_ns
        self._notifier.stopping()
        return (Request(RequestKind.SHUTDOWN, 0, now_ns),)

    def _shutdown_overdue(self, now_ns: int) -> bool:
        return self._stop_since_ns is not None and now_ns - self._stop_since_ns > SHUTDOWN_LIMIT_NS

    def _tell(self, outputs: Outputs, now_ns: int) -> None:
        for reply in outputs.replies:
            self._link.reply(reply)
        for event in outputs.events:
            logger.log(_LOG_LEVELS[event.level], "%s: %s", event.code, event.text)
        if outputs.odometry is not None or outputs.status is not None or outputs.events:
            extras: dict[str, object] = {} if outputs.status is None else {"recording": self._recorder.health()}
            self._link.publish(
                odometry=outputs.odometry,
                status=outputs.status,
                events=outputs.events,
                now_ns=now_ns,
                extras=extras,
            )
        self._notifier.feed_watchdog(now_ns)
        if outputs.status is not None:
            self._recorder.poll()
            self._readiness.tell(outputs.status, now_ns)
        if self._after_cycle is not None:
            self._after_cycle(now_ns, outputs)

    def _emergency_stop(self) -> None:
        """The core cannot be trusted any more, its constant stop frames can."""
        now_ns = time.monotonic_ns()
        self._bus.send(self._engine.stop_frames(now_ns=now_ns), now_ns)
        self._bus.send(self._engine.coast_frames(), time.monotonic_ns())

"""An adapter that may hold whoever calls it, behind a thread of its own: the loop hands over and never waits.

How this works
--------------
Opening a serial adapter waits for its answers, writing to it has no time limit in python-can, and closing it flushes.
All three are done by one thread per bus, which exists before the drive begins. Frames go through a short queue in whole
cycles; a cycle that finds it full is refused, and frames that waited too long are dropped by the thread, so that no old
setpoint drives the robot once a write goes on. A call that never returns leaves the thread behind: nothing is opened
again before it has returned, and the process ends without it. Receiving stays with the loop: it does not wait.
"""

import errno
import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from threading import Condition, Thread

from gateway.edges.can_adapter import AdapterError, ask
from gateway.edges.python_can import can

MOST_WAITING = 10  # frames, from which no further cycle is taken; about as many as fit into a SocketCAN send buffer
MAX_AGE_NS = 50_000_000  # of a frame that waits; shorter than any command timeout and motor watchdog
WRITE_S = 0.1  # for one frame, where the adapter keeps to it; without a time slcan cuts frames off
END_S = 0.5  # how long the end of the process waits for the last frames, and for the adapter to close


class AdapterThread:
    """One bus at a time. Every method is called by the loop, and returns at once; but `finish`."""

    def __init__(self, name: str) -> None:
        self._changed = Condition()
        self._opener: Callable[[], can.BusABC] | None = None  # waits to be called
        self._fresh: can.BusABC | None = None  # opened, and not taken over yet
        self._bus: can.BusABC | None = None
        self._closing = self._ended = False
        self._waiting: deque[tuple[int, can.Message]] = deque()  # with the time since when
        self._failure: AdapterError | None = None
        self._written = False
        self._busy = False
        Thread(target=self._run, name=f"can {name}", daemon=True).start()

    @property
    def free(self) -> bool:
        """Nothing is open, and no call is under way."""
        with self._changed:
            return self._bus is None and self._opener is None and not self._busy

    @property
    def works(self) -> bool:
        """Frames of this bus were written, and the last ones without failure."""
        with self._changed:
            return self._written and self._failure is None

    def open(self, opener: Callable[[], can.BusABC]) -> None:
        """Begin to open; `opened` tells what becomes of it. Only when `free`."""
        with self._changed:
            self._opener, self._failure, self._written = opener, None, False
            self._changed.notify_all()

    def opened(self) -> can.BusABC | None:
        """The bus, once, as soon as it is open. Raises AdapterError, once, if it could not be opened."""
        with self._changed:
            if self._bus is None and self._failure is not None:
                failure, self._failure = self._failure, None
                raise failure
            fresh, self._fresh = self._fresh, None
            return fresh

    def send(self, messages: Sequence[can.Message]) -> None:
        """Hand over a cycle. Raises AdapterError if none is taken: what failed since the last one, or a full queue."""
        now_ns = time.monotonic_ns()
        with self._changed:
            if self._failure is not None:
                failure, self._failure = self._failure, None
                raise failure
            if len(self._waiting) >= MOST_WAITING:
                raise AdapterError(_full("a write does not return"))
            self._waiting.extend((now_ns, message) for message in messages)
            self._changed.notify_all()

    def close(self) -> None:
        """Close the bus as soon as the present call returns; what still waits is dropped."""
        with self._changed:
            self._waiting.clear()
            self._opener = self._fresh = self._failure = None
            self._closing = True
            self._changed.notify_all()

    def settle(self, timeout: float) -> bool:
        """Wait until nothing is left to do; False: it was not done in time."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._busy and not self._has_work(), timeout)

    def finish(self) -> None:
        """Write what waits and close, in bounded time; nothing is done afterwards."""
        self.settle(END_S)
        self.close()
        self.settle(END_S)
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    # the thread

    def _has_work(self) -> bool:
        return self._closing or self._opener is not None or bool(self._waiting)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._ended or self._has_work())
                if self._ended:
                    return
                self._busy = True
                closing, self._closing = self._closing, False
                bus, opener, item = self._bus, self._opener, None
                if not closing and opener is None and self._waiting:
                    item = self._waiting.popleft()
                if not closing:
                    self._opener = None
            if closing:
                self._shut(bus)
            elif opener is not None:
                self._try_to_open(opener)
            elif item is not None and bus is not None:
                self._write(bus, *item)

    def _shut(self, bus: can.BusABC | None) -> None:
        try:
            if bus is not None:
                ask(bus.shutdown)
        except AdapterError:
            pass  # it is given up anyway
        finally:
            with self._changed:
                self._bus = None

    def _try_to_open(self, opener: Callable[[], can.BusABC]) -> None:
        try:
            bus = ask(opener)
        except AdapterError as error:
            with self._changed:
                self._failure = error
            return
        with self._changed:
            self._bus = bus
            self._fresh = None if self._closing else bus

    def _write(self, bus: can.BusABC, since_ns: int, message: can.Message) -> None:
        if time.monotonic_ns() - since_ns > MAX_AGE_NS:
            self._fail(AdapterError(_full("frames waited too long")))
            return
        try:
            ask(bus.send, message, timeout=WRITE_S)
        except AdapterError as error:
            self._fail(error)
            return
        with self._changed:
            self._written = True

    def _fail(self, error: AdapterError) -> None:
        """The first failure is told; the rest of what waits is as old."""
        with self._changed:
            self._waiting.clear()
            if not self._closing:
                self._failure = self._failure or error


def _full(why: str) -> OSError:
    return OSError(errno.ENOBUFS, f"{os.strerror(errno.ENOBUFS)}: {why}")

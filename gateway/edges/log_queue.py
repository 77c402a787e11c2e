"""Log lines on their way out: whoever has something to say never waits for whoever reads it.

How this works
--------------
A terminal stopped with Ctrl-S, or a full pipe, holds its writer for ever. So only a thread made for it writes to the
standard error of the process. Records of `logging` go into a bounded queue, are dropped and counted when it is full,
and are put into words by that thread: a traceback reads source files. Descriptors 1 and 2 become a pipe of our own,
which a second thread empties into the same queue; Zenoh's threads, the recorder process, warnings and the interpreter
itself write there. Both threads are left behind at the end of the process if they do not finish in time.
"""

import atexit
import contextlib
import copy
import faulthandler
import logging
import os
import select
from collections import deque
from threading import Condition, Thread

LIMIT = 1000  # lines waiting
LONGEST = 16_384  # bytes of a captured line; a longer one is cut in pieces
FLUSH_S = 1.0  # how long the end of the process waits for each of the two threads
_CHUNK = 65_536

Line = str | logging.LogRecord


class LogQueue:
    """Bounded, from any thread to the writer. Once it was full, lines are dropped until half of it has gone."""

    def __init__(self, limit: int = LIMIT) -> None:
        self._limit = limit
        self._lines: deque[Line] = deque()
        self._dropped = 0
        self._closed = False
        self._changed = Condition()

    def put(self, line: Line) -> None:
        """Never waits."""
        with self._changed:
            if self._dropped or len(self._lines) >= self._limit:
                self._dropped += 1
                return
            self._lines.append(line)
            self._changed.notify()

    def take(self) -> Line | None:
        """Waits for the next line; None after `close`, once nothing is left."""
        with self._changed:
            while not self._lines and not self._closed:
                self._changed.wait()
            if not self._lines:
                return None
            line = self._lines.popleft()
            if self._dropped and len(self._lines) <= self._limit // 2:
                self._lines.append(f"{self._dropped} log lines were dropped")
                self._dropped = 0
            return line

    def close(self) -> None:
        """Nothing more will be put."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


class LogOutput:
    """Owns the way out: `handler` for the logging module, descriptors 1 and 2 after `capture`."""

    def __init__(self, descriptor: int, *, layout: str, limit: int = LIMIT) -> None:
        self._queue = LogQueue(limit)
        self._descriptor = descriptor
        self._formatter = logging.Formatter(layout)
        self._pipe, self._entry = os.pipe()
        self._end, self._ending = os.pipe()
        self._rest = b""
        self.handler: logging.Handler = _QueueHandler(self._queue)
        self._reader = Thread(target=self._read, name="log reader", daemon=True)
        self._writer = Thread(target=self._write, name="log writer", daemon=True)
        self._reader.start()
        self._writer.start()

    def capture(self, *descriptors: int) -> None:
        """What is written to these goes through the queue from now on."""
        for descriptor in descriptors:
            os.dup2(self._entry, descriptor)  # inheritable: children write here too

    def close(self, timeout: float = FLUSH_S) -> bool:
        """Write what waits, in bounded time; whether everything is out. What comes later is lost, and blocks nobody."""
        os.close(self._ending)
        self._reader.join(timeout)
        self._queue.close()
        self._writer.join(timeout)
        return not self._writer.is_alive()

    def _read(self) -> None:
        while True:
            ready, _, _ = select.select([self._pipe, self._end], [], [])
            if self._pipe not in ready:
                break
            *lines, self._rest = (self._rest + os.read(self._pipe, _CHUNK)).split(b"\n")
            if len(self._rest) > LONGEST:
                lines, self._rest = [*lines, self._rest], b""
            for line in lines:
                self._queue.put(line.decode(errors="replace"))
        if self._rest:
            self._queue.put(self._rest.decode(errors="replace"))

    def _write(self) -> None:
        while (line := self._queue.take()) is not None:
            text = line if isinstance(line, str) else self._formatter.format(line)
            _write_all(self._descriptor, f"{text}\n".encode(errors="replace"))


class _QueueHandler(logging.Handler):
    def __init__(self, queue: LogQueue) -> None:
        super().__init__()
        self._queue = queue

    def emit(self, record: logging.LogRecord) -> None:
        try:
            said = copy.copy(record)
            said.msg, said.args = record.getMessage(), None
        except (TypeError, ValueError, KeyError):
            self.handleError(record)
            return
        self._queue.put(said)


def take_over(*, level: int, layout: str) -> LogOutput:
    """From here on nothing in this process but one thread writes to its standard output and error."""
    try:
        descriptor = os.dup(2)
    except OSError:  # started without one
        descriptor = os.open(os.devnull, os.O_WRONLY)
    output = LogOutput(descriptor, layout=layout)
    output.capture(1, 2)
    if faulthandler.is_enabled():
        faulthandler.enable(descriptor)  # the stacks of a hung process, when no thread of it runs any more
    logging.basicConfig(level=level, handlers=[output.handler])
    atexit.register(output.close)
    return output


def _write_all(descriptor: int, data: bytes) -> None:
    with contextlib.suppress(OSError):  # a reader that has gone must not end the thread
        while data:
            try:
                data = data[os.write(descriptor, data) :]
            except BlockingIOError:
                select.select([], [descriptor], [])

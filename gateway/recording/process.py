"""The recorder's own process: reads packets from the service, writes batches to the session, reports back.

How this works
--------------
The service keeps one end of a socket pair and gives the other to this process. It sleeps a little and takes what has
come, so that a sending service never has to wake anybody. End of file (the service closed, or died in any way) means:
write what is left, close the footer, go; the session counts as ended only if the service said so before. The signals
that end the service are blocked here from birth. Killed itself, it loses what has come since the last batch.
Everything also passes by what keeps incidents (`gateway.recording.incidents`), for which alone this process is there
where no sessions are to be recorded; then it does without Rerun.
"""

import contextlib
import logging
import os
import signal
import socket
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, NoReturn, Protocol

from gateway.config import RobotConfig
from gateway.edges.hidden import hide
from gateway.recording.failures import RecordingOffError, WriterDeadError
from gateway.recording.incidents import Keeper, keeper
from gateway.recording.packets import (
    PACKET_LIMIT,
    End,
    Gap,
    Hello,
    Packet,
    Record,
    RecorderReport,
    Snapshot,
    decode_hello,
    decode_packet,
    encode,
)

logger = logging.getLogger(__name__)

FLUSH_NS = 400_000_000  # of the first record of a batch waiting: with what it takes to write it, below 0.5 s
BURST_NS = 100_000_000  # of cycles that come at once have waited for a recorder: they are not to wait again
BATCH_RECORDS = 1000  # at most
DRAIN_PERIOD_S = 0.02
EXIT_REFUSED = 78  # EX_CONFIG of sysexits.h
EXIT_WRITER_DEAD = 75  # EX_TEMPFAIL of sysexits.h
WRITE_LIMIT_S = 10  # for one batch, segment or end; a flush gives up after 3 s


class Writer(Protocol):
    """What is recorded to, batch by batch (`gateway.recording.writer`)."""

    def open(self) -> None: ...

    def write(self, records: Sequence[Record], gaps: Sequence[Gap] = (), snapshot: Snapshot | None = None) -> None: ...

    def close(self, *, ended: bool = True) -> None: ...

    def report(self) -> RecorderReport: ...


class Unrecorded:
    """Stands in where no session is to be recorded."""

    def __init__(self) -> None:
        self._report = RecorderReport("", 0, 0, None, 0, None, closed=False)

    def open(self) -> None:
        """There is nothing to open."""

    def write(self, records: Sequence[Record], gaps: Sequence[Gap] = (), snapshot: Snapshot | None = None) -> None:
        """Count it as dealt with."""
        if records:
            count, last = self._report.records + len(records), records[-1].inputs.cycle
            self._report = self._report._replace(records=count, settled_cycle=last)

    def close(self, *, ended: bool = True) -> None:
        """Nothing is left."""
        self._report = self._report._replace(closed=True)

    def report(self) -> RecorderReport:
        """That there is no session."""
        return self._report


class Taken(NamedTuple):
    """A packet, and as it came."""

    packet: Packet
    raw: bytes


class Inbox:
    """The recorder's end of the pair."""

    def __init__(self, descriptor: int) -> None:
        self._socket = socket.socket(fileno=descriptor)
        self._buffer = bytearray(PACKET_LIMIT)
        self._view = memoryview(self._buffer)
        self.ended = False

    def hello(self) -> Hello | None:
        """The first packet; None if the service is gone already."""
        length = self._socket.recv_into(self._buffer)
        return decode_hello(self._view[:length]) if length else None

    def take(self, limit: int) -> list[Taken]:
        """What has come so far, without waiting."""
        packets: list[Taken] = []
        while len(packets) < limit:
            try:
                length = self._socket.recv_into(self._buffer, 0, socket.MSG_DONTWAIT)
            except BlockingIOError:
                break
            except ConnectionResetError:  # told once, if the service died with reports unread; its packets still come
                continue
            if not length:
                self.ended = True
                break
            raw = bytes(self._view[:length])
            packets.append(Taken(decode_packet(raw), raw))
        return packets

    def send(self, report: RecorderReport) -> None:
        """Tell the service if it is there to listen; it needs only the newest report."""
        try:
            self._socket.send(encode(report), socket.MSG_DONTWAIT)
        except OSError:
            return


def record(inbox: Inbox, writer: Writer, incidents: Keeper) -> None:
    """Until end of file. Raises WriterDeadError, RecordingOffError."""
    with _within_limit():
        writer.open()
    _tell(inbox, writer, incidents)
    records: list[Record] = []
    gaps: list[Gap] = []
    snapshot: Snapshot | None = None
    due_ns = 0
    ended = False
    while not inbox.ended:
        before = len(records)
        for packet, raw in inbox.take(BATCH_RECORDS - len(records)):
            incidents.take(packet, raw)
            if isinstance(packet, End):
                ended = True
                continue
            if isinstance(packet, Gap):
                gaps.append(packet)
                continue
            if isinstance(packet, Snapshot):  # a batch begins behind it, and so can a segment
                if records:
                    with _within_limit():
                        writer.write(records, gaps, snapshot)
                    records, gaps, before = [], [], 0
                snapshot = packet
                continue
            if not records:
                due_ns = time.monotonic_ns() + FLUSH_NS
            records.append(packet)
        at_once = len(records) >= BATCH_RECORDS or _span_ns(records[before:]) >= BURST_NS
        if records and (at_once or inbox.ended or time.monotonic_ns() >= due_ns):
            with _within_limit():
                writer.write(records, gaps, snapshot)
            _tell(inbox, writer, incidents)
            records, gaps, snapshot = [], [], None
        if incidents.poll():
            _tell(inbox, writer, incidents)
        if not at_once and not inbox.ended:
            time.sleep(DRAIN_PERIOD_S)
    with _within_limit():
        if gaps:
            writer.write((), gaps)
        writer.close(ended=ended)
    incidents.close()
    _tell(inbox, writer, incidents)


def _tell(inbox: Inbox, writer: Writer, incidents: Keeper) -> None:
    inbox.send(writer.report()._replace(incidents=incidents.report()))


def _span_ns(records: Sequence[Record]) -> int:
    return records[-1].inputs.now_ns - records[0].inputs.now_ns if records else 0


def main(descriptor: int) -> int:
    """Exit code: 0 when the session is complete."""
    logging.basicConfig(level=logging.INFO, format="recorder: %(message)s")
    _step_back()
    inbox = Inbox(descriptor)
    hello = inbox.hello()
    if hello is None:
        return 0
    config = RobotConfig.model_validate_json(hello.config_json)
    try:
        writer = _writer(config, hello)
    except OSError as error:
        where = "" if hello.folder is not None else f"recording.directory = {config.recording.directory!r}: "
        return _refuse(inbox, f"{where}{_words(error)}; give another directory, or recording.enabled = false")
    incidents = keeper(config, hello, Path(writer.report().folder).name or None)
    try:
        record(inbox, writer, incidents)
    except RecordingOffError as error:
        return _refuse(inbox, str(error))
    except WriterDeadError as error:
        incidents.close()
        told = writer.report()._replace(error=f"the writing thread ended: {error}", incidents=incidents.report())
        inbox.send(told)
        logger.warning("the writing thread ended: %s", error)
        _leave(EXIT_WRITER_DEAD)  # at once: to return would drop the stream, and Rerun may wait for its thread then
    return 0


def _writer(config: RobotConfig, hello: Hello) -> Writer:
    """Raises OSError when the folder of a session cannot be made."""
    if not config.recording.enabled:
        return Unrecorded()
    # Arrow looks for pandas at its first array and loads it where it is there: half as long again until it records.
    hide("pandas")
    from gateway.recording.writer import SessionWriter  # noqa: PLC0415  # with Rerun, 75 MB

    return SessionWriter(config, hello)


def _words(error: OSError) -> str:
    """What the system says, and of which file, without its number."""
    named = "" if error.filename is None else f" ({error.filename})"
    return f"{error.strerror or error}{named}"


def _refuse(inbox: Inbox, text: str) -> int:
    inbox.send(RecorderReport(folder="", segment=0, records=0, settled_cycle=None, lost=0, error=text, closed=True))
    logger.warning("%s", text)
    return EXIT_REFUSED


@contextlib.contextmanager
def _within_limit() -> Iterator[None]:
    """The kernel ends this process with SIGALRM if what is inside takes too long; the service then starts another.

    On a full disk a call of Rerun may block for ever (seen with 0.41), perhaps holding the interpreter: nothing written
    in Python could be relied on to notice.
    """
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
    signal.alarm(WRITE_LIMIT_S)
    yield
    # Not after an error: the process is to end then, and must not be held up on the way.
    signal.alarm(0)
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})


def _step_back() -> None:
    """Ordinary, patient scheduling, whatever the service runs under: a disk can wait, motors cannot."""
    with contextlib.suppress(OSError):  # a sandbox may forbid it
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def _leave(code: int) -> NoReturn:
    """Not sys.exit: after a dead writing thread the interpreter's orderly end waits for it, for ever."""
    logging.shutdown()
    os._exit(code)


if __name__ == "__main__":
    _leave(main(int(sys.argv[1])))

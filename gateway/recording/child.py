"""One recorder process as its parent holds it: the process, our end of the socket pair, what went in and came back."""

import contextlib
import errno
import os
import select
import socket
import time

from gateway.build import ROOT
from gateway.edges.signals import ENDING
from gateway.recording.packets import PACKET_LIMIT, Hello, RecorderReport, decode_report, encode
from gateway.recording.spawner import Spawner

SOCKET_BYTES = 1 << 20  # asked for; the kernel caps it at net.core.wmem_max
REPORT_BYTES = 65536
PROGRAM = ("-m", "gateway.recording.process")


class TooLongError(ValueError):
    """A packet that no socket buffer takes."""

    def __init__(self, length: int) -> None:
        super().__init__(f"{length} bytes are too long for one packet")


class RecorderChild:
    """Started on construction. Raises OSError."""

    def __init__(self, hello: Hello, spawner: Spawner) -> None:
        self.report: RecorderReport | None = None
        self.sent = 0  # cycles handed over
        self.first_cycle: int | None = None
        self.last_cycle: int | None = None
        self.ended = False  # its end of the pair is closed
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BYTES)
        try:
            with theirs:
                self._process = spawner.start(PROGRAM, theirs.fileno())
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self._socket.send(encode(hello))

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def running(self) -> bool:
        """Whether the process lives; one of which nobody tells any more does until it closes its end."""
        return self._process.running() or (self._process.lost and not self.ended)

    def send(self, cycle: int | None, packet: bytes) -> bool:
        """Hand over a packet (cycle None: not a cycle); False if there is no room now. Raises TooLongError."""
        if len(packet) > PACKET_LIMIT:
            raise TooLongError(len(packet))
        try:
            self._socket.send(packet)
        except BlockingIOError:
            return False
        except OSError as error:
            if error.errno == errno.EMSGSIZE:
                raise TooLongError(len(packet)) from None
            return False  # it has died; `running` will say so
        if cycle is not None:
            self.sent += 1
            self.last_cycle = cycle
            if self.first_cycle is None:
                self.first_cycle = cycle
        return True

    def receive(self) -> None:
        """Take in the reports that have come; the newest one counts."""
        while not self.ended:
            try:
                packet = self._socket.recv(REPORT_BYTES)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            if packet:
                self.report = decode_report(packet)
            else:
                self.ended = True

    def wait_writable(self, timeout: float) -> bool:
        """Wait for room; False when the time is up or the process has gone."""
        return self._wait(select.POLLOUT, timeout)

    def wait_readable(self, timeout: float) -> bool:
        """Wait for a report; False when the time is up. The end of the process also counts as readable."""
        return self._wait(select.POLLIN, timeout)

    def finish(self, deadline: float) -> None:
        """Send end of file and take in reports until the process closes its end or time.monotonic() passes."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
        while not self.ended and self.wait_readable(deadline - time.monotonic()):
            self.receive()

    def exit_code(self, deadline: float) -> int | None:
        """Exit code, waited for until time.monotonic() passes; None if it still runs. Closes our end."""
        self._socket.close()
        self._process.ended(deadline - time.monotonic())
        self._process.close()
        return self._process.exit_code

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()
        self._socket.close()

    def _wait(self, event: int, timeout: float) -> bool:
        poll = select.poll()
        poll.register(self._socket, event)
        ready = poll.poll(max(timeout, 0.0) * 1000.0)
        for _, happened in ready:
            if happened & select.POLLHUP:
                return event == select.POLLIN
            return bool(happened & event)
        return False


def recorder_spawner() -> Spawner:
    """What starts recorders: fresh interpreters (never forks: Rerun does not survive it) that outlive the service.

    Raises OSError.
    """
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    return Spawner(blocked=tuple(ENDING), environment=os.environ | {"PYTHONPATH": os.pathsep.join(paths)})

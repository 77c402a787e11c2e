"""Starts recorder processes for a service that must not do so itself while it drives.

How this works
--------------
To start a program a process stops until the new one is loaded, holding the interpreter lock, and so every thread of a
service with it: on a busy computer longer than its watchdog waits. So the service starts this small process once, at
its own beginning, and asks it for every recorder. A request is the program's arguments with two descriptors: the
recorder's end of its socket pair, and one end of another pair on which the recorder's process id comes back and, when
it has ended, its exit code. Both ends closed means that the service is gone: so does this process, recorders live on.

It knows nothing of robots, so that it stays small.
"""

import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

REQUEST_BYTES: Final = 4096
CLOSE_TIMEOUT_S: Final = 1.0
DESCRIPTORS: Final = 2
STARTED: Final = "started"
REFUSED: Final = "refused"
ENDED: Final = "ended"
_SEPARATOR: Final = "\0"  # no argument of a program has one in it
_Child = tuple[subprocess.Popen[bytes], socket.socket]  # and on what its exit code is told


class Spawner:
    """The service's side: a process that starts programs. Started on construction. Raises OSError.

    `blocked`: signals that neither it nor what it starts shall get; `environment`: of both.
    """

    def __init__(self, *, blocked: Sequence[int], environment: dict[str, str]) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            # A blocked signal stays blocked across exec: ^C in a terminal and systemd's SIGTERM reach the whole group.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, blocked)
            try:
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-m", __name__, str(theirs.fileno())],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    env=environment,
                    pass_fds=(theirs.fileno(),),
                )
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def start(self, arguments: Sequence[str], descriptor: int) -> "Spawned":
        """A fresh interpreter with these arguments and the descriptor's number as the last; waits until it is there.

        Raises OSError.
        """
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            try:
                socket.send_fds(self._socket, [_SEPARATOR.join(arguments).encode()], [descriptor, theirs.fileno()])
            except OSError as error:
                ours.close()
                message = f"the process that starts it is gone ({error.strerror})"
                raise OSError(error.errno, message) from error
        return Spawned(ours)

    def close(self) -> None:
        """End it; what it started lives on."""
        self._socket.close()
        with suppress(subprocess.TimeoutExpired):  # it may be stopped; it ends when it goes on
            self._process.wait(CLOSE_TIMEOUT_S)


class Spawned:
    """A process that was asked for, as long as it is told of. Raises OSError if it was not started."""

    def __init__(self, told: socket.socket) -> None:
        self._told = told
        self.exit_code: int | None = None
        self.lost = False  # nobody tells of it any more
        word, number = self._hear()
        if word != STARTED:
            told.close()
            raise OSError(number, os.strerror(number) if word == REFUSED else "the process that starts it is gone")
        self.pid = number

    def running(self) -> bool:
        """Whether it lives, as far as it is known."""
        return not self.ended(0.0) and not self.lost

    def ended(self, timeout: float) -> bool:
        """Whether it has ended, waited for so many seconds; then `exit_code` is known."""
        if self.exit_code is None and not self.lost:
            poll = select.poll()
            poll.register(self._told, select.POLLIN)
            if poll.poll(max(timeout, 0.0) * 1000.0):
                word, number = self._hear()
                self.lost = word != ENDED
                self.exit_code = None if self.lost else number
                self._told.close()
        return self.exit_code is not None

    def kill(self) -> None:
        """End it at once, and hear no more of it."""
        if self.running():
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
        self.close()

    def close(self) -> None:
        """Hear no more of it."""
        self._told.close()

    def _hear(self) -> tuple[str, int]:
        try:
            word, _, number = self._told.recv(REQUEST_BYTES).decode().partition(" ")
        except OSError:
            return "", 0
        return word, int(number or "0")


def main(descriptor: int) -> None:
    """Start what is asked for and tell of it, until the service closes its end."""
    control = socket.socket(fileno=descriptor)
    children: dict[int, _Child] = {}  # by a descriptor that tells of their end
    poll = select.poll()
    poll.register(control, select.POLLIN)
    while True:
        for ready, _ in poll.poll():
            if ready in children:
                poll.unregister(ready)
                _bury(ready, *children.pop(ready))
                continue
            request, descriptors, _, _ = socket.recv_fds(control, REQUEST_BYTES, DESCRIPTORS)
            if not request:
                return
            given, telling = descriptors[0], socket.socket(fileno=descriptors[1])
            process = _start(request.decode().split(_SEPARATOR), given, telling)
            if process is not None:
                end = os.pidfd_open(process.pid)
                children[end] = process, telling
                poll.register(end, select.POLLIN)
            os.close(given)


def _start(arguments: Sequence[str], given: int, telling: socket.socket) -> subprocess.Popen[bytes] | None:
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", *arguments, str(given)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=(given,),
        )
    except OSError as error:
        _tell(telling, REFUSED, error.errno or 0)
        telling.close()
        return None
    _tell(telling, STARTED, process.pid)
    return process


def _bury(end: int, process: subprocess.Popen[bytes], telling: socket.socket) -> None:
    os.close(end)
    _tell(telling, ENDED, process.wait())
    telling.close()


def _tell(telling: socket.socket, word: str, number: int) -> None:
    with suppress(OSError):  # the service does not want to know, or is gone
        telling.send(f"{word} {number}".encode())


if __name__ == "__main__":
    main(int(sys.argv[1]))

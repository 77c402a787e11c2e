"""What a signal does to the service. Every signal of the system is in exactly one of the three tables.

How this works
--------------
Whatever would end or freeze the process, and can be caught, ends it as SIGTERM does: the robot ramps to rest, the
motors are released, the recording is closed, exit code 0. A handler only leaves a note, which the loop reads in its
next cycle; a second signal changes nothing. So it is during start-up too: the first cycle then ends the service before
anything was driven.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_REAL_TIME = range(signal.SIGRTMIN, signal.SIGRTMAX + 1)

ENDING: dict[int, str] = {
    signal.SIGTERM: "asked by the service manager or a person",
    signal.SIGINT: "Ctrl-C",
    signal.SIGHUP: "the terminal or the connection has gone; under nohup it stays ignored",
    signal.SIGQUIT: "Ctrl-backslash",
    signal.SIGTSTP: "Ctrl-Z: a stopped loop would leave the motors their last command",
    signal.SIGPWR: "the power fails",
    signal.SIGXCPU: "a limit on computing time is reached; the next signal would kill",
    signal.SIGUSR1: "means nothing here, and would kill",
    signal.SIGUSR2: "likewise",
    signal.SIGALRM: "likewise",
    signal.SIGVTALRM: "likewise",
    signal.SIGPROF: "likewise",
    signal.SIGIO: "likewise",
    signal.SIGSTKFLT: "likewise",
    **dict.fromkeys(_REAL_TIME, "likewise"),
}
IGNORED: dict[int, str] = {
    signal.SIGPIPE: "a reader has gone: writing fails, which is handled where it is written",
    signal.SIGXFSZ: "likewise, a file has become too long",
    signal.SIGTTIN: "a process in the background would be stopped for reading its terminal",
    signal.SIGTTOU: "likewise for writing to it",
}
LEFT: dict[int, str] = {
    signal.SIGKILL: "cannot be caught; the motors' own watchdogs stop them",
    signal.SIGSTOP: "likewise",
    signal.SIGABRT: "the service manager's watchdog ends a loop that hangs, and wants its stacks",
    signal.SIGSEGV: "the process itself is broken and can promise nothing any more",
    signal.SIGBUS: "likewise",
    signal.SIGFPE: "likewise",
    signal.SIGILL: "likewise",
    signal.SIGSYS: "likewise",
    signal.SIGTRAP: "a debugger's",
    signal.SIGCHLD: "harmless by default",
    signal.SIGCONT: "harmless by default",
    signal.SIGURG: "harmless by default",
    signal.SIGWINCH: "harmless by default",
}


class EndRequest:
    """Whether the process was asked to end, and by whom (`by`; None: go on)."""

    def __init__(self) -> None:
        self.by: str | None = None

    def listen(self) -> None:
        """Make every ending signal such a request. Called once, before anything is opened or started."""
        for number in ENDING:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._on_signal)
        for number in IGNORED:
            signal.signal(number, signal.SIG_IGN)

    @contextmanager
    def heeded(self) -> Iterator[None]:
        """Listen for a while; then signals do again what they did before."""
        before = {number: signal.getsignal(number) for number in (*ENDING, *IGNORED)}
        self.listen()
        try:
            yield
        finally:
            for number, handler in before.items():
                if handler is not None:  # else it was no handler of Python's, and cannot be put back
                    signal.signal(number, handler)

    def ask(self, by: str) -> None:
        """The first request counts."""
        self.by = self.by or by

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        # No logging here: the handler may have interrupted it.
        self.ask(f"signal {number}")

"""Descriptors to write to that hold up their writer for ever."""

import os
import pty
import termios
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress

Unread = Callable[[], AbstractContextManager[int]]


@contextmanager
def stopped_terminal() -> Iterator[int]:
    """A terminal at which somebody pressed Ctrl-S."""
    keyboard, terminal = pty.openpty()
    termios.tcflow(terminal, termios.TCOOFF)
    try:
        yield terminal
    finally:
        os.close(keyboard)
        os.close(terminal)


@contextmanager
def full_pipe() -> Iterator[int]:
    """A pipe that nobody reads and that takes nothing more."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    for size in (4096, 1):
        with suppress(BlockingIOError):
            while True:
                os.write(writing, b"x" * size)
    os.set_blocking(writing, True)
    try:
        yield writing
    finally:
        os.close(reading)
        os.close(writing)


UNREAD: tuple[Unread, ...] = (stopped_terminal, full_pipe)

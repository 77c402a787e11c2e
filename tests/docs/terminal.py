"""A terminal, and a person who types on it: what is shown is kept as it was."""

import fcntl
import os
import pty
import re
import select
import struct
import termios
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

SIZE: Final = (50, 160)  # lines, columns
LONGEST_S: Final = 120.0
PROMPT: Final = r"(?:^|\n)\$ $"
_CONTROL: Final = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")


class TerminalError(Exception):
    """What was waited for, and what was shown instead."""


class Terminal:
    """A shell on a terminal of its own, in this folder; `within`: a command that runs it."""

    def __init__(self, folder: Path, environment: Mapping[str, str], within: Sequence[str] = ()) -> None:
        self._kept = ""
        self._seen = 0  # of what was kept: everything before has been answered
        pid, self._terminal = pty.fork()
        if pid == 0:
            os.chdir(folder)
            command = [*within, "sh", "-i"]
            os.execvpe(command[0], command, dict(environment))
        self._pid = pid
        fcntl.ioctl(self._terminal, termios.TIOCSWINSZ, struct.pack("HHHH", *SIZE, 0, 0))
        self.until(PROMPT)

    @property
    def shown(self) -> str:
        """All that was shown, as text."""
        return self._kept

    def type(self, line: str) -> None:
        """A line and Enter."""
        self._seen = len(self._kept)
        os.write(self._terminal, f"{line}\n".encode())

    def until(self, *wanted: str) -> str:
        """What was shown since the last line typed, once its end matches one of these. Raises TerminalError."""
        deadline = time.monotonic() + LONGEST_S
        while True:
            new = self._kept[self._seen :]
            if any(re.search(one, new) for one in wanted):
                return new
            readable, _, _ = select.select([self._terminal], [], [], max(0.0, deadline - time.monotonic()))
            if not readable:
                raise TerminalError(f"waited for {' or '.join(wanted)}, shown is\n{self._kept}")
            self._kept += _CONTROL.sub("", os.read(self._terminal, 65536).decode(errors="replace"))

    def command(self, line: str) -> str:
        """A command, until the shell asks for the next one."""
        self.type(line)
        return self.until(PROMPT)

    def close(self) -> None:
        """The shell ends."""
        os.write(self._terminal, b"exit\n")
        os.waitpid(self._pid, 0)
        os.close(self._terminal)


def environment(tools: Path, more: Sequence[str] = ()) -> dict[str, str]:
    """Of a person whose tools are in this folder, with a plain terminal."""
    kept = {key: os.environ[key] for key in ("HOME", "LANG", "PYTHONPATH", *more) if key in os.environ}
    path = f"{tools}:{os.environ['PATH']}"
    return kept | {"PATH": path, "PS1": "$ ", "TERM": "dumb", "NO_COLOR": "1", "COLUMNS": str(SIZE[1])}

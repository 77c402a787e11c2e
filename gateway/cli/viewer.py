"""The Rerun viewer: a window where there is a display, else a page on loopback. Never listens beyond loopback.

It is a program that travels in the package of Rerun's SDK; an installation for a robot is without it.
"""

import os
import shutil
import socket
import subprocess
import sysconfig
import time
from pathlib import Path
from typing import Self
from urllib.parse import quote

from gateway.cli.output import complain, console
from gateway.cli.parts import MissingPartError, cure
from gateway.recording.disk import segments

LOOPBACK = "127.0.0.1"
WEB_PORT = 9090
DATA_PORT = 9876
ANY_PORT = 0
READY_S = 30.0
END_S = 3.0
# Of what was shown: the viewer, and the server of a page, forget the oldest beyond that.
WINDOW_MEMORY = "2GB"
PAGE_MEMORY = "512MB"


class ViewerError(RuntimeError):
    """There is no viewer; the text says why."""


class _EndedError(ViewerError):
    """It ended before it was ready."""


def view(session: Path) -> None:
    """Shows a session; blocks until the viewer is closed (Ctrl-C ends the served page)."""
    try:
        program = installed()
    except MissingPartError as error:
        complain(f"{error}. Or open {session} on another computer")
        return
    files = [str(path) for path in segments(session)]
    command = [str(program), "--bind", LOOPBACK, "--port", str(DATA_PORT)]
    if not _has_display():
        command += ["--serve-web", "--web-viewer-port", str(WEB_PORT)]
        console.print(f"look at {_page(WEB_PORT, DATA_PORT)} (Ctrl-C ends it)", highlight=False)
    try:
        subprocess.run(_tied([*command, *files]), check=False)
    except KeyboardInterrupt:
        return


class LiveViewer:
    """A viewer that recordings are sent to, at `url`, while they go on.

    Raises ViewerError and MissingPartError at construction.

    `page`: where to look at it, None for a window. Without a display it is a page anyway.
    """

    def __init__(self, *, web: bool = False) -> None:
        program = installed()
        try:
            self._start(program, DATA_PORT, WEB_PORT, web=web)
        except _EndedError:  # another one may have been quicker to take a port that was free
            self._start(program, ANY_PORT, ANY_PORT, web=web)

    def _start(self, program: Path, data_port: int, web_port: int, *, web: bool) -> None:
        """On these ports, or on others where they are not free; waits until it is ready."""
        self._port = free_port(data_port)
        self.url = _url(self._port)
        command = [str(program), "--bind", LOOPBACK, "--port", str(self._port)]
        self.page: str | None = None
        if web or not _has_display():
            web_port = free_port(web_port, other_than=self._port)
            command += ["--serve-web", "--web-viewer-port", str(web_port), "--server-memory-limit", PAGE_MEMORY]
            self.page = _page(web_port, self._port)
        else:
            command += ["--memory-limit", WINDOW_MEMORY, "--expect-data-soon"]
        # In a session of its own: a Ctrl-C reaches only us, who end it.
        self._process = subprocess.Popen(
            _tied(command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            self._wait_until_ready()
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def wait(self, seconds: float) -> bool:
        """Waits so long at most; whether the viewer still runs."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return True
        return False

    def close(self) -> None:
        """Ends the viewer."""
        self._process.terminate()
        if self.wait(END_S):
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _wait_until_ready(self) -> None:
        deadline = time.monotonic() + READY_S
        while self.wait(0.05):
            try:
                socket.create_connection((LOOPBACK, self._port), timeout=1.0).close()
            except OSError:
                if time.monotonic() > deadline:
                    raise ViewerError(f"the Rerun viewer was not ready within {READY_S:g} s") from None
            else:
                return
        raise _EndedError(f"the Rerun viewer ended with exit code {self._process.returncode}; try --web")


def free_port(wanted: int, *, other_than: int | None = None) -> int:
    """This one where nobody listens on it; else any that is free."""
    for port in (wanted, 0, 0):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((LOOPBACK, port))
            except OSError:
                continue
            found: int = probe.getsockname()[1]
        if found != other_than:
            return found
    raise ViewerError("no port on loopback is free")


def installed() -> Path:
    """The program of the viewer. Raises MissingPartError."""
    program = _program()
    if not program.exists():
        raise MissingPartError(f"the Rerun viewer is not installed here: {cure('desk')}")
    return program


def _program() -> Path:
    return Path(sysconfig.get_path("purelib")) / "rerun_cli" / "rerun"


def _tied(command: list[str]) -> list[str]:
    """The kernel ends it with the thread that starts it, whatever ends that (PR_SET_PDEATHSIG); where setpriv is."""
    program = shutil.which("setpriv")
    return command if program is None else [program, "--pdeathsig", "KILL", "--", *command]


def _has_display() -> bool:
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _page(web_port: int, data_port: int) -> str:
    return f"http://{LOOPBACK}:{web_port}/?url={quote(_url(data_port), safe='')}"


def _url(data_port: int) -> str:
    return f"rerun+http://{LOOPBACK}:{data_port}/proxy"

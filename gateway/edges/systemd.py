"""What the service manager is told: sd_notify without a dependency (systemd's sd_notify(3)), and when we are ready."""

import logging
import os
import socket
from collections.abc import Iterable, MutableMapping

from gateway.types import BusEvent, BusEventKind, Status

logger = logging.getLogger(__name__)

MOTORS_LIMIT_NS = 3_000_000_000  # motors that have not answered by then are declared absent
STATUS_LINE_NS = 1_000_000_000
START_EXTENSION_US = 10_000_000  # a start that waits is no failure, one whose loop hangs is
_MOTION = {True: "standing", False: "moving", None: "motion unknown"}


class Notifier:
    """Talks to the service manager if there is one; every method is a no-op otherwise and never raises.

    The variables are taken out of the environment so that children cannot speak for us.
    """

    def __init__(self, environment: MutableMapping[str, str] = os.environ) -> None:
        self._socket: socket.socket | None = None
        address = environment.pop("NOTIFY_SOCKET", None)
        interval_us = environment.pop("WATCHDOG_USEC", None)
        watched_pid = environment.pop("WATCHDOG_PID", None)
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
            self._socket.connect("\0" + address[1:] if address.startswith("@") else address)
        ours = watched_pid is None or int(watched_pid) == os.getpid()
        self._interval_ns = int(interval_us) * 1000 // 3 if interval_us and ours else None
        self._fed_ns = 0

    def ready(self, status: str) -> bool:
        """The service does its job from now on; False if that could not be said now."""
        return self._send(f"READY=1\nSTATUS={status}")

    def status(self, text: str) -> None:
        """One line for `systemctl status`."""
        self._send(f"STATUS={text}")

    def waiting(self, why: str) -> None:
        """The start goes on, and why; keeps the service manager patient for another START_EXTENSION_US."""
        self._send(f"EXTEND_TIMEOUT_USEC={START_EXTENSION_US}\nSTATUS=waiting: {why}")

    def stopping(self) -> None:
        """An orderly end has begun."""
        self._send("STOPPING=1")

    def feed_watchdog(self, now_ns: int) -> None:
        """Called by the control loop itself, so that a hung loop is restarted; sends at a third of the interval."""
        if self._interval_ns is not None and now_ns - self._fed_ns >= self._interval_ns:
            self._fed_ns = now_ns
            self._send("WATCHDOG=1")

    def close(self) -> None:
        """Let go of the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> bool:
        """Never waits, and a service manager that does not listen does not stop the robot."""
        if self._socket is None:
            return True
        try:
            self._socket.send(text.encode(errors="replace"))
        except OSError:
            return False
        return True


class Readiness:
    """Says READY once every bus works and every motor has answered or is declared absent; before that, what is missing.

    The status line begins with mode and motion: `install.sh` refuses to upgrade under a robot that is not at rest.
    """

    def __init__(self, notifier: Notifier, started_ns: int) -> None:
        self._notifier = notifier
        self._started_ns = started_ns
        self._buses_down: dict[str, str] = {}
        self._ready = False
        self._told_ns: int | None = None

    def hear(self, events: Iterable[BusEvent]) -> None:
        """Which buses work."""
        for event in events:
            if event.kind is BusEventKind.DOWN:
                self._buses_down[event.bus] = event.text
            elif event.kind is BusEventKind.UP:
                self._buses_down.pop(event.bus, None)

    def tell(self, status: Status, now_ns: int) -> None:
        """Called with every status; tells what changed, the rest once per second."""
        silent = [motor.name for motor in status.motors if motor.state == "silent"]
        missing = None if self._ready else self._missing(silent, now_ns)
        if not self._ready and missing is None:
            self._told_ns = now_ns
            self._ready = self._notifier.ready(_line(status))
            if self._ready and silent:
                logger.warning("declared absent: %s", ", ".join(silent))
        elif self._told_ns is None or now_ns - self._told_ns > STATUS_LINE_NS:
            self._told_ns = now_ns
            if missing is None:
                self._notifier.status(_line(status))
            else:
                self._notifier.waiting(missing)

    def _missing(self, silent: list[str], now_ns: int) -> str | None:
        """What the start still waits for."""
        for bus, text in self._buses_down.items():
            return f"{bus}: {text}"
        if silent and now_ns - self._started_ns < MOTORS_LIMIT_NS:
            return f"no answer yet from {', '.join(silent)}"
        return None


def _line(status: Status) -> str:
    reason = f": {status.reason}" if status.reason else ""
    return f"{status.mode.value}, {_MOTION[status.standing]}{reason}"

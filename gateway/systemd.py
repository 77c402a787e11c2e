"""sd_notify without a dependency: readiness, status text and the watchdog (systemd's sd_notify(3))."""

import contextlib
import os
import socket
from collections.abc import MutableMapping


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

    def ready(self, status: str) -> None:
        """The service does its job from now on."""
        self._send(f"READY=1\nSTATUS={status}")

    def status(self, text: str) -> None:
        """One line for `systemctl status`."""
        self._send(f"STATUS={text}")

    def stopping(self) -> None:
        """An orderly end has begun."""
        self._send("STOPPING=1")

    def feed_watchdog(self, now_ns: int) -> None:
        """Called by the control loop itself, so that a hung loop is restarted; sends at a third of the interval."""
        if self._interval_ns is not None and now_ns - self._fed_ns >= self._interval_ns:
            self._fed_ns = now_ns
            self._send("WATCHDOG=1")

    def _send(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # a service manager that does not listen must not stop the robot
                self._socket.send(text.encode())

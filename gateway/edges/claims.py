"""One service per motor: whoever commands an identifier on a bus holds it until his process ends.

How this works
--------------
Each identifier is an abstract Unix socket, a name without a file: the kernel frees it with the process, whatever way
that ends, and a sandbox that hides files or users does not hide it. It belongs to the network namespace, as CAN
interfaces do. Two drivers on one bus may not share an identifier either: the C620 takes four motors in one frame.
"""

import errno
import logging
import socket
import struct
from collections.abc import Iterable
from pathlib import Path

from gateway.errors import UserError

logger = logging.getLogger(__name__)

_LONGEST_NAME = 107  # bytes with the leading zero; sun_path of unix(7)
_CREDENTIALS = struct.Struct("3i")  # pid, uid, gid; SO_PEERCRED of unix(7)
_SOCKETS = Path("/proc/self/net/unix")  # of the network namespace of this process
_ASKERS = 16  # refused services whose question may wait unanswered


class InUseError(UserError):
    """Another process commands these motors; the text says which identifier and, if it can be known, which process."""


class Claims:
    """Identifiers of one bus, held until `release` or the end of the process. Raises InUseError, holding nothing."""

    def __init__(self, interface: str, channel: str, identifiers: Iterable[int]) -> None:
        self._sockets: list[socket.socket] = []
        try:
            for identifier in sorted(set(identifiers)):
                self._claim(interface, channel, identifier)
        except InUseError:
            self.release()
            raise

    def release(self) -> None:
        """Let others command."""
        while self._sockets:
            self._sockets.pop().close()

    def _claim(self, interface: str, channel: str, identifier: int) -> None:
        name = f"\0drivegate/{interface}/{channel}/{identifier:X}"[:_LONGEST_NAME]
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._sockets.append(claim)
        try:
            claim.bind(name)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            holder = f"{interface} {channel}: {_holder(name)} already commands CAN id 0x{identifier:X}"
            raise InUseError(f"{holder}; end it first, two services must not drive the same motors") from None
        claim.listen(_ASKERS)


def refuse_where_commanded(interface: str, channel: str) -> None:
    """Raises InUseError if a process commands anything on this bus, as far as the kernel lists the names."""
    begin = f"@drivegate/{interface}/{channel}/"
    try:
        lines = _SOCKETS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        logger.debug("looking for other services: %s", error)
        return
    for name in (line.rpartition(" ")[2] for line in lines):
        if name.startswith(begin):
            holder = _holder("\0" + name.removeprefix("@"))
            raise InUseError(f"{interface} {channel}: {holder} commands motors there; end it first")


def _holder(name: str) -> str:
    """The process that holds a name, in words."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        try:
            asking.connect(name)
        except OSError as error:
            logger.debug("asking for the holder: %s", error)
            return "another process"
        credentials = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    pid, _, _ = _CREDENTIALS.unpack(credentials)
    return f"process {pid}" if pid > 0 else "another process"

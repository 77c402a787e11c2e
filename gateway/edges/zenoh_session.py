"""How a Zenoh session of ours is opened, read and closed: by gateway and client alike, in one place.

How this works. Each receiver has a ring, which drops its oldest and so never holds up the others, and a daemon thread
that reads it. At the end the receivers are undeclared first, which ends their threads at once, whatever the network
does; a thread that still reads inside Zenoh when the interpreter is torn down would abort the process. The session
itself is closed by a thread of its own, because that takes seconds when a peer is frozen.
"""

import atexit
import contextlib
import json
import logging
import re
from collections.abc import Callable, Iterable, Sequence
from threading import Event, Thread
from typing import TypeVar

import zenoh
from zenoh.handlers import RingChannel

from gateway.config import ConfigError
from gateway.errors import UserError

LEASE_MS = 2000  # a peer that freezes is dropped after this; Zenoh's default is 10 s
RECONNECT_MS = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
MAX_PEERS = 32
# A connection that never says a word holds a place until ACCEPT_MS is over. With Zenoh's own bounds (100 places, 10 s)
# a hundred of them keep everybody out for 10 s, measured; whoever opens more than 512 a second still does.
MAX_GREETINGS = 512  # connections that have not opened a session yet; a descriptor each
ACCEPT_MS = 1000
BLOCKED_US = 1_000_000  # who does not read what must not be dropped (a reply, a stop) loses its link after this
OPEN_MS = 2000  # how long we wait for the other side to accept us, before the next try
CLOSE_S = 2.0  # how long each step of closing may take before the process goes on without it

logger = logging.getLogger(__name__)

_SOURCE_PLACE = re.compile(r" at /\S+:\d+\.?")  # Zenoh's errors end with lines of its own source code
_PARSERS = (  # of JSON5, twice, and of TOML, with the whole file in it
    re.compile(r"--> (?P<line>\d+):(?P<column>\d+)\n.*= (?P<what>[^\n]+)", re.DOTALL),
    re.compile(
        r'Message \{ msg: "(?P<what>.*?)(?<!\\)", location: Some\(Location \{ line: (?P<line>\d+), '
        r"column: (?P<column>\d+) \}\)",
        re.DOTALL,
    ),
    re.compile(r'Error \{ message: "(?P<what>.*?)(?<!\\)"', re.DOTALL),
)
_T = TypeVar("_T")


class LinkError(UserError):
    """The Zenoh session cannot be opened or has ended; says with which endpoints and why."""


def open_zenoh(
    *,
    listen: Sequence[str],
    connect: Sequence[str],
    max_message_size: int,
    scouting: bool = False,
    config_file: str | None = None,
) -> zenoh.Session:
    """A peer that talks only to the endpoints given, over whatever the file says else (TLS, access control).

    Endpoints of `connect` are retried for ever. Raises LinkError, and ConfigError for a wrong `config_file`.
    """
    zenoh.init_log_from_env_or("error")
    try:
        config = _file(config_file) if config_file else zenoh.Config()
        for key, value in _settings(listen, connect, max_message_size, scouting).items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise LinkError(
            f"zenoh: listen = {list(listen)}, connect = {list(connect)}, config_file = {config_file}: {_reason(error)}"
        ) from None


class Receivers:
    """The receivers of one session with their threads; owns the session's end, also when nobody calls `close`."""

    def __init__(self, session: zenoh.Session) -> None:
        self.ended: list[str] = []  # threads that ended before `close`, and why; empty while all is well
        self._session = session
        self._undeclare: list[Callable[[], None]] = []
        self._threads: list[Thread] = []
        self._closing = False
        self._close_now = Event()
        # Started now, because at the exit of the interpreter no thread can be started any more.
        self._closer = Thread(target=self._close_session, name="zenoh close", daemon=True)
        self._closer.start()
        atexit.register(self.close)

    def subscribe(self, key: str, handle: Callable[[zenoh.Sample], None], *, ring: int = 1) -> None:
        """Hands over the newest samples."""
        subscriber = self._session.declare_subscriber(key, RingChannel(ring))
        self._read(key, subscriber, handle, subscriber.undeclare)

    def watch(self, key: str, handle: Callable[[zenoh.Sample], None]) -> None:
        """Hands over whether a liveliness token came (put) or went (delete)."""
        subscriber = self._session.liveliness().declare_subscriber(key, RingChannel(1), history=True)
        self._read(key, subscriber, handle, subscriber.undeclare)

    def answer(self, key: str, handle: Callable[[zenoh.Query], None], *, ring: int = 1) -> None:
        """Hands over the newest queries."""
        queryable = self._session.declare_queryable(key, RingChannel(ring))
        self._read(key, queryable, handle, queryable.undeclare)

    def pump(self, name: str, channel: Iterable[_T], handle: Callable[[_T], None]) -> Thread:
        """A daemon thread that hands over every item until the channel closes."""

        def run() -> None:
            why = "failed"
            try:
                for item in channel:
                    handle(item)
                why = "channel closed"
            except zenoh.ZError as error:  # the session ended while something was sent
                why = _reason(error)
            finally:
                if not self._closing:
                    self.ended.append(f"{name}: {why}")

        thread = Thread(target=run, name=f"zenoh {name}", daemon=True)
        thread.start()
        return thread

    def close(self) -> None:
        """Ends threads and session, in bounded time."""
        atexit.unregister(self.close)
        self._closing = True
        for undeclare in self._undeclare:
            with contextlib.suppress(zenoh.ZError):  # already gone with its session
                undeclare()
        for thread in self._threads:
            thread.join(CLOSE_S)
        self._close_now.set()
        self._closer.join(CLOSE_S)

    def _read(
        self, key: str, channel: Iterable[_T], handle: Callable[[_T], None], undeclare: Callable[[], None]
    ) -> None:
        self._undeclare.append(undeclare)
        self._threads.append(self.pump(key, channel, handle))

    def _close_session(self) -> None:
        self._close_now.wait()
        try:
            self._session.close()  # type: ignore[no-untyped-call]
        except zenoh.ZError as error:
            logger.warning("zenoh: %s", _reason(error))


def _settings(listen: Sequence[str], connect: Sequence[str], size: int, scouting: bool) -> dict[str, object]:
    return {
        "mode": "peer",
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/retry": RECONNECT_MS,
        # Opening never waits (often for 0.5 s, measured): whoever needs the other side waits for its liveliness token.
        "open/return_conditions/connect_scouted": False,
        "scouting/multicast/enabled": scouting,
        "scouting/gossip/enabled": scouting,
        "transport/link/rx/max_message_size": size,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": BLOCKED_US,
        "transport/unicast/max_sessions": MAX_PEERS,
        "transport/unicast/accept_pending": MAX_GREETINGS,
        "transport/unicast/accept_timeout": ACCEPT_MS,
        "transport/unicast/open_timeout": OPEN_MS,
        # The implicit path has a race under load (zenoh issue 2628), and our messages are too small to gain from it.
        "transport/shared_memory/enabled": False,
    }


def _file(path: str) -> zenoh.Config:
    """Zenoh's own settings. Raises ConfigError, with the place in the file: trying again does not mend it."""
    try:
        return zenoh.Config.from_file(path)
    except zenoh.ZError as error:
        raise ConfigError(f"zenoh.config_file = {path}", [_reason(error)]) from None


def _reason(error: zenoh.ZError) -> str:
    """In words: what its parsers say comes as a picture of the text or as a structure of theirs."""
    text = _SOURCE_PLACE.sub("", str(error))
    for shape in _PARSERS:
        found = shape.search(text)
        if found is not None:
            told = found.groupdict()
            place = f"line {told['line']}, column {told['column']}: " if "line" in told else ""
            return place + told["what"].replace('\\"', '"')
    return text

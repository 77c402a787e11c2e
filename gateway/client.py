"""A typed client of one robot, for the CLI, for demos and for tests. Keys and payloads: `gateway.edges.messages`.

    with Client("moby") as client:
        client.wait_alive(5.0)
        client.send_twist(0.2, 0.0, 0.0, source="joy")
        client.sense("imu", heading=1.57)

It may be opened before the gateway: the connection is retried until it stands, and again after it breaks.
"""

import itertools
import re
import secrets
import time
from collections import deque
from collections.abc import Callable, Sequence
from math import inf
from operator import index
from threading import Condition
from types import TracebackType
from typing import Self, SupportsFloat, SupportsIndex, TypeVar

import zenoh

from gateway.edges import keys, messages
from gateway.edges.messages import (
    AbilityMessage,
    EventMessage,
    OdometryMessage,
    ResetAnswer,
    StateMessage,
    TruthMessage,
)
from gateway.edges.zenoh_session import LinkError, Receivers, open_zenoh
from gateway.sections import NAME_PATTERN
from gateway.types import ZERO_TWIST, Mode, Region, TwistFrame

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
MAX_MESSAGE_SIZE = 1_048_576  # bytes; a robot file is the longest of our messages
VIEW_RING = 64  # batches of the live view, some seconds; the oldest are dropped
MAX_EVENTS = 1024  # kept for `events`; the oldest are dropped
STOP_REPEAT_S = 0.2
# A laptop that slept must not come back with stamps that are too small: this clock goes on meanwhile, where it exists.
_STAMP_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)

_T = TypeVar("_T")


class Client:
    """One commander or onlooker; each source is commanded from one thread.

    Raises LinkError for a wrong endpoint, ConfigError for a wrong `config_file`.
    """

    def __init__(
        self,
        robot: str,
        *,
        connect: Sequence[str] = (DEFAULT_ENDPOINT,),
        config_file: str | None = None,
        zero_on_exit: bool = False,
    ) -> None:
        self._robot = _checked(robot)
        self._zero_on_exit = zero_on_exit
        self._changed = Condition()
        self._alive = False
        self._odometry: OdometryMessage | None = None
        self._state: StateMessage | None = None
        self._state_at = 0.0  # monotonic, s
        self._truth: TruthMessage | None = None
        self._events: deque[EventMessage] = deque(maxlen=MAX_EVENTS)
        self._commanders: dict[str, zenoh.Publisher] = {}
        self._sensors: dict[str, zenoh.Publisher] = {}
        self._sender = secrets.token_hex(4)
        # Larger than that of a former client on this machine, whose numbers would make ours look old.
        self._sequence = time.monotonic_ns() // 1000
        self._samples = itertools.count(self._sequence)  # sensors may be read in another thread
        self._session = open_zenoh(
            listen=[], connect=connect, max_message_size=MAX_MESSAGE_SIZE, config_file=config_file
        )
        self._stop_publisher = self._publisher(keys.STOP, zenoh.CongestionControl.BLOCK)
        self._receivers = Receivers(self._session)
        self._subscribe(keys.ODOMETRY, messages.decode_odometry, self._keep_odometry)
        self._subscribe(keys.STATE, messages.decode_state, self._keep_state)
        self._subscribe(keys.TRUTH, messages.decode_truth, self._keep_truth)
        self._subscribe(keys.EVENT, messages.decode_event, self._events.append, ring=MAX_EVENTS)
        alive = self._key(keys.ALIVE)
        self._receivers.watch(alive, lambda sample: self._set_alive(sample.kind == zenoh.SampleKind.PUT))

    def send_twist(  # noqa: PLR0913  # all that a command may say
        self,
        vx: SupportsFloat,
        vy: SupportsFloat,
        wz: SupportsFloat,
        *,
        source: str,
        frame: TwistFrame | None = None,
        sequence: SupportsIndex | None = None,
        width_rate: SupportsFloat | None = None,
        path_rate: SupportsFloat | None = None,
        region: Region | None = None,
        width: SupportsFloat | None = None,
    ) -> None:
        """Puts one command, any kind of number; without `sequence` the client counts itself.

        `width_rate` (m/s) or `width` (m, to go to and to keep), `path_rate` (rad/s, how fast the direction of the path
        turns) and `region` are for chassis that can do so; the others refuse what they cannot.
        Raises ValueError, naming axis and range, for a twist that no robot takes; TypeError for what is no number.
        """
        payload = messages.encode_twist(
            (vx, vy, wz),
            frame=frame,
            sequence=self._sequence + 1 if sequence is None else sequence,
            stamp=time.clock_gettime(_STAMP_CLOCK),
            sender=self._sender,
            width_rate=width_rate,
            path_rate=path_rate,
            region=region,
            width=width,
        )
        self._sequence = self._sequence + 1 if sequence is None else index(sequence)
        self._commander(source).put(payload)

    def sense(self, sensor: str, **values: SupportsFloat | None) -> None:
        """Puts one sample of a sensor: `heading=`, `roll=` and `pitch=` with known rates, or `range=`; rad, rad/s, m.

        Raises ValueError, naming quantity and range, for what no robot takes; TypeError for what is no number.
        """
        payload = messages.encode_sample(
            values, sequence=next(self._samples), stamp=time.clock_gettime(_STAMP_CLOCK), sender=self._sender
        )
        if sensor not in self._sensors:
            rest = keys.sample(_checked(sensor))
            self._sensors[sensor] = self._publisher(rest, zenoh.CongestionControl.DROP)
        self._sensors[sensor].put(payload)

    def stop(self, timeout: float = 2.0) -> bool:
        """Latched emergency stop, put again until the robot's state says so; False: it did not in time.

        With a timeout of 0 it is put once and nothing is waited for.
        """
        self._stop_publisher.put(b"stop")
        seen, deadline = self._state, time.monotonic() + timeout

        def stopped(state: StateMessage) -> bool:
            return state is not seen and state.status.mode is Mode.ESTOP

        while (left := deadline - time.monotonic()) > 0.0:
            if self.wait_for_state(stopped, min(left, STOP_REPEAT_S)):
                return True
            self._stop_publisher.put(b"stop")
        return False

    def reset(self, timeout: float = 2.0) -> ResetAnswer:
        """Asks to release the emergency stop or to clear a fault."""
        return self._ask(keys.RESET, None, timeout)

    def stand_up(self, timeout: float = 2.0) -> ResetAnswer:
        """Says that somebody holds a robot that balances, upright; it stands up when it is armed within 10 s."""
        return self._ask(keys.STAND_UP, None, timeout)

    def let_down(self, timeout: float = 2.0) -> ResetAnswer:
        """Says that somebody holds a robot that balances; it lets go within a second. Send no commands meanwhile."""
        return self._ask(keys.LET_DOWN, None, timeout)

    def reference(self, motor: str | None = None, angle: SupportsFloat = 0.0, timeout: float = 2.0) -> ResetAnswer:
        """Says that a steered joint (the only one, where `motor` is None) stands at this angle now, rad at the output.

        Raises ValueError for an angle out of range or what is no name.
        """
        return self._ask(keys.REFERENCE, messages.encode_reference(motor, angle), timeout)

    def set(self, setting: str, value: SupportsFloat, timeout: float = 2.0) -> ResetAnswer:
        """Another value of a setting, until the robot is restarted; which there are is in its state.

        Raises ValueError for what is no name, TypeError for what is no number.
        """
        return self._ask(keys.SET, messages.encode_setting(setting, value), timeout)

    def mark(self, text: str, timeout: float = 2.0) -> ResetAnswer:
        """Words to be found in the recording, and the seconds around them kept as an incident.

        Raises ValueError for what is not 1 to 200 printable characters.
        """
        return self._ask(keys.MARK, messages.encode_mark(text), timeout)

    def give_faults(self, script: str, timeout: float = 2.0) -> ResetAnswer | None:
        """Faults for a simulated robot, as TOML with `[[at]]` (`replay.drive.script`); None: it is no simulated one."""
        payload = self._get(keys.FAULT, timeout, script.encode())
        return None if payload is None else messages.decode_reply(payload)

    def status(self, timeout: float = 2.0) -> StateMessage | None:
        """The newest state, asked for; None: no answer."""
        payload = self._get(keys.STATUS, timeout)
        return None if payload is None else messages.decode_state(payload)

    def reachable(self, timeout: float = 2.0) -> AbilityMessage | None:
        """What the robot can still do, asked for; None: no answer."""
        payload = self._get(keys.REACHABLE, timeout)
        return None if payload is None else messages.decode_ability(payload)

    def config_text(self, timeout: float = 2.0) -> str | None:
        """The robot file of the running gateway; None: no answer."""
        payload = self._get(keys.CONFIG, timeout)
        return None if payload is None else payload.decode(errors="replace")

    def look(self, handle: Callable[[bytes], None]) -> None:
        """Begins to receive the live view (`gateway.edges.live_view`); `handle` is called in a thread of its own.

        The robot tells it only while somebody receives it. A slow `handle` costs batches, and never the robot.
        """
        key = self._key(keys.VIEW)

        def receive(sample: zenoh.Sample) -> None:
            if str(sample.key_expr) == key:  # a put on `**` arrives here too
                handle(sample.payload.to_bytes())

        self._receivers.subscribe(key, receive, ring=VIEW_RING)

    @property
    def robot(self) -> str:
        """Its name."""
        return self._robot

    @property
    def alive(self) -> bool:
        """The gateway's liveliness token is there."""
        return self._alive

    def odometry(self) -> OdometryMessage | None:
        """The newest received odometry."""
        return self._odometry

    def state(self) -> StateMessage | None:
        """The newest received state."""
        return self._state

    def state_age(self) -> float:
        """Seconds since the newest state was received; infinite when there was none."""
        return inf if self._state is None else time.monotonic() - self._state_at

    def truth(self) -> TruthMessage | None:
        """Where a simulated robot really is; None for a real one."""
        return self._truth

    def events(self) -> list[EventMessage]:
        """Events since the last call."""
        return [self._events.popleft() for _ in range(len(self._events))]

    def wait_alive(self, timeout: float) -> bool:
        """Waits for the gateway; False when it did not come."""
        return self._wait(lambda: self._alive, timeout)

    def others_alive(self, timeout: float = 0.5) -> list[str]:
        """Names of other robots that are heard here, whatever kind of name that is."""
        replies = self._session.liveliness().get(keys.key("*", keys.ALIVE), timeout=timeout)
        found = {str(reply.ok.key_expr).partition("/")[0] for reply in replies if reply.ok is not None}
        return sorted(found - {self._robot})

    def wait_for_state(self, predicate: Callable[[StateMessage], bool], timeout: float) -> StateMessage | None:
        """The first received state that satisfies the predicate; None when none came in time."""
        found: list[StateMessage] = []

        def satisfied() -> bool:
            if self._state is not None and predicate(self._state):
                found.append(self._state)
            return bool(found)

        return found[0] if self._wait(satisfied, timeout) else None

    def close(self) -> None:
        """Zeroes its sources if so asked, and leaves the network."""
        if self._session.is_closed():
            return
        for source in self._commanders if self._zero_on_exit else ():
            self.send_twist(*ZERO_TWIST, source=source)
        self._receivers.close()
        self._set_alive(False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _key(self, rest: str) -> str:
        return keys.key(self._robot, rest)

    def _publisher(self, rest: str, congestion: zenoh.CongestionControl) -> zenoh.Publisher:
        return self._session.declare_publisher(
            self._key(rest), congestion_control=congestion, priority=zenoh.Priority.REAL_TIME, express=True
        )

    def _commander(self, source: str) -> zenoh.Publisher:
        if source not in self._commanders:
            self._commanders[source] = self._publisher(keys.twist(_checked(source)), zenoh.CongestionControl.DROP)
        return self._commanders[source]

    def _ask(self, rest: str, request: bytes | None, timeout: float) -> ResetAnswer:
        payload = self._get(rest, timeout, request)
        answer = None if payload is None else messages.decode_reply(payload)
        return answer or ResetAnswer(False, f"no answer from {self._robot} within {timeout:g} s")

    def _get(self, rest: str, timeout: float, request: bytes | None = None) -> bytes | None:
        deadline = time.monotonic() + timeout
        if not self.wait_alive(timeout):
            return None
        left = max(deadline - time.monotonic(), 0.001)
        for reply in self._session.get(self._key(rest), payload=request, timeout=left):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
        return None

    def _wait(self, satisfied: Callable[[], bool], timeout: float) -> bool:
        with self._changed:
            return self._changed.wait_for(satisfied, timeout)

    def _subscribe(
        self, rest: str, decode: Callable[[bytes], _T | None], keep: Callable[[_T], None], *, ring: int = 1
    ) -> None:
        key = self._key(rest)

        def receive(sample: zenoh.Sample) -> None:
            exact = str(sample.key_expr) == key  # a put on `**` arrives here too
            message = decode(sample.payload.to_bytes()) if exact else None
            if message is not None:
                with self._changed:
                    keep(message)
                    self._changed.notify_all()

        self._receivers.subscribe(key, receive, ring=ring)

    def _keep_odometry(self, message: OdometryMessage) -> None:
        self._odometry = message

    def _keep_state(self, message: StateMessage) -> None:
        self._state, self._state_at = message, time.monotonic()

    def _keep_truth(self, message: TruthMessage) -> None:
        self._truth = message

    def _set_alive(self, alive: bool) -> None:
        with self._changed:
            self._alive = alive
            self._changed.notify_all()


def _checked(name: str) -> str:
    """A name as one chunk of a key; anything else might address other robots or sources."""
    if not re.fullmatch(NAME_PATTERN, name):
        raise LinkError(f"name = {name!r}: must match {NAME_PATTERN}")
    return name

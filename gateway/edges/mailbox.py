"""What passes between the control loop and the threads of the Zenoh edge: bounded, without locks, without clock.

How this works. A deque's append and popleft are atomic, and each deque has one side that only appends and one that only
takes, so nobody ever waits; a deque of one keeps the newest. Whoever takes sees a deque only grow meanwhile.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from queue import SimpleQueue
from typing import NamedTuple, TypeVar

from gateway.edges import keys, messages
from gateway.types import Event, Level, Refusal, Request, RequestKind, SensorSample, TwistCommand

MAX_REFUSALS = 32  # waiting for the loop; the oldest are dropped
MAX_EVENTS = 256  # waiting to be published; those that find no room are counted
MAX_QUESTIONS = 16  # requests with an answer, waiting for the loop
QUESTION_EXPIRY_NS = 500_000_000  # one seen later is dropped: its asker would be told "no answer" although it worked

_Dated = TypeVar("_Dated", TwistCommand, Refusal, Request, SensorSample)


class Drained(NamedTuple):
    """What came in since the last cycle, in the order of the robot file; a stop is the last request: it wins."""

    commands: tuple[TwistCommand, ...]
    refusals: tuple[Refusal, ...]
    requests: tuple[Request, ...]
    samples: tuple[SensorSample, ...]


NOTHING = Drained((), (), (), ())


class Mailbox:
    """From the subscribers' threads, which append, to the loop, which takes."""

    def __init__(self, sources: Iterable[str], sensors: Iterable[str] = ()) -> None:
        self.commands: dict[str, deque[TwistCommand]] = {source: deque(maxlen=1) for source in sources}
        self.samples: dict[str, deque[SensorSample]] = {sensor: deque(maxlen=1) for sensor in sensors}
        self.refusals: deque[Refusal] = deque(maxlen=MAX_REFUSALS)
        self.questions: deque[Request] = deque(maxlen=MAX_QUESTIONS)
        self.stops: deque[Request] = deque(maxlen=1)
        self._all = (*self.commands.values(), *self.samples.values(), self.refusals, self.questions, self.stops)

    def drain(self, now_ns: int) -> Drained:
        """Everything that waits: of each source and sensor the newest; nothing dated after `now_ns`."""
        if not any(self._all):
            return NOTHING
        commands = [slot.popleft() for slot in self.commands.values() if slot]
        samples = [slot.popleft() for slot in self.samples.values() if slot]
        refusals = [self.refusals.popleft() for _ in range(len(self.refusals))]
        requests = [self.questions.popleft() for _ in range(len(self.questions))]
        requests += [self.stops.popleft() for _ in range(len(self.stops))]
        return Drained(
            commands=tuple(_not_after(now_ns, command) for command in commands),
            refusals=tuple(_not_after(now_ns, refusal) for refusal in refusals),
            requests=tuple(_not_after(now_ns, request) for request in requests if not _expired(request, now_ns)),
            samples=tuple(_not_after(now_ns, sample) for sample in samples),
        )


class Outbox:
    """From the loop, which leaves payloads still to be encoded, to the publisher's thread, which encodes and takes."""

    def __init__(self) -> None:
        self.calls: SimpleQueue[bool] = SimpleQueue()  # True: something waits; False: the end
        self._newest: dict[str, deque[Callable[[], bytes]]] = {
            name: deque(maxlen=1) for name in (keys.ODOMETRY, keys.STATE, keys.TRUTH, keys.REACHABLE)
        }
        self._events: deque[Callable[[], bytes]] = deque()
        self._lost = 0
        self._lost_ns = 0
        self._lost_told = 0

    def leave(self, name: str, encode: Callable[[], bytes]) -> None:
        """Replaces what was left under this name."""
        self._newest[name].append(encode)
        self._call()

    def leave_events(self, events: Iterable[Event], now_ns: int) -> None:
        """Adds events, in order."""
        for event in events:
            if len(self._events) < MAX_EVENTS:
                self._events.append(partial(messages.encode_event, event, now_ns))
            else:
                self._lost, self._lost_ns = self._lost + 1, now_ns
        self._call()

    def take(self) -> Iterator[tuple[str, bytes]]:
        """Names and payloads of all that waits, ending with how many events were lost."""
        while self._events:
            yield keys.EVENT, self._events.popleft()()
        for name, slot in self._newest.items():
            if slot:
                yield name, slot.popleft()()
        lost, self._lost_told = self._lost - self._lost_told, self._lost
        if lost:
            event = Event(Level.WARNING, "events_lost", f"{lost} events could not be published in time")
            yield keys.EVENT, messages.encode_event(event, self._lost_ns)

    def _call(self) -> None:
        if self.calls.empty():
            self.calls.put(True)


def _not_after(now_ns: int, item: _Dated) -> _Dated:
    # What arrives between the loop's look at the clock and its look in here is not from the future.
    return item if item.received_ns <= now_ns else item._replace(received_ns=now_ns)


def _expired(request: Request, now_ns: int) -> bool:
    return request.kind is not RequestKind.ESTOP and now_ns - request.received_ns > QUESTION_EXPIRY_NS

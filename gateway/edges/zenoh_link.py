"""The Zenoh edge: commands in; odometry, state and events out. Keys and payloads are listed in `messages`.

How this works. Every source, every sensor and the emergency stop have a subscriber with a ring of one and a thread of
their own, so a slow reader never makes a command old and never holds up the stop. The threads parse and leave the
result in a mailbox, which the loop empties once per cycle with `drain`; what the loop says goes through an outbox to
one publisher thread.

Anyone may put, delete or get `**`, which reaches every key. Therefore:
- a twist drives only when it was put on exactly the key of a configured source; a sample likewise of a sensor;
- whatever reaches `cmd/stop` stops, also a delete or a wildcard: a stop too many is safe, a missed one is not;
- whatever is asked of the robot counts only when asked by its exact key: a get on `**` is how people look around;
- everything else under `cmd/` and `sensor/` is refused and reported.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import MappingProxyType, TracebackType
from typing import Self

import zenoh

from gateway.config import RobotConfig, Sensor
from gateway.edges import keys, messages
from gateway.edges.live_view import LiveView
from gateway.edges.mailbox import Drained, Mailbox, Outbox
from gateway.edges.messages import SampleMessage, TwistMessage
from gateway.edges.source_gate import SourceGate
from gateway.edges.zenoh_questions import END, Questions, answer
from gateway.edges.zenoh_session import CLOSE_S, LinkError, Receivers, open_zenoh
from gateway.types import (
    AbilityStatus,
    CycleTiming,
    Event,
    Inputs,
    Odometry,
    Outputs,
    Pose,
    Refusal,
    RefusalCode,
    Reply,
    Request,
    RequestKind,
    Status,
)

MAX_MESSAGE_SIZE = 65_536  # bytes; Zenoh drops longer ones before they take memory
MAX_STRANGERS = 64  # samples waiting to be refused; the oldest are dropped
MAX_LOOKS = 8  # queries waiting for state or robot file; likewise
MAX_CROWD = 512  # queries waiting to be told that too many wait already; likewise
MAX_KEY_SHOWN = 64  # characters of a stranger's key in a message
STRANGER = "a stranger"  # the source of what no source has sent: no name of the robot file, and always the same
NOT_EXACT = "must be asked by its exact key, without wildcards"
NO_EXTRAS: Mapping[str, object] = MappingProxyType({})


class ZenohLink:
    """One robot on Zenoh. Raises LinkError when the session cannot be opened, and from `drain` when it has ended."""

    def __init__(self, config: RobotConfig, config_text: str) -> None:
        self._robot = config.robot.name
        self._sources = [source.name for source in config.commands.source]
        sensors = [sensor for sensor in config.sensor if sensor.bus is None]
        self._sensors = [sensor.name for sensor in sensors]
        own = [keys.STOP, *map(keys.twist, self._sources), *map(keys.sample, self._sensors)]
        self._own_keys = set(map(self._key, own))
        self._mailbox = Mailbox(self._sources, self._sensors)
        self._outbox = Outbox()
        self._questions = Questions(self._mailbox.questions.append)
        self._newest: dict[str, bytes] = {}  # of the payloads that are also asked for
        self._ability: AbilityStatus | None = None
        self._session = open_zenoh(
            listen=config.zenoh.listen,
            connect=config.zenoh.connect,
            max_message_size=MAX_MESSAGE_SIZE,
            scouting=config.zenoh.multicast_scouting,
            config_file=config.zenoh.config_file,
        )
        self._publishers = {name: self._publisher(name) for name in keys.PUBLISHED}
        self._view = LiveView(self._session, self._key(keys.VIEW), config.zenoh.view_rate)
        self._receivers = Receivers(self._session)
        self._publishing = self._receivers.pump("publisher", iter(self._outbox.calls.get, False), self._send)
        for source in config.commands.source:
            gate = SourceGate(round(source.timeout * 1e9))
            self._receivers.subscribe(self._key(keys.twist(source.name)), partial(self._receive, source.name, gate))
        for sensor in sensors:
            gate = SourceGate(round(sensor.timeout * 1e9))
            self._receivers.subscribe(self._key(keys.sample(sensor.name)), partial(self._sense, sensor, gate))
        self._receivers.subscribe(self._key(keys.STOP), self._stop)
        self._receivers.subscribe(self._key(keys.COMMANDS), self._refuse_stranger, ring=MAX_STRANGERS)
        self._receivers.subscribe(self._key(keys.SENSORS), self._refuse_strange_sample, ring=MAX_STRANGERS)
        answers = iter(self._questions.next_reply, END)
        self._answering = self._receivers.pump("answers", answers, self._questions.settle)
        for rest, read in QUESTIONS.items():
            self._receivers.answer(self._key(rest), partial(self._ask, rest, read), ring=MAX_CROWD)
        for asked, told in ((keys.STATUS, keys.STATE), (keys.REACHABLE, keys.REACHABLE)):
            self._receivers.answer(self._key(asked), partial(self._answer_newest, asked, told), ring=MAX_LOOKS)
        answer_config = partial(self._answer_config, config_text.encode())
        self._receivers.answer(self._key(keys.CONFIG), answer_config, ring=MAX_LOOKS)
        self._token = self._session.liveliness().declare_token(self._key(keys.ALIVE))

    def drain(self, now_ns: int) -> Drained:
        """The newest of each source and each sensor, refusals and requests since the last call; never waits."""
        if self._receivers.ended:
            raise LinkError(f"zenoh: thread ended: {'; '.join(self._receivers.ended)}")
        return self._mailbox.drain(now_ns)

    def reply(self, reply: Reply) -> None:
        """Answers the request with this id; never waits."""
        self._questions.reply(reply)

    def publish(
        self,
        *,
        odometry: Odometry | None,
        status: Status | None,
        events: Sequence[Event],
        now_ns: int,
        extras: Mapping[str, object] = NO_EXTRAS,
    ) -> None:
        """Leaves the outputs of a cycle to the publisher thread; never waits. `extras` must not change afterwards."""
        if odometry is not None:
            self._outbox.leave(keys.ODOMETRY, partial(messages.encode_odometry, odometry, now_ns))
        if status is not None:
            self._outbox.leave(keys.STATE, partial(messages.encode_state, status, now_ns, extras))
            if status.ability != self._ability:
                self._ability = status.ability
                self._outbox.leave(keys.REACHABLE, partial(messages.encode_ability, status.ability, now_ns))
        if events:
            self._outbox.leave_events(events, now_ns)

    def show(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming) -> None:
        """Leaves what is drawn of a cycle, if anybody looks on; never waits."""
        self._view.show(inputs, outputs, timing)

    def publish_truth(self, pose: Pose, t: float) -> None:
        """Where the simulated robot really is, at `t` seconds."""
        self._outbox.leave(keys.TRUTH, partial(messages.encode_truth, pose, t))

    def answer(self, rest: str, handle: Callable[[bytes], str | None]) -> None:
        """Answers one more key, as a reset is: `handle` says what is wrong with a payload. In a thread of its own."""
        self._receivers.answer(self._key(rest), partial(self._answer_at_once, rest, handle), ring=MAX_LOOKS)

    def mark(self, text: str, now_ns: int) -> None:
        """Leaves a mark to the loop, as if somebody had asked for it; nobody is answered."""
        self._mailbox.questions.append(Request(RequestKind.MARK, 0, now_ns, text=text))

    def close(self) -> None:
        """Publishes what waits, withdraws from the network and ends the threads, in bounded time."""
        self._outbox.calls.put(False)
        self._questions.close()
        self._publishing.join(CLOSE_S)
        self._answering.join(CLOSE_S)
        self._view.close()
        self._receivers.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _key(self, rest: str) -> str:
        return keys.key(self._robot, rest)

    def _publisher(self, name: str) -> zenoh.Publisher:
        """What finds no room is dropped; events, which come once, have a queue of their own before all else."""
        return self._session.declare_publisher(
            self._key(name),
            encoding=zenoh.Encoding.APPLICATION_JSON,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH if name == keys.EVENT else zenoh.Priority.DATA,
            express=name != keys.EVENT,
        )

    def _send(self, _: bool) -> None:
        for name, payload in self._outbox.take():
            self._publishers[name].put(payload)
            self._newest[name] = payload

    def _receive(self, source: str, gate: SourceGate, sample: zenoh.Sample) -> None:
        received_ns = time.monotonic_ns()
        if str(sample.key_expr) != self._key(keys.twist(source)):
            return  # a wildcard: refused by the subscriber of strangers
        message = _twist(sample, source, received_ns)
        outcome = message if isinstance(message, Refusal) else gate.admit(*message)
        if isinstance(outcome, Refusal):
            self._mailbox.refusals.append(outcome)
            return
        self._mailbox.commands[source].append(outcome)

    def _sense(self, sensor: Sensor, gate: SourceGate, received: zenoh.Sample) -> None:
        received_ns = time.monotonic_ns()
        if str(received.key_expr) != self._key(keys.sample(sensor.name)):
            return  # a wildcard: refused by the subscriber of strangers
        message = _sample(received, sensor, received_ns)
        outcome = message if isinstance(message, Refusal) else gate.admit(*message)
        if isinstance(outcome, Refusal):
            self._mailbox.refusals.append(outcome)
            return
        self._mailbox.samples[sensor.name].append(outcome)

    def _stop(self, _: zenoh.Sample) -> None:
        self._mailbox.stops.append(Request(RequestKind.ESTOP, 0, time.monotonic_ns()))

    def _refuse_stranger(self, sample: zenoh.Sample) -> None:
        known = f"the sources are {', '.join(self._sources)}"
        self._refuse(sample, RefusalCode.UNKNOWN_SOURCE, known)

    def _refuse_strange_sample(self, sample: zenoh.Sample) -> None:
        if sample.key_expr.intersects(self._key(keys.COMMANDS)):
            return  # a wildcard that reaches commands too, and is refused as such
        known = (
            f"the sensors are {', '.join(self._sensors)}" if self._sensors else "this robot has no [[sensor]] by Zenoh"
        )
        self._refuse(sample, RefusalCode.UNKNOWN_SENSOR, known)

    def _refuse(self, sample: zenoh.Sample, unknown: RefusalCode, known: str) -> None:
        received_ns, key = time.monotonic_ns(), str(sample.key_expr)
        if key in self._own_keys:
            return
        shown = ascii(key)[1:-1][:MAX_KEY_SHOWN]
        code, text = unknown, f"put on {shown}: {known}"
        if sample.kind != zenoh.SampleKind.PUT:
            code, text = RefusalCode.NOT_A_PUT, f"delete on {shown}: must be a put"
        elif "*" in key:
            code, text = RefusalCode.KEY_NOT_EXACT, f"put on {shown}: must be an exact key, without wildcards"
        self._mailbox.refusals.append(Refusal(STRANGER, code, text, received_ns))

    def _ask(self, rest: str, read: Callable[[bytes, int], Request | str], query: zenoh.Query) -> None:
        key, received_ns = self._key(rest), time.monotonic_ns()
        if str(query.key_expr) != key:
            answer(query, key, f"{rest} {NOT_EXACT}")
            return
        request = read(query.payload.to_bytes() if query.payload else b"", received_ns)
        if isinstance(request, str):
            answer(query, key, request)
            return
        self._questions.ask(query, key, request)

    def _answer_at_once(self, rest: str, handle: Callable[[bytes], str | None], query: zenoh.Query) -> None:
        key = self._key(rest)
        if str(query.key_expr) != key:
            answer(query, key, f"{rest} {NOT_EXACT}")
            return
        reason = handle(query.payload.to_bytes() if query.payload else b"")
        answer(query, key, reason, ok=reason is None)

    def _answer_newest(self, asked: str, told: str, query: zenoh.Query) -> None:
        with query:
            payload = self._newest.get(told)
            if payload is None:
                query.reply_err(f"no {told} was published yet")
                return
            query.reply(self._key(asked), payload, encoding=zenoh.Encoding.APPLICATION_JSON)

    def _answer_config(self, text: bytes, query: zenoh.Query) -> None:
        with query:
            query.reply(self._key(keys.CONFIG), text, encoding=zenoh.Encoding.TEXT_PLAIN)


def _twist(sample: zenoh.Sample, source: str, received_ns: int) -> TwistMessage | Refusal:
    if sample.kind != zenoh.SampleKind.PUT:
        return Refusal(source, RefusalCode.NOT_A_PUT, "delete: must be a put", received_ns)
    return messages.parse_twist(sample.payload.to_bytes(), source=source, received_ns=received_ns)


def _sample(received: zenoh.Sample, sensor: Sensor, received_ns: int) -> SampleMessage | Refusal:
    if received.kind != zenoh.SampleKind.PUT:
        return Refusal(sensor.name, RefusalCode.NOT_A_PUT, "delete: must be a put", received_ns)
    payload = received.payload.to_bytes()
    return messages.parse_sample(payload, sensor=sensor.name, kind=sensor.kind, received_ns=received_ns)


def _reference(payload: bytes, received_ns: int) -> Request | str:
    reference = messages.parse_reference(payload)
    return reference if isinstance(reference, str) else Request(RequestKind.REFERENCE, 0, received_ns, *reference)


def _set(payload: bytes, received_ns: int) -> Request | str:
    change = messages.parse_setting(payload)
    if isinstance(change, str):
        return change
    return Request(RequestKind.SET, 0, received_ns, setting=change.setting, value=change.value)


def _mark(payload: bytes, received_ns: int) -> Request | str:
    mark = messages.parse_mark(payload)
    return mark if isinstance(mark, str) else Request(RequestKind.MARK, 0, received_ns, text=mark.text)


def _bare(kind: RequestKind, _: bytes, received_ns: int) -> Request:
    """One that has nothing to say but its kind."""
    return Request(kind, 0, received_ns)


QUESTIONS: Mapping[str, Callable[[bytes, int], Request | str]] = {
    keys.RESET: partial(_bare, RequestKind.RESET),
    keys.STAND_UP: partial(_bare, RequestKind.STAND_UP),
    keys.LET_DOWN: partial(_bare, RequestKind.LET_DOWN),
    keys.REFERENCE: _reference,
    keys.SET: _set,
    keys.MARK: _mark,
}

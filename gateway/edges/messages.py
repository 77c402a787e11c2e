"""Payloads on the wire: JSON in UTF-8, SI units, null where unknown. Keys start with the robot's name.

| key                  | verb       | payload                                                                        |
|----------------------|------------|--------------------------------------------------------------------------------|
| `cmd/twist/<source>` | put        | `{"vx", "vy", "wz"}` and what is optional, see below                           |
| `sensor/<name>`      | put        | by the sensor's kind, see below                                                |
| `cmd/stop`           | put        | anything: the latched emergency stop                                           |
| `cmd/reset`          | get        | reply `{"ok", "reason": text or null}`                                         |
| `cmd/stand_up`       | get        | of a robot that balances: stands up with the next zero; reply as to a reset    |
| `cmd/let_down`       | get        | of a robot that balances: lets go within 1 s; reply as to a reset              |
| `cmd/reference`      | get        | `{"motor": name (optional), "angle": rad (optional, 0)}`; reply as to a reset  |
| `cmd/set`            | get        | `{"setting": name, "value": number}`; reply as to a reset                      |
| `cmd/mark`           | get        | `{"text": words}`, an event and an incident of their own; reply as to a reset  |
| `sim/fault`          | get        | faults as TOML, only of a simulated robot; reply as to a reset                 |
| `odometry`           | subscribe  | `{"t", "x", "y", "theta", "vx", "vy", "wz", "covariance": [9], "residual"}`    |
| `state`              | subscribe  | `{"t", every field of Status in words, "extras": {...}}`                       |
| `event`              | subscribe  | `{"t", "level", "code", "text"}`                                               |
| `reachable`          | both       | `{"t", "rank", "effort", "speed", "reachable": [twist], "lost": [twist]}`      |
| `truth`              | subscribe  | `{"t", "x", "y", "theta"}`; only from a simulated robot                        |
| `view`               | subscribe  | no JSON, and only while somebody does: see `gateway.edges.live_view`           |
| `status`             | get        | the newest `state`                                                             |
| `config`             | get        | the robot file as it was read (TOML)                                           |
| `alive`              | liveliness | there while the gateway runs                                                   |

A twist: m/s and rad/s, all three required, finite, within the ranges below; no other keys, none twice, at most
MAX_PAYLOAD bytes. Optional: `frame`, "body" (when left out) or "odom"; `width_rate`, m/s, or `width`, m, never both;
`path_rate`, rad/s; `region`, "any" (when left out), "push" or "pull"; what the chassis cannot do of these is refused by
the core.
`seq` grows by any step from one command to the next.
A sample of a sensor: `{"heading"}`, `{"roll", "pitch"}` and, each optional, `"roll_rate", "pitch_rate", "yaw_rate"`, or
`{"range"}`; rad, rad/s, m, and as for a twist, each optional, `"seq", "stamp", "sender"`. The same rules.
`stamp` is when it was sent, in seconds of a clock of the sender's own that never stands still and is never set;
`sender` names the process, anew at each start of it. `reachable` is put whenever it changes and answers a get: rank and
shares of acceleration and speed that are left, and, where motors are lost, the furthest twist along each way that is
left and along those that are not, as `{"vx", "vy", "wz"}`. `t` is CLOCK_MONOTONIC of the cycle, seconds.
"""

import json
from collections.abc import Mapping
from enum import Enum
from math import inf
from operator import index
from typing import Annotated, Literal, NamedTuple, SupportsFloat, SupportsIndex, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, ValidationInfo, field_validator
from pydantic_core import from_json, to_json

from gateway.edges.setting_keys import objection
from gateway.sections import NAME_PATTERN
from gateway.types import (
    AbilityStatus,
    Event,
    Level,
    Odometry,
    Pose,
    Refusal,
    RefusalCode,
    Region,
    Reply,
    SensorKind,
    SensorSample,
    Status,
    Twist,
    TwistCommand,
    TwistFrame,
)

MAX_PAYLOAD = 1024  # bytes; a full twist is below 200
MAX_SPEED = 20.0  # m/s: faster is no wheeled robot of this service but a wrong unit
MAX_TURN = 50.0  # rad/s: likewise
MAX_WIDTH_RATE = 5.0  # m/s
MAX_WIDTH = 10.0  # m
MAX_SEQUENCE = 2**63 - 1  # what a recording can hold
MAX_STAMP = 1e10  # s, three centuries; a double still tells microseconds apart
MAX_SETTING = 1e9  # the range of each setting is the core's business
MAX_ANGLE = 6.3  # rad: one turn of a steered joint either way
MAX_HEADING = 1e6  # rad; a gyro that turned for days, and a double still tells its microradians
MAX_LEAN = 3.15  # rad: upside down
MAX_RANGE = 1000.0  # m
MAX_WORDS = 200  # characters of a mark
SENDER_PATTERN = r"^[A-Za-z0-9_.-]{1,32}$"
MAX_SHOWN = 40  # characters of a stranger's value in a message

_ALLOWED = {
    "vx": f"a number from {-MAX_SPEED:g} to {MAX_SPEED:g} m/s",
    "vy": f"a number from {-MAX_SPEED:g} to {MAX_SPEED:g} m/s",
    "wz": f"a number from {-MAX_TURN:g} to {MAX_TURN:g} rad/s",
    "frame": "'body' or 'odom'",
    "width_rate": f"a number from {-MAX_WIDTH_RATE:g} to {MAX_WIDTH_RATE:g} m/s",
    "width": f"a number from 0 to {MAX_WIDTH:g} m, and the only one of width and width_rate",
    "path_rate": f"a number from {-MAX_TURN:g} to {MAX_TURN:g} rad/s",
    "region": "'any', 'push' or 'pull'",
    "seq": "a whole number from 0 to 2^63-1",
    "stamp": f"a number from 0 to {MAX_STAMP:g} s",
    "sender": f"text that matches {SENDER_PATTERN}",
    "heading": f"a number from {-MAX_HEADING:g} to {MAX_HEADING:g} rad",
    "roll": f"a number from {-MAX_LEAN:g} to {MAX_LEAN:g} rad",
    "pitch": f"a number from {-MAX_LEAN:g} to {MAX_LEAN:g} rad",
    "roll_rate": f"a number from {-MAX_TURN:g} to {MAX_TURN:g} rad/s",
    "pitch_rate": f"a number from {-MAX_TURN:g} to {MAX_TURN:g} rad/s",
    "yaw_rate": f"a number from {-MAX_TURN:g} to {MAX_TURN:g} rad/s",
    "range": f"a number from 0 to {MAX_RANGE:g} m",
    "motor": f"the name of a motor, matching {NAME_PATTERN}, or null",
    "setting": f"the name of a setting, matching {NAME_PATTERN}",
    "value": f"a number from {-MAX_SETTING:g} to {MAX_SETTING:g}",
    "angle": f"a number from {-MAX_ANGLE:g} to {MAX_ANGLE:g} rad",
    "text": f"1 to {MAX_WORDS} printable characters in one line",
}
_CODES = {
    "finite_number": RefusalCode.NOT_FINITE,
    "greater_than_equal": RefusalCode.OUT_OF_RANGE,
    "less_than_equal": RefusalCode.OUT_OF_RANGE,
}
_T = TypeVar("_T")


class _SentPayload(BaseModel):
    """What every sender may tell of itself."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    seq: Annotated[int, Field(ge=0, le=MAX_SEQUENCE)] | None = None
    stamp: Annotated[float, Field(ge=0.0, le=MAX_STAMP)] | None = None
    sender: Annotated[str, Field(pattern=SENDER_PATTERN)] | None = None


class _TwistPayload(_SentPayload):
    vx: Annotated[float, Field(ge=-MAX_SPEED, le=MAX_SPEED)]
    vy: Annotated[float, Field(ge=-MAX_SPEED, le=MAX_SPEED)]
    wz: Annotated[float, Field(ge=-MAX_TURN, le=MAX_TURN)]
    frame: Literal["body", "odom"] = "body"
    width_rate: Annotated[float, Field(ge=-MAX_WIDTH_RATE, le=MAX_WIDTH_RATE)] | None = None
    path_rate: Annotated[float, Field(ge=-MAX_TURN, le=MAX_TURN)] | None = None
    region: Literal["any", "push", "pull"] = "any"
    width: Annotated[float, Field(ge=0.0, le=MAX_WIDTH)] | None = None

    @field_validator("width")
    @classmethod
    def _one_of_both(cls, width: float | None, others: ValidationInfo) -> float | None:
        if width is not None and others.data.get("width_rate") is not None:
            message = "beside width_rate"
            raise ValueError(message)
        return width


class _HeadingPayload(_SentPayload):
    heading: Annotated[float, Field(ge=-MAX_HEADING, le=MAX_HEADING)]


_Lean = Annotated[float, Field(ge=-MAX_LEAN, le=MAX_LEAN)]
_BodyRate = Annotated[float, Field(ge=-MAX_TURN, le=MAX_TURN)]


class _AttitudePayload(_SentPayload):
    roll: _Lean
    pitch: _Lean
    roll_rate: _BodyRate | None = None
    pitch_rate: _BodyRate | None = None
    yaw_rate: _BodyRate | None = None


class _RangePayload(_SentPayload):
    range: Annotated[float, Field(ge=0.0, le=MAX_RANGE)]


_SAMPLES: dict[SensorKind, type[_SentPayload]] = {
    SensorKind.HEADING: _HeadingPayload,
    SensorKind.ATTITUDE: _AttitudePayload,
    SensorKind.RANGE: _RangePayload,
}
# What each kind tells, in the order of SensorSample.values.
QUANTITIES: dict[SensorKind, tuple[str, ...]] = {
    kind: tuple(name for name in payload.model_fields if name not in _SentPayload.model_fields)
    for kind, payload in _SAMPLES.items()
}


class _ReferencePayload(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    motor: Annotated[str, Field(pattern=NAME_PATTERN)] | None = None
    angle: Annotated[float, Field(ge=-MAX_ANGLE, le=MAX_ANGLE)] = 0.0


class _SettingPayload(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    setting: Annotated[str, Field(pattern=NAME_PATTERN)]
    value: Annotated[float, Field(ge=-MAX_SETTING, le=MAX_SETTING)]


class _MarkPayload(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    text: Annotated[str, Field(min_length=1, max_length=MAX_WORDS)]

    @field_validator("text")
    @classmethod
    def _one_line(cls, text: str) -> str:
        """Words go into logs and onto terminals, which obey control characters."""
        if not text.isprintable() or text.isspace():
            message = "not printable"
            raise ValueError(message)
        return text


class TwistMessage(NamedTuple):
    """A command as it came; `stamp_ns`: when it was sent by its sender's clock, None: not told."""

    command: TwistCommand
    stamp_ns: int | None


class SampleMessage(NamedTuple):
    """A sample as it came; `stamp_ns` as of a TwistMessage."""

    sample: SensorSample
    stamp_ns: int | None


class Reference(NamedTuple):
    """At which angle (rad at the output, from its zero) a steered joint stands; `motor` None: the only one."""

    motor: str | None
    angle: float


class SettingChange(NamedTuple):
    """Another value of a setting."""

    setting: str
    value: float


class Mark(NamedTuple):
    """Words of a person, to be found in the recording."""

    text: str


class OdometryMessage(NamedTuple):
    """Odometry as it travels; see the table above."""

    t: float  # s
    x: float  # m, in `odom`, which begins where the service did
    y: float  # m
    theta: float  # rad
    vx: float | None  # m/s, of the body; None: not measurable now
    vy: float | None  # m/s
    wz: float | None  # rad/s
    covariance: tuple[float, ...]  # of x, y and theta: nine numbers, row by row
    residual: float | None  # m/s; None where the wheels carry no redundancy


class StateMessage(NamedTuple):
    """Status with its time and what the service adds (such as the health of the recording)."""

    t: float
    status: Status
    extras: dict[str, object]


class AbilityMessage(NamedTuple):
    """What the robot can still do, with the time from which it is so."""

    t: float
    ability: AbilityStatus


class EventMessage(NamedTuple):
    """One event with the time of its cycle."""

    t: float
    level: Level
    code: str
    text: str


class TruthMessage(NamedTuple):
    """Where a simulated robot really is."""

    t: float
    x: float
    y: float
    theta: float


class ResetAnswer(NamedTuple):
    """Whether the robot did what was asked (a reset, a reference, a setting), and if not, why."""

    ok: bool
    reason: str | None


_ODOMETRY = TypeAdapter(OdometryMessage)
_STATE = TypeAdapter(StateMessage)
_ABILITY = TypeAdapter(AbilityMessage)
_EVENT = TypeAdapter(EventMessage)
_TRUTH = TypeAdapter(TruthMessage)
_RESET = TypeAdapter(ResetAnswer)


def parse_twist(payload: bytes, *, source: str, received_ns: int) -> TwistMessage | Refusal:
    """The command in the payload, or why there is none. Total: no payload raises."""
    try:
        parsed = _TwistPayload.model_validate(_document(payload))
    except ValidationError as error:
        return Refusal(source, *_reason(error, _TwistPayload), received_ns)
    except _UnreadableError as error:
        return Refusal(source, error.code, str(error), received_ns)
    twist = Twist(parsed.vx, parsed.vy, parsed.wz)
    command = TwistCommand(
        source,
        twist,
        TwistFrame(parsed.frame),
        parsed.seq,
        received_ns,
        parsed.sender,
        width_rate=parsed.width_rate,
        path_rate=parsed.path_rate,
        region=Region(parsed.region),
        width=parsed.width,
    )
    return TwistMessage(command, _nanoseconds(parsed.stamp))


def encode_twist(  # noqa: PLR0913  # all that a command may say
    twist: tuple[SupportsFloat, SupportsFloat, SupportsFloat],
    *,
    frame: TwistFrame | None = None,
    sequence: SupportsIndex | None = None,
    stamp: float | None = None,
    sender: str | None = None,
    width_rate: SupportsFloat | None = None,
    path_rate: SupportsFloat | None = None,
    region: Region | None = None,
    width: SupportsFloat | None = None,
) -> bytes:
    """What a commander puts on `cmd/twist/<source>`; any kind of number (numpy's, fractions) travels as a number.

    Raises ValueError, naming key and range, for what the gateway would refuse; TypeError for what is no number.
    """
    document = {key: _number(key, value) for key, value in zip(Twist._fields, twist, strict=True)}
    optional = {
        "frame": None if frame is None else frame.value,
        "seq": None if sequence is None else index(sequence),
        "stamp": stamp,
        "sender": sender,
        "width_rate": None if width_rate is None else _number("width_rate", width_rate),
        "path_rate": None if path_rate is None else _number("path_rate", path_rate),
        "region": None if region is None else region.value,
        "width": None if width is None else _number("width", width),
    }
    return _checked(document | {key: value for key, value in optional.items() if value is not None}, _TwistPayload)


def parse_sample(payload: bytes, *, sensor: str, kind: SensorKind, received_ns: int) -> SampleMessage | Refusal:
    """The sample in the payload, or why there is none. Total: no payload raises."""
    model = _SAMPLES[kind]
    try:
        parsed = model.model_validate(_document(payload))
    except ValidationError as error:
        return Refusal(sensor, *_reason(error, model), received_ns)
    except _UnreadableError as error:
        return Refusal(sensor, error.code, str(error), received_ns)
    values = tuple(getattr(parsed, name) for name in QUANTITIES[kind])
    return SampleMessage(
        SensorSample(sensor, values, parsed.seq, received_ns, parsed.sender), _nanoseconds(parsed.stamp)
    )


def encode_sample(
    values: Mapping[str, SupportsFloat | None],
    *,
    sequence: SupportsIndex | None = None,
    stamp: float | None = None,
    sender: str | None = None,
) -> bytes:
    """What a sensor puts on `sensor/<name>`; the names of the values tell its kind. Raises like `encode_twist`."""
    told = {key for key, value in values.items() if value is not None}
    kinds = [kind for kind, names in QUANTITIES.items() if told and told <= set(names)]
    if not kinds:
        names = "; ".join(", ".join(names) for names in QUANTITIES.values())
        raise ValueError(f"{', '.join(sorted(map(_shown, told))) or 'nothing'}: a sample is of one of: {names}")
    document = {key: _number(key, value) for key, value in values.items() if value is not None}
    sent = {"seq": None if sequence is None else index(sequence), "stamp": stamp, "sender": sender}
    return _checked(document | {key: value for key, value in sent.items() if value is not None}, _SAMPLES[kinds[0]])


def parse_reference(payload: bytes) -> Reference | str:
    """What the payload of a `cmd/reference` says, or what is wrong with it. Total: no payload raises."""
    try:
        parsed = _ReferencePayload.model_validate(_document(payload))
    except ValidationError as error:
        return _reason(error, _ReferencePayload)[1]
    except _UnreadableError as error:
        return str(error)
    return Reference(parsed.motor, parsed.angle)


def encode_reference(motor: str | None, angle: SupportsFloat) -> bytes:
    """Payload of a `cmd/reference`. Raises like `encode_twist`."""
    return _checked({"motor": motor, "angle": _number("angle", angle)}, _ReferencePayload)


def parse_setting(payload: bytes) -> SettingChange | str:
    """What the payload of a `cmd/set` says, or what is wrong with it. Total: no payload raises."""
    try:
        document = _document(payload)
        key = objection(str(document.get("setting"))) if isinstance(document, dict) else None
        if key is not None:
            return key
        parsed = _SettingPayload.model_validate(document)
    except ValidationError as error:
        return _reason(error, _SettingPayload)[1]
    except _UnreadableError as error:
        return str(error)
    return SettingChange(parsed.setting, parsed.value)


def encode_setting(setting: str, value: SupportsFloat) -> bytes:
    """Payload of a `cmd/set`. Raises like `encode_twist`, and ValueError for a key of the robot file."""
    key = objection(setting)
    if key is not None:
        raise ValueError(key)
    return _checked({"setting": setting, "value": _number("value", value)}, _SettingPayload)


def parse_mark(payload: bytes) -> Mark | str:
    """The words of a `cmd/mark`, or what is wrong with them. Total: no payload raises."""
    try:
        parsed = _MarkPayload.model_validate(_document(payload))
    except ValidationError as error:
        return _reason(error, _MarkPayload)[1]
    except _UnreadableError as error:
        return str(error)
    return Mark(parsed.text)


def encode_mark(text: str) -> bytes:
    """Payload of a `cmd/mark`. Raises ValueError, naming the range."""
    return _checked({"text": text}, _MarkPayload)


def encode_odometry(odometry: Odometry, now_ns: int) -> bytes:
    """Payload of `odometry`."""
    twist = odometry.twist._asdict() if odometry.twist else dict.fromkeys(Twist._fields)
    rest = {"covariance": odometry.covariance, "residual": odometry.residual}
    return _json({"t": now_ns / 1e9} | odometry.pose._asdict() | twist | rest)


def encode_state(status: Status, now_ns: int, extras: Mapping[str, object]) -> bytes:
    """Payload of `state` and answer of `status`."""
    return _state_json(StateMessage(now_ns / 1e9, status, dict(extras)))


def state_document(state: StateMessage) -> dict[str, object]:
    """A received state as it was on the wire, for whoever passes it on."""
    document: dict[str, object] = from_json(_state_json(state))
    return document


def _state_json(state: StateMessage) -> bytes:
    return _json({"t": state.t} | state.status._asdict() | {"extras": state.extras})


def encode_ability(ability: AbilityStatus, now_ns: int) -> bytes:
    """Payload of `reachable`."""
    twists = {
        "reachable": [twist._asdict() for twist in ability.reachable],
        "lost": [twist._asdict() for twist in ability.lost],
    }
    return _json({"t": now_ns / 1e9} | ability._asdict() | twists)


def decode_ability(payload: bytes) -> AbilityMessage | None:
    """Inverse of `encode_ability`."""
    try:
        document = from_json(payload)
        return _ABILITY.validate_python({"t": document.pop("t"), "ability": document})
    except (ValueError, KeyError, AttributeError, TypeError):  # no JSON, no such keys, no object
        return None


def encode_event(event: Event, now_ns: int) -> bytes:
    """Payload of `event`."""
    return _json(EventMessage(now_ns / 1e9, *event))


def encode_truth(pose: Pose, t: float) -> bytes:
    """Payload of `truth`."""
    return _json(TruthMessage(t, *pose))


def encode_reply(reply: Reply) -> bytes:
    """Answer of whatever is asked under `cmd/`."""
    return _json(ResetAnswer(reply.ok, reply.reason))


def decode_odometry(payload: bytes) -> OdometryMessage | None:
    """The odometry in a payload; None if it is none. So for the other decoders."""
    return _decoded(_ODOMETRY, payload)


def decode_state(payload: bytes) -> StateMessage | None:
    """Inverse of `encode_state`."""
    try:
        document = from_json(payload)
        t, extras = document.pop("t"), document.pop("extras")
        return _STATE.validate_python({"t": t, "status": document, "extras": extras})
    except (ValueError, KeyError, AttributeError, TypeError):  # no JSON, no such keys, no object
        return None


def decode_event(payload: bytes) -> EventMessage | None:
    """Inverse of `encode_event`."""
    return _decoded(_EVENT, payload)


def decode_truth(payload: bytes) -> TruthMessage | None:
    """Inverse of `encode_truth`."""
    return _decoded(_TRUTH, payload)


def decode_reply(payload: bytes) -> ResetAnswer | None:
    """Inverse of `encode_reply`."""
    return _decoded(_RESET, payload)


class _UnreadableError(ValueError):
    def __init__(self, code: RefusalCode, text: str) -> None:
        super().__init__(text)
        self.code = code


def _document(payload: bytes) -> object:
    if len(payload) > MAX_PAYLOAD:
        text = f"payload of {len(payload)} bytes: must be at most {MAX_PAYLOAD} bytes"
        raise _UnreadableError(RefusalCode.TOO_LONG, text)
    try:
        document: object = json.loads(payload.decode(), object_pairs_hook=_unique)
    except (ValueError, RecursionError) as error:
        text = f"payload: must be a JSON object in UTF-8: {str(error)[:80]}"
        raise _UnreadableError(RefusalCode.MALFORMED, text) from None
    return document


def _nanoseconds(stamp: float | None) -> int | None:
    return None if stamp is None else round(stamp * 1e9)


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    document = dict(pairs)
    if len(document) != len(pairs):
        raise ValueError("a key is given twice")
    return document


def _reason(error: ValidationError, payload: type[BaseModel]) -> tuple[RefusalCode, str]:
    first = error.errors(include_url=False, include_context=False)[0]
    key = str(first["loc"][0]) if first["loc"] else ""
    if key not in payload.model_fields:
        what = f"unknown key {_shown(key)}" if key else "payload"
        keys = sorted(payload.model_fields, key=lambda name: name in _SentPayload.model_fields)  # its own first
        return RefusalCode.MALFORMED, f"{what}: must be a JSON object of {', '.join(keys)}"
    if first["type"] == "missing":
        return RefusalCode.MALFORMED, f"{key} is missing: must be {_ALLOWED[key]}"
    code = RefusalCode.WRONG_FRAME if key == "frame" else _CODES.get(first["type"], RefusalCode.MALFORMED)
    return code, f"{key} = {_shown(first['input'])}: must be {_ALLOWED[key]}"


def _number(key: str, value: SupportsFloat) -> float:
    if isinstance(value, bool) or not isinstance(value, SupportsFloat):
        raise TypeError(f"{key} = {_shown(value)}: must be {_ALLOWED[key]}")
    try:
        return float(value)
    except OverflowError:  # a whole number or a fraction beyond what a float can hold
        return inf


def _checked(document: Mapping[str, object], payload: type[BaseModel]) -> bytes:
    """The document on the wire. Raises ValueError where it is none of this kind."""
    try:
        payload.model_validate(document)
    except ValidationError as error:
        raise ValueError(_reason(error, payload)[1]) from None
    return _json(document)


def _shown(value: object) -> str:
    """A stranger's value, short and in ASCII; containers only by their kind, because they may be deeply nested."""
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    text = ascii(value)
    return text if len(text) <= MAX_SHOWN else text[:MAX_SHOWN] + "..."


def _json(document: object) -> bytes:
    return to_json(_plain(document), inf_nan_mode="null", fallback=_foreign)


def _foreign(value: object) -> object:
    """A number of another library as a number, everything else as text."""
    return float(value) if isinstance(value, SupportsFloat) else str(value)


def _plain(value: object) -> object:
    """Named tuples as objects, enums as their words; text that is no Unicode (file names) with replacements."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, str):
        return value if value.isascii() else value.encode(errors="replace").decode()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return _plain(value._asdict())
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return value


def _decoded(adapter: TypeAdapter[_T], payload: bytes) -> _T | None:
    try:
        return adapter.validate_json(payload)
    except ValidationError:
        return None

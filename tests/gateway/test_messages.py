"""Payloads: what is a command, what is refused and in which words, and that encoders and decoders agree."""

import json
import math
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.edges import messages
from gateway.edges.messages import EventMessage, OdometryMessage, ResetAnswer, TruthMessage, parse_twist
from gateway.types import (
    ZERO_TWIST,
    AbilityStatus,
    EffectiveMotors,
    Event,
    Level,
    Mode,
    MotorStatus,
    Odometry,
    Pose,
    Refusal,
    RefusalCode,
    Region,
    Reply,
    SlipStatus,
    SourceStatus,
    Status,
    Twist,
    TwistCommand,
    TwistFrame,
)

JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)
KEYS = st.sampled_from(["vx", "vy", "wz", "frame", "seq", "stamp", "sender"]) | st.text(max_size=8)
MOTOR = MotorStatus(
    name="left",
    state="closed loop",
    commanded=1.5,
    measured=None,
    torque=0.25,
    voltage=24.0,
    temperature_c=None,
    fault=None,
    age_s=0.004,
)
STATUS = Status(
    mode=Mode.DEGRADED,
    reason="motor right is lost",
    faults=("right: over-temperature",),
    winner="teleop",
    winner_age_s=0.02,
    sources=(SourceStatus("teleop", 0.02, None), SourceStatus("autonomy", None, "never heard")),
    motors=(MOTOR, MOTOR._replace(name="right", fault="over-temperature")),
    limits_active=("acceleration",),
    stop_category=1,
    standing=None,
    pose=Pose(1.0, 2.0, 0.5),
    twist=None,
    refused=3,
    tx_dropped=0,
    overruns=1,
    dropped_records=0,
    cycle=17,
    ability=AbilityStatus(
        2,
        0.5,
        0.3,
        (Twist(0.3, 0.0, 0.0), Twist(0.0, 0.3, 0.1)),
        (Twist(0.0, 0.0, 1.0),),
        EffectiveMotors((2.0, 1.5), (1.0, 0.0)),
    ),
    chassis={"region": "pull", "turn_radius": None},
    slip=SlipStatus(slipping=True, wheels=("left",), evidence=("torque",), threshold=0.01, tells="that a wheel slips"),
)


def _parse(payload: bytes) -> TwistCommand | Refusal:
    outcome = parse_twist(payload, source="teleop", received_ns=5)
    return outcome if isinstance(outcome, Refusal) else outcome.command


def _refusal(payload: bytes) -> Refusal:
    outcome = _parse(payload)
    assert isinstance(outcome, Refusal)
    assert (outcome.source, outcome.received_ns) == ("teleop", 5)
    return outcome


def test_a_full_twist() -> None:
    expected = TwistCommand("teleop", Twist(1.0, -0.5, 0.25), TwistFrame.ODOM, 7, 5)
    assert _parse(b'{"vx": 1, "vy": -0.5, "wz": 0.25, "frame": "odom", "seq": 7}') == expected


def test_what_only_some_chassis_can_do() -> None:
    sent = messages.encode_twist(Twist(1.0, 0.0, 0.0), width_rate=-0.5, path_rate=2, region=Region.PULL)
    expected = TwistCommand("teleop", Twist(1.0, 0.0, 0.0), TwistFrame.BODY, None, 5)
    assert _parse(sent) == expected._replace(width_rate=-0.5, path_rate=2.0, region=Region.PULL)
    sent = messages.encode_twist(Twist(1.0, 0.0, 0.0), width=0.4)
    assert _parse(sent) == expected._replace(width=0.4)
    with pytest.raises(ValueError, match=r"width = 0.4: must be .* the only one of width and width_rate"):
        messages.encode_twist(Twist(1.0, 0.0, 0.0), width=0.4, width_rate=0.0)
    with pytest.raises(ValueError, match=r"width_rate = 6.0: must be a number from -5 to 5 m/s"):
        messages.encode_twist(Twist(1.0, 0.0, 0.0), width_rate=6)


def test_frame_and_sequence_are_optional() -> None:
    assert _parse(b'{"vx":0,"vy":0,"wz":0}') == TwistCommand("teleop", ZERO_TWIST, TwistFrame.BODY, None, 5)


@pytest.mark.parametrize("edge", [20.0, -20.0])
def test_the_ranges_include_their_ends(edge: float) -> None:
    outcome = _parse(json.dumps({"vx": edge, "vy": edge, "wz": 2.5 * edge}).encode())
    assert isinstance(outcome, TwistCommand)
    assert outcome.twist == Twist(edge, edge, 2.5 * edge)


@pytest.mark.parametrize(
    ("payload", "code", "text"),
    [
        (b'{"vx":NaN,"vy":0,"wz":0}', "NOT_FINITE", "vx = nan: must be a number from -20 to 20 m/s"),
        (b'{"vx":0,"vy":-Infinity,"wz":0}', "NOT_FINITE", "vy = -inf: must be a number from -20 to 20 m/s"),
        (b'{"vx":0,"vy":0,"wz":1e999}', "NOT_FINITE", "wz = inf: must be a number from -50 to 50 rad/s"),
        (b'{"vx":20.001,"vy":0,"wz":0}', "OUT_OF_RANGE", "vx = 20.001: must be a number from -20 to 20 m/s"),
        (b'{"vx":0,"vy":0,"wz":-51}', "OUT_OF_RANGE", "wz = -51: must be a number from -50 to 50 rad/s"),
        (b'{"vx":0,"vy":0,"wz":0,"seq":-1}', "OUT_OF_RANGE", "seq = -1: must be a whole number from 0 to 2^63-1"),
        (b'{"vx":0,"vy":0,"wz":0,"frame":"map"}', "WRONG_FRAME", "frame = 'map': must be 'body' or 'odom'"),
        (b'{"vx":0,"vy":0,"wz":0,"frame":null}', "WRONG_FRAME", "frame = None: must be 'body' or 'odom'"),
        (b'{"vx":0,"vy":0,"wz":0,"frame":"\\ud800"}', "WRONG_FRAME", "frame = '\\ud800': must be 'body' or 'odom'"),
        (b'{"vx":0,"vy":0,"wz":0,"path_rate":51}', "OUT_OF_RANGE", "path_rate = 51: must be a number from -50 to 50"),
        (b'{"vx":0,"vy":0,"wz":0,"width":-0.1}', "OUT_OF_RANGE", "width = -0.1: must be a number from 0 to 10 m"),
        (
            b'{"vx":0,"vy":0,"wz":0,"width":0.4,"width_rate":0.1}',
            *("MALFORMED", "width = 0.4: must be a number from 0 to 10 m, and the only one of width and width_rate"),
        ),
        (b'{"vx":0,"vy":0,"wz":0,"width_rate":NaN}', "NOT_FINITE", "width_rate = nan: must be a number from -5 to 5"),
        (b'{"vx":0,"vy":0,"wz":0,"region":"up"}', "MALFORMED", "region = 'up': must be 'any', 'push' or 'pull'"),
        (b'{"vx":"1","vy":0,"wz":0}', "MALFORMED", "vx = '1': must be a number from -20 to 20 m/s"),
        (b'{"vx":true,"vy":0,"wz":0}', "MALFORMED", "vx = True: must be a number from -20 to 20 m/s"),
        (b'{"vx":[[]],"vy":0,"wz":0}', "MALFORMED", "vx = a list: must be a number from -20 to 20 m/s"),
        (b'{"vx":0,"vy":0}', "MALFORMED", "wz is missing: must be a number from -50 to 50 rad/s"),
        (b'{"vx":0,"vy":0,"wz":0,"seq":1.5}', "MALFORMED", "seq = 1.5: must be a whole number from 0 to 2^63-1"),
        (b'{"vx":0,"vy":0,"wz":0,"stamp":-0.1}', "OUT_OF_RANGE", "stamp = -0.1: must be a number from 0 to 1e+10 s"),
        (b'{"vx":0,"vy":0,"wz":0,"stamp":1e308}', "OUT_OF_RANGE", "stamp = 1e+308: must be a number from 0 to 1e+10 s"),
        (b'{"vx":0,"vy":0,"wz":0,"stamp":NaN}', "NOT_FINITE", "stamp = nan: must be a number from 0 to 1e+10 s"),
        (b'{"vx":0,"vy":0,"wz":0,"stamp":"1"}', "MALFORMED", "stamp = '1': must be a number from 0 to 1e+10 s"),
        (b'{"vx":0,"vy":0,"wz":0,"sender":""}', "MALFORMED", "sender = '': must be text that matches"),
        (b'{"vx":0,"vy":0,"wz":0,"sender":"a#1"}', "MALFORMED", "sender = 'a#1': must be text that matches"),
        (b'{"vx":0,"vy":0,"wz":0,"sender":"a\\n"}', "MALFORMED", "sender = 'a\\n': must be text that matches"),
        (b'{"vx":0,"vy":0,"wz":0,"sender":"%s"}' % (b"a" * 33), "MALFORMED", "must be text that matches"),
        (b'{"vx":0,"vy":0,"wz":0,"sender":7}', "MALFORMED", "sender = 7: must be text that matches"),
        (b'{"vx":0,"vy":0,"wz":0,"vz":0}', "MALFORMED", "unknown key 'vz': must be a JSON object of vx, vy, wz"),
        (b'{"vx":0,"vx":1,"vy":0,"wz":0}', "MALFORMED", "a key is given twice"),
        (b"[1,2,3]", "MALFORMED", "payload: must be a JSON object of vx, vy, wz"),
        (b"", "MALFORMED", "payload: must be a JSON object in UTF-8"),
        (b'\xff{"vx":0}', "MALFORMED", "payload: must be a JSON object in UTF-8"),
        (b"[" * 1024, "MALFORMED", "payload: must be a JSON object in UTF-8"),
        (b" " * 1025, "TOO_LONG", "payload of 1025 bytes: must be at most 1024 bytes"),
    ],
)
def test_what_is_refused_and_in_which_words(payload: bytes, code: str, text: str) -> None:
    refusal = _refusal(payload)
    assert refusal.code is RefusalCode[code]
    assert text in refusal.text


def test_a_strangers_value_is_shown_short_and_in_ascii() -> None:
    refusal = _refusal(json.dumps({"vx": "\u00e9" * 100, "vy": 0, "wz": 0}).encode())
    assert refusal.text.isascii()
    assert len(refusal.text) < 100


@given(st.binary(max_size=1100))
def test_no_bytes_raise(payload: bytes) -> None:
    outcome = _parse(payload)
    assert isinstance(outcome, Refusal)
    assert isinstance(messages.parse_reference(payload), str)


@given(st.dictionaries(KEYS, JSON_VALUES, max_size=6))
def test_no_json_raises_and_only_finite_twists_in_range_pass(document: dict[str, object]) -> None:
    messages.parse_reference(json.dumps(document).encode())
    outcome = _parse(json.dumps(document).encode())
    if isinstance(outcome, Refusal):
        assert outcome.text.isascii()
        return
    assert abs(outcome.twist.vx) <= 20.0
    assert abs(outcome.twist.vy) <= 20.0
    assert abs(outcome.twist.wz) <= 50.0


@given(
    twist=st.builds(Twist, st.floats(-20, 20), st.floats(-20, 20), st.floats(-50, 50)),
    frame=st.sampled_from(TwistFrame),
    sequence=st.none() | st.integers(0, messages.MAX_SEQUENCE),
)
def test_a_twist_survives_the_wire(twist: Twist, frame: TwistFrame, sequence: int | None) -> None:
    payload = messages.encode_twist(twist, frame=frame, sequence=sequence)
    assert parse_twist(payload, source="teleop", received_ns=5) == (
        TwistCommand("teleop", twist, frame, sequence, 5),
        None,
    )


@given(st.floats(0.0, messages.MAX_STAMP), st.from_regex(messages.SENDER_PATTERN, fullmatch=True))
def test_stamp_and_sender_survive_the_wire(stamp: float, sender: str) -> None:
    sender = sender.rstrip("\n")  # Python's $ lets one pass
    payload = messages.encode_twist(ZERO_TWIST, stamp=stamp, sender=sender)
    message = parse_twist(payload, source="teleop", received_ns=5)
    assert not isinstance(message, Refusal)
    assert message.command == TwistCommand("teleop", ZERO_TWIST, TwistFrame.BODY, None, 5, sender)
    assert message.stamp_ns == pytest.approx(stamp * 1e9, abs=1000)


@pytest.mark.parametrize(
    "number", [0.5, np.float32(0.5), np.float64(0.5), np.float16(0.5), Decimal("0.5"), Fraction(1, 2)], ids=repr
)
def test_every_kind_of_number_travels_as_a_number(number: SupportsFloat) -> None:
    outcome = _parse(messages.encode_twist((number, 1, np.int64(2)), sequence=np.uint8(3)))
    assert outcome == TwistCommand("teleop", Twist(0.5, 1.0, 2.0), TwistFrame.BODY, 3, 5)


def test_a_foreign_number_elsewhere_travels_as_a_number_too() -> None:
    payload = messages.encode_state(STATUS, 0, {"load": np.float32(0.5), "cores": np.int64(2), "path": Path("/a")})
    assert json.loads(payload)["extras"] == {"load": 0.5, "cores": 2.0, "path": "/a"}


@pytest.mark.parametrize(
    ("twist", "words"),
    [
        ((math.nan, 0, 0), "vx = nan: must be a number from -20 to 20 m/s"),
        ((0, np.float32("inf"), 0), "vy = inf: must be a number from -20 to 20 m/s"),
        ((0, 0, -math.inf), "wz = -inf: must be a number from -50 to 50 rad/s"),
        ((100, 0, 0), "vx = 100.0: must be a number from -20 to 20 m/s"),
        ((0, 0, 10**400), "wz = inf: must be a number from -50 to 50 rad/s"),
    ],
)
def test_what_no_robot_takes_is_not_sent(twist: tuple[SupportsFloat, SupportsFloat, SupportsFloat], words: str) -> None:
    with pytest.raises(ValueError, match=f"^{words}$"):
        messages.encode_twist(twist)


@pytest.mark.parametrize("wrong", ["1", None, True, 1j], ids=repr)
def test_what_is_no_number_is_a_mistake(wrong: Any) -> None:  # noqa: ANN401
    with pytest.raises(TypeError, match=r"^vy = .*: must be a number from -20 to 20 m/s"):
        messages.encode_twist((0.0, wrong, 0.0))


def test_a_reference_survives_the_wire() -> None:
    assert messages.parse_reference(messages.encode_reference("platform", np.float32(0.5))) == ("platform", 0.5)
    assert messages.parse_reference(messages.encode_reference(None, 0)) == (None, 0.0)
    assert messages.parse_reference(b"{}") == (None, 0.0)


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "payload: must be a JSON object in UTF-8"),
        (b"0.5", "payload: must be a JSON object of motor, angle"),
        (b'{"angle": 6.4}', "angle = 6.4: must be a number from -6.3 to 6.3 rad"),
        (b'{"angle": NaN}', "angle = nan: must be a number from -6.3 to 6.3 rad"),
        (b'{"angle": null}', "angle = None: must be a number from -6.3 to 6.3 rad"),
        (b'{"motor": "a/b"}', "motor = 'a/b': must be the name of a motor"),
        (b'{"vx": 0}', "unknown key 'vx': must be a JSON object of motor, angle"),
        (b" " * 1025, "payload of 1025 bytes"),
    ],
)
def test_a_wrong_reference_is_refused_in_words(payload: bytes, words: str) -> None:
    refusal = messages.parse_reference(payload)
    assert isinstance(refusal, str)
    assert words in refusal


def test_a_wrong_reference_is_not_sent() -> None:
    with pytest.raises(ValueError, match=r"angle = 7\.0: must be a number from -6\.3 to 6\.3 rad"):
        messages.encode_reference(None, 7)
    with pytest.raises(ValueError, match="motor = 'A': must be the name of a motor"):
        messages.encode_reference("A", 0)


def test_odometry_on_the_wire() -> None:
    odometry = Odometry(Pose(1.0, 2.0, 0.5), Twist(0.1, 0.2, 0.3), tuple(float(i) for i in range(9)), 0.01)
    payload = messages.encode_odometry(odometry, 1_500_000_000)
    assert json.loads(payload) == {
        "t": 1.5,
        "x": 1.0,
        "y": 2.0,
        "theta": 0.5,
        "vx": 0.1,
        "vy": 0.2,
        "wz": 0.3,
        "covariance": [0, 1, 2, 3, 4, 5, 6, 7, 8],
        "residual": 0.01,
    }
    assert messages.decode_odometry(payload) == OdometryMessage(
        1.5, 1.0, 2.0, 0.5, 0.1, 0.2, 0.3, odometry.covariance, 0.01
    )


def test_unknown_is_null_and_so_is_what_no_json_can_hold() -> None:
    odometry = Odometry(Pose(0.0, 0.0, 0.0), None, (0.0,) * 9, math.nan)
    document = json.loads(messages.encode_odometry(odometry, 0))
    assert [document[key] for key in ("vx", "vy", "wz", "residual")] == [None] * 4


def test_state_on_the_wire_is_the_status_in_words() -> None:
    payload = messages.encode_state(STATUS, 2_000_000_000, {"recording": {"healthy": True}})
    document = json.loads(payload)
    assert document["t"] == 2.0
    assert document["mode"] == "degraded"
    assert document["motors"][1]["fault"] == "over-temperature"
    assert document["sources"][1] == {"name": "autonomy", "age_s": None, "reason": "never heard"}
    assert document["extras"] == {"recording": {"healthy": True}}
    assert set(document) == {"t", "extras", *Status._fields}


def test_a_received_state_is_passed_on_as_it_was() -> None:
    payload = messages.encode_state(STATUS, 2_000_000_000, {"disk": 5})
    received = messages.decode_state(payload)
    assert received is not None
    assert messages.state_document(received) == json.loads(payload)


def test_state_survives_the_wire() -> None:
    message = messages.decode_state(messages.encode_state(STATUS, 2_000_000_000, {"disk": 5}))
    assert message == (2.0, STATUS, {"disk": 5})


def test_event_reply_and_truth_survive_the_wire() -> None:
    event = messages.encode_event(Event(Level.WARNING, "slip", "wheel left slips"), 500_000_000)
    assert messages.decode_event(event) == EventMessage(0.5, Level.WARNING, "slip", "wheel left slips")
    reply = messages.encode_reply(Reply(4, False, "motor left has a fault"))
    assert json.loads(reply) == {"ok": False, "reason": "motor left has a fault"}
    assert messages.decode_reply(reply) == ResetAnswer(False, "motor left has a fault")
    truth = messages.encode_truth(Pose(1.0, 2.0, 3.0), 0.25)
    assert messages.decode_truth(truth) == TruthMessage(0.25, 1.0, 2.0, 3.0)


def test_text_that_is_no_unicode_is_sent_with_replacements() -> None:
    event = messages.decode_event(messages.encode_event(Event(Level.INFO, "file", "bad name \udcff, h\u00f6he"), 0))
    assert event is not None
    assert event.text == "bad name ?, h\u00f6he"


@given(st.binary(max_size=200) | JSON_VALUES.map(lambda value: json.dumps(value).encode()))
def test_no_bytes_raise_in_a_decoder(payload: bytes) -> None:
    messages.decode_odometry(payload)
    messages.decode_state(payload)
    messages.decode_event(payload)
    messages.decode_truth(payload)
    messages.decode_reply(payload)


@pytest.mark.parametrize("payload", [b"", b"null", b"[]", b"{}", b'{"t":1}', b'{"t":1,"extras":{}}', b"[" * 10_000])
def test_a_decoder_answers_none_to_anything_else(payload: bytes) -> None:
    assert messages.decode_odometry(payload) is None
    assert messages.decode_state(payload) is None
    assert messages.decode_event(payload) is None
    assert messages.decode_truth(payload) is None
    assert messages.decode_reply(payload) is None

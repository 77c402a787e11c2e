"""Two sessions on loopback: what drives, what is refused, what is answered, and what happens at the end."""

import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Event as Flag
from threading import Thread
from typing import TypeVar

import numpy as np
import pytest
import zenoh
from zenoh.handlers import Callback

from gateway.client import Client
from gateway.config import ConfigError, RobotConfig, Sensor, parse
from gateway.edges.mailbox import MAX_QUESTIONS
from gateway.edges.messages import (
    AbilityMessage,
    EventMessage,
    OdometryMessage,
    ResetAnswer,
    StateMessage,
    TruthMessage,
    decode_ability,
    decode_reply,
    encode_event,
    encode_twist,
)
from gateway.edges.zenoh_link import NOT_EXACT, QUESTIONS, ZenohLink
from gateway.edges.zenoh_questions import NO_ANSWER, TOO_MANY
from gateway.edges.zenoh_session import LinkError, Receivers, open_zenoh
from gateway.types import (
    AbilityStatus,
    Event,
    Level,
    Mode,
    Odometry,
    Pose,
    Refusal,
    RefusalCode,
    Reply,
    Request,
    RequestKind,
    SensorKind,
    SensorSample,
    Status,
    Twist,
    TwistCommand,
    TwistFrame,
)
from tests.gateway.test_messages import STATUS

ROBOT_FILE = Path(__file__).parents[2] / "deploy" / "robots" / "moby.toml"  # sources teleop and autonomy
TIMEOUT_S = 10.0
TWIST = encode_twist(Twist(1.0, 0.0, 0.0))
ODOMETRY = Odometry(Pose(1.0, 2.0, 0.5), None, (0.0,) * 9, None)

_T = TypeVar("_T")


def eventually(probe: Callable[[], _T]) -> _T:
    """The first true answer of the probe; fails when none comes."""
    deadline = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline:
        if answer := probe():
            return answer
        time.sleep(0.002)
    pytest.fail("did not happen in time")


@dataclass
class Loop:
    """A stand-in for the control loop: collects what it drains."""

    link: ZenohLink
    commands: list[TwistCommand] = field(default_factory=list)
    refusals: list[Refusal] = field(default_factory=list)
    requests: list[Request] = field(default_factory=list)
    samples: list[SensorSample] = field(default_factory=list)

    def cycle(self) -> None:
        """One drain."""
        commands, refusals, requests, samples = self.link.drain(time.monotonic_ns())
        self.commands += commands
        self.refusals += refusals
        self.requests += requests
        self.samples += samples

    def until(self, probe: Callable[[], _T]) -> _T:
        """Cycles until the probe is true."""

        def cycled() -> _T:
            self.cycle()
            return probe()

        return eventually(cycled)


@pytest.fixture
def endpoint(free_port: int) -> str:
    return f"tcp/127.0.0.1:{free_port}"


@pytest.fixture
def link(endpoint: str) -> Iterator[ZenohLink]:
    with ZenohLink(_robot(endpoint), "# the robot file\n") as opened:
        yield opened


@pytest.fixture
def loop(link: ZenohLink) -> Loop:
    return Loop(link)


@pytest.fixture
def client(link: ZenohLink, endpoint: str) -> Iterator[Client]:
    with Client("moby", connect=[endpoint]) as opened:
        assert opened.wait_alive(TIMEOUT_S)
        yield opened


@pytest.fixture
def stranger(client: Client, endpoint: str) -> Iterator[zenoh.Session]:
    """A bare session that puts whatever it likes."""
    session = open_zenoh(listen=[], connect=[endpoint], max_message_size=1_000_000)
    with session:
        eventually(lambda: list(session.liveliness().get("moby/alive", timeout=0.1)))
        yield session


def _robot(endpoint: str) -> RobotConfig:
    return parse(ROBOT_FILE.read_text().replace("tcp/127.0.0.1:7447", endpoint), str(ROBOT_FILE))


def _one_refusal(loop: Loop) -> Refusal:
    loop.until(lambda: loop.refusals)
    assert not loop.commands
    assert len(loop.refusals) == 1
    return loop.refusals[0]


def test_a_command_arrives_with_its_arrival_time(loop: Loop, client: Client) -> None:
    before_ns = time.monotonic_ns()
    client.send_twist(0.5, -0.25, 0.125, source="teleop", frame=TwistFrame.ODOM, sequence=3)
    loop.until(lambda: loop.commands)
    command = loop.commands[0]
    assert command[:4] == ("teleop", Twist(0.5, -0.25, 0.125), TwistFrame.ODOM, 3)
    assert before_ns < command.received_ns <= time.monotonic_ns()
    assert command.sender is not None
    assert not command.stamped, "the first one cannot be judged"
    assert not loop.refusals


def test_the_client_stamps_its_commands_and_names_itself(loop: Loop, client: Client, endpoint: str) -> None:
    for count in (1, 2):
        client.send_twist(np.float32(0.5), 0, 0, source="teleop")
        loop.until(lambda count=count: len(loop.commands) == count)  # type: ignore[misc]
    first, second = loop.commands
    assert second.stamped
    assert second.twist == Twist(0.5, 0.0, 0.0)
    assert second.sender == first.sender
    with Client("moby", connect=[endpoint]) as other:
        assert other.wait_alive(TIMEOUT_S)
        other.send_twist(0.0, 0.0, 0.0, source="autonomy")
        loop.until(lambda: loop.commands[2:])
    assert loop.commands[2].sender != first.sender


@pytest.mark.parametrize("wrong", [float("nan"), 100.0])
def test_the_client_says_at_once_what_no_robot_takes(loop: Loop, client: Client, wrong: float) -> None:
    with pytest.raises(ValueError, match=r"^wz = .*: must be a number from -50 to 50 rad/s$"):
        client.send_twist(0.0, 0.0, wrong, source="teleop")
    client.send_twist(0.0, 0.0, 0.0, source="teleop", sequence=np.int64(7))
    loop.until(lambda: loop.commands)
    assert [command.sequence for command in loop.commands] == [7]
    assert not loop.refusals


def test_a_second_sender_is_refused_by_name(loop: Loop, client: Client, stranger: zenoh.Session) -> None:
    client.send_twist(0.0, 0.0, 0.0, source="teleop")
    loop.until(lambda: loop.commands)

    def refused() -> list[Refusal]:
        client.send_twist(0.0, 0.0, 0.0, source="teleop")
        stranger.put("moby/cmd/twist/teleop", TWIST)
        return loop.refusals

    loop.until(refused)
    assert loop.refusals[0].code is RefusalCode.SECOND_SENDER
    sender = loop.commands[0].sender
    assert f"a sender without a name: sender {sender} holds this source" in loop.refusals[0].text
    assert {command.sender for command in loop.commands} == {sender}


def test_the_client_counts(loop: Loop, client: Client) -> None:
    for expected in (1, 2):
        client.send_twist(0.0, 0.0, 0.0, source="teleop")
        loop.until(lambda count=expected: len(loop.commands) == count)  # type: ignore[misc]
    first, second = (command.sequence for command in loop.commands)
    assert first is not None
    assert second == first + 1


def test_a_slow_loop_does_not_get_stale_commands(loop: Loop, stranger: zenoh.Session) -> None:
    for sequence in range(200):
        payload = encode_twist(Twist(0.1, 0.0, 0.0), sequence=sequence)
        stranger.put("moby/cmd/twist/teleop", payload, congestion_control=zenoh.CongestionControl.BLOCK)
    waiting = loop.link._mailbox.commands["teleop"]
    eventually(lambda: waiting and waiting[0].sequence == 199)
    loop.cycle()
    assert [command.sequence for command in loop.commands] == [199]
    assert time.monotonic_ns() - loop.commands[0].received_ns < 1e9
    stranger.put("moby/cmd/twist/autonomy", TWIST)
    loop.until(lambda: loop.commands[1:])
    assert [command.source for command in loop.commands] == ["teleop", "autonomy"]


def test_a_slow_reader_gets_the_newest_and_holds_up_nobody(endpoint: str) -> None:
    receivers = Receivers(open_zenoh(listen=[endpoint], connect=[], max_message_size=1000))
    reading, go_on, seen, others = Flag(), Flag(), list[bytes](), list[bytes]()

    def read_slowly(sample: zenoh.Sample) -> None:
        reading.set()
        assert go_on.wait(TIMEOUT_S)
        seen.append(sample.payload.to_bytes())

    receivers.subscribe("slow", read_slowly)
    receivers.subscribe("other", lambda sample: others.append(sample.payload.to_bytes()))
    with open_zenoh(listen=[], connect=[endpoint], max_message_size=1000) as session:

        def first_is_read() -> bool:
            session.put("slow", b"first")
            return reading.wait(0.05)

        eventually(first_is_read)
        for count in range(500):
            session.put("slow", str(count).encode(), congestion_control=zenoh.CongestionControl.BLOCK)
        session.put("other", b"not held up")
        eventually(lambda: others)
        go_on.set()
        eventually(lambda: len(seen) == 2)
    receivers.close()
    assert seen == [b"first", b"499"]


def test_a_stop_arrives_while_commands_flood(loop: Loop, client: Client, stranger: zenoh.Session) -> None:
    done = Flag()

    def flood() -> None:
        while not done.is_set():
            stranger.put("moby/cmd/twist/teleop", TWIST, congestion_control=zenoh.CongestionControl.BLOCK)

    flooding = Thread(target=flood)
    flooding.start()
    try:
        loop.until(lambda: loop.commands)
        sent_ns = time.monotonic_ns()
        assert not client.stop(timeout=0.0)
        loop.until(lambda: loop.requests)
    finally:
        done.set()
        flooding.join()
    assert loop.requests[0].kind is RequestKind.ESTOP
    assert loop.requests[0].received_ns - sent_ns < 1e9


@pytest.mark.parametrize(
    "key", ["moby/cmd/stop", "moby/cmd/*", "**", "*/cmd/stop", "moby/**"], ids=lambda key: key.replace("*", "x")
)
@pytest.mark.parametrize("put", [True, False], ids=["put", "delete"])
def test_whatever_reaches_the_stop_key_stops(loop: Loop, stranger: zenoh.Session, key: str, put: bool) -> None:
    if put:
        stranger.put(key, b"\xff" * 2000)
    else:
        stranger.delete(key)
    loop.until(lambda: loop.requests)
    assert loop.requests[0].kind is RequestKind.ESTOP
    assert loop.requests[0].id == 0


@pytest.mark.parametrize(
    "key",
    ["moby/cmd/twist/*", "*/cmd/twist/*", "moby/*/twist/teleop", "moby/cmd/twist/tele$*", "moby/cmd/**", "**"],
    ids=lambda key: key.replace("*", "x"),
)
def test_a_wildcard_never_drives(loop: Loop, stranger: zenoh.Session, key: str) -> None:
    stranger.put(key, TWIST)
    loop.until(lambda: loop.refusals)
    assert loop.refusals[0].code is RefusalCode.KEY_NOT_EXACT
    assert key in loop.refusals[0].text
    for source in ("teleop", "autonomy"):  # comes after the wildcard in the same ring
        stranger.put(f"moby/cmd/twist/{source}", encode_twist(Twist(0.0, 0.0, 0.0), sequence=1))
    loop.until(lambda: len(loop.commands) >= 2)
    assert [command.sequence for command in loop.commands] == [1, 1]


@pytest.mark.parametrize("key", ["moby/cmd/twist/teleop", "moby/cmd/twist/*"], ids=["exact", "wildcard"])
def test_a_delete_is_refused(loop: Loop, stranger: zenoh.Session, key: str) -> None:
    stranger.delete(key)
    refusal = _one_refusal(loop)
    assert refusal.code is RefusalCode.NOT_A_PUT
    assert "must be a put" in refusal.text


@pytest.mark.parametrize(
    ("payload", "code"),
    [
        (b" " * 2000, RefusalCode.TOO_LONG),
        (b"hello", RefusalCode.MALFORMED),
        (b'{"vx":NaN,"vy":0,"wz":0}', RefusalCode.NOT_FINITE),
    ],
)
def test_a_bad_payload_is_refused(loop: Loop, stranger: zenoh.Session, payload: bytes, code: RefusalCode) -> None:
    stranger.put("moby/cmd/twist/teleop", payload)
    refusal = _one_refusal(loop)
    assert (refusal.source, refusal.code) == ("teleop", code)


def test_a_huge_message_is_dropped_and_the_link_lives_on(loop: Loop, client: Client, stranger: zenoh.Session) -> None:
    stranger.put("moby/cmd/twist/teleop", b" " * 500_000)
    client.send_twist(0.0, 0.0, 0.0, source="teleop")
    loop.until(lambda: loop.commands)
    assert not loop.refusals


@pytest.mark.parametrize("rest", ["twist/ghost", "dance", "reset", "twist/teleop/more"])
def test_an_unknown_source_is_refused(loop: Loop, stranger: zenoh.Session, rest: str) -> None:
    stranger.put(f"moby/cmd/{rest}", TWIST)
    refusal = _one_refusal(loop)
    assert refusal.code is RefusalCode.UNKNOWN_SOURCE
    assert refusal.text == f"put on moby/cmd/{rest}: the sources are teleop, autonomy"
    assert refusal.source == "a stranger", "whatever its key was: what is kept by name must not grow with keys"


def test_an_old_sequence_is_refused(loop: Loop, client: Client) -> None:
    client.send_twist(0.0, 0.0, 0.0, source="teleop", sequence=5)
    client.send_twist(0.1, 0.0, 0.0, source="autonomy", sequence=5)  # each source counts for itself
    loop.until(lambda: len(loop.commands) == 2)
    client.send_twist(1.0, 0.0, 0.0, source="autonomy", sequence=5)
    loop.until(lambda: loop.refusals)
    assert (loop.refusals[0].source, loop.refusals[0].code) == ("autonomy", RefusalCode.OLD_SEQUENCE)
    assert len(loop.commands) == 2


@pytest.fixture
def sensing(endpoint: str) -> Iterator[Loop]:
    robot = _robot(endpoint)
    sensors = [
        Sensor(name="imu", kind=SensorKind.HEADING, timeout=0.5),
        Sensor(name="nose", kind=SensorKind.RANGE, timeout=0.5),
    ]
    with ZenohLink(robot.model_copy(update={"sensor": sensors}), "") as opened:
        yield Loop(opened)


def test_samples_arrive_the_newest_of_each_sensor(sensing: Loop, endpoint: str) -> None:
    with Client("moby", connect=[endpoint]) as client:
        assert client.wait_alive(TIMEOUT_S)
        before_ns = time.monotonic_ns()
        for heading in (1.0, 2.0):
            client.sense("imu", heading=np.float32(heading))
        client.sense("nose", range=0.5)
        slots = sensing.link._mailbox.samples
        eventually(lambda: slots["nose"] and slots["imu"] and slots["imu"][0].values == (2.0,))
        sensing.cycle()
    assert [(one.source, one.values) for one in sensing.samples] == [("imu", (2.0,)), ("nose", (0.5,))]
    assert all(before_ns < one.received_ns <= time.monotonic_ns() for one in sensing.samples)
    assert not sensing.refusals
    assert not sensing.commands


@pytest.mark.parametrize(
    ("key", "payload", "code", "words"),
    [
        ("moby/sensor/imu", b'{"heading":1e7}', RefusalCode.OUT_OF_RANGE, "heading = 10000000.0: must be a number"),
        ("moby/sensor/imu", b'{"heading":NaN}', RefusalCode.NOT_FINITE, "heading = nan: must be a number"),
        ("moby/sensor/imu", b'{"range":1}', RefusalCode.MALFORMED, "heading is missing: must be a number from"),
        ("moby/sensor/nose", b'{"range":-0.1}', RefusalCode.OUT_OF_RANGE, "range = -0.1: must be a number from 0 to"),
        ("moby/sensor/imu", b" " * 2000, RefusalCode.TOO_LONG, "must be at most 1024 bytes"),
        ("moby/sensor/imu", None, RefusalCode.NOT_A_PUT, "must be a put"),
        ("moby/sensor/tail", b'{"range":1}', RefusalCode.UNKNOWN_SENSOR, "the sensors are imu, nose"),
        ("moby/sensor/*", b'{"heading":1}', RefusalCode.KEY_NOT_EXACT, "without wildcards"),
        ("moby/**", b'{"heading":1}', RefusalCode.KEY_NOT_EXACT, "without wildcards"),
    ],
)
def test_a_sample_that_is_none_is_refused_once(
    sensing: Loop, endpoint: str, *, key: str, payload: bytes | None, code: RefusalCode, words: str
) -> None:
    with open_zenoh(listen=[], connect=[endpoint], max_message_size=1_000_000) as stranger:
        eventually(lambda: list(stranger.liveliness().get("moby/alive", timeout=0.1)))
        stranger.delete(key) if payload is None else stranger.put(key, payload)
        sensing.until(lambda: sensing.refusals)
        stranger.put("moby/sensor/nose", b'{"range":1}')
        sensing.until(lambda: [one for one in sensing.samples if one.values == (1.0,)])
    assert [one.code for one in sensing.refusals] == [code]
    assert words in sensing.refusals[0].text
    assert [one.source for one in sensing.samples] == ["nose"]


@pytest.mark.parametrize(
    ("payload", "code"),
    [
        (b'{"heading":0,"seq":6,"sender":"b"}', RefusalCode.SECOND_SENDER),
        (b'{"heading":0,"seq":5,"sender":"a"}', RefusalCode.OLD_SEQUENCE),
    ],
)
def test_a_sample_of_another_sender_or_of_before_is_refused(
    sensing: Loop, endpoint: str, payload: bytes, code: RefusalCode
) -> None:
    with open_zenoh(listen=[], connect=[endpoint], max_message_size=1_000_000) as stranger:
        eventually(lambda: list(stranger.liveliness().get("moby/alive", timeout=0.1)))
        stranger.put("moby/sensor/imu", b'{"heading":0,"seq":5,"sender":"a"}')
        sensing.until(lambda: sensing.samples)
        stranger.put("moby/sensor/imu", payload)
        sensing.until(lambda: sensing.refusals)
    assert [one.code for one in sensing.refusals] == [code]


def test_the_client_says_at_once_what_is_no_sample(client: Client) -> None:
    for values, words in (
        ({"heading": float("inf")}, "heading = inf: must be a number from -1e"),
        ({"roll": 0.1}, "pitch is missing"),
        ({"heading": 0.1, "range": 0.2}, "a sample is of one of: heading; roll, pitch"),
        ({}, "nothing: a sample is of one of"),
    ):
        with pytest.raises(ValueError, match=words.replace(".", r"\.")):
            client.sense("imu", **values)
    with pytest.raises(TypeError, match="heading"):
        client.sense("imu", heading=True)
    with pytest.raises(LinkError):
        client.sense("imu/../x", heading=1.0)


def test_a_reset_is_answered_by_the_loop(loop: Loop, client: Client) -> None:
    with ThreadPoolExecutor() as pool:
        for ok, reason in ((True, None), (False, "motor left has a fault")):
            asking = pool.submit(client.reset, TIMEOUT_S)
            loop.until(lambda: loop.requests)
            request = loop.requests.pop()
            assert request.kind is RequestKind.RESET
            loop.link.reply(Reply(request.id - 1, True, "an answer that came too late for its own question"))
            loop.link.reply(Reply(request.id, ok, reason))
            assert asking.result() == ResetAnswer(ok, reason)


def test_to_stand_up_and_to_be_let_down_are_answered_by_the_loop(loop: Loop, client: Client) -> None:
    with ThreadPoolExecutor() as pool:
        for asked, kind in ((client.stand_up, RequestKind.STAND_UP), (client.let_down, RequestKind.LET_DOWN)):
            asking = pool.submit(asked, TIMEOUT_S)
            loop.until(lambda: loop.requests)
            request = loop.requests.pop()
            assert request.kind is kind
            loop.link.reply(Reply(request.id, False, "this robot stands by itself"))
            assert asking.result() == ResetAnswer(False, "this robot stands by itself")


def test_a_reset_the_loop_ignores_is_answered_all_the_same(client: Client) -> None:
    assert client.reset(TIMEOUT_S) == ResetAnswer(False, NO_ANSWER)


def test_a_reference_is_answered_by_the_loop(loop: Loop, client: Client) -> None:
    with ThreadPoolExecutor() as pool:
        asking = pool.submit(client.reference, "platform", np.float32(0.5), TIMEOUT_S)
        loop.until(lambda: loop.requests)
        request = loop.requests.pop()
        assert (request.kind, request.motor, request.angle) == (RequestKind.REFERENCE, "platform", 0.5)
        loop.link.reply(Reply(request.id, False, "the robot moves"))
        assert asking.result() == ResetAnswer(False, "the robot moves")


@pytest.mark.parametrize(
    ("payload", "words"),
    [(None, "payload: must be a JSON object"), (b'{"angle": 7}', "angle = 7: must be a number from -6.3 to 6.3 rad")],
)
def test_a_wrong_reference_is_refused_at_once(
    loop: Loop, stranger: zenoh.Session, payload: bytes | None, words: str
) -> None:
    replies = [one.ok for one in stranger.get("moby/cmd/reference", payload=payload, timeout=TIMEOUT_S)]
    assert [words in one.payload.to_string() for one in replies if one] == [True]
    loop.cycle()
    assert not loop.requests


def test_a_setting_is_answered_by_the_loop(loop: Loop, client: Client) -> None:
    with ThreadPoolExecutor() as pool:
        asking = pool.submit(client.set, "speed_override", np.float64(0.5))
        loop.until(lambda: loop.requests)
        (request,) = loop.requests
        assert (request.kind, request.setting, request.value) == (RequestKind.SET, "speed_override", 0.5)
        loop.link.reply(Reply(request.id, False, "too fast"))
        assert asking.result() == ResetAnswer(False, "too fast")


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b'{"setting":"speed_override"}', "value is missing"),
        (b'{"setting":"Speed","value":1}', "setting = 'Speed': must be the name of a setting"),
        (b'{"setting":"speed_override","value":NaN}', "value = nan: must be a number"),
        (b"", "must be a JSON object"),
    ],
)
def test_a_wrong_setting_is_refused_at_once(loop: Loop, stranger: zenoh.Session, payload: bytes, words: str) -> None:
    (reply,) = stranger.get("moby/cmd/set", payload=payload, timeout=TIMEOUT_S)
    assert reply.ok is not None
    answer = decode_reply(reply.ok.payload.to_bytes())
    assert answer is not None
    assert words in str(answer.reason)
    loop.cycle()
    assert not loop.requests


def test_a_mark_is_answered_by_the_loop(loop: Loop, client: Client) -> None:
    with ThreadPoolExecutor() as pool:
        asking = pool.submit(client.mark, "it squeals")
        loop.until(lambda: loop.requests)
        (request,) = loop.requests
        assert (request.kind, request.text) == (RequestKind.MARK, "it squeals")
        loop.link.reply(Reply(request.id, True, None))
        assert asking.result() == ResetAnswer(True, None)


def test_a_wrong_mark_is_refused_at_once(loop: Loop, stranger: zenoh.Session) -> None:
    (reply,) = stranger.get("moby/cmd/mark", payload=b'{"text":"two\\nlines"}', timeout=TIMEOUT_S)
    assert reply.ok is not None
    answer = decode_reply(reply.ok.payload.to_bytes())
    assert answer is not None
    assert "text = 'two\\nlines': must be 1 to 200 printable characters in one line" in str(answer.reason)
    loop.cycle()
    assert not loop.requests


def test_a_crowd_that_asks_is_answered_each(loop: Loop, stranger: zenoh.Session) -> None:
    """Those in flight by the loop, each with its own words; all others at once that there are too many."""
    answers = list[ResetAnswer | None]()

    def keep(reply: zenoh.Reply) -> None:
        answers.append(decode_reply(reply.ok.payload.to_bytes()) if reply.ok else None)

    for _ in range(180):
        stranger.get("moby/cmd/reset", Callback(keep, indirect=False), timeout=TIMEOUT_S)
    loop.until(lambda: len(loop.requests) == MAX_QUESTIONS)
    eventually(lambda: len(answers) == 180 - MAX_QUESTIONS)
    assert set(answers) == {ResetAnswer(False, TOO_MANY)}
    for request in reversed(loop.requests):
        loop.link.reply(Reply(request.id, False, f"reply {request.id}"))
    eventually(lambda: len(answers) == 180)
    expected = {ResetAnswer(False, f"reply {number + 1}") for number in range(MAX_QUESTIONS)}
    assert set(answers[-MAX_QUESTIONS:]) == expected


def test_after_the_crowd_there_is_room_again(loop: Loop, client: Client, stranger: zenoh.Session) -> None:
    for replies in [stranger.get("moby/cmd/reset", timeout=TIMEOUT_S) for _ in range(3 * MAX_QUESTIONS)]:
        assert [one.ok is not None for one in replies] == [True]
    with ThreadPoolExecutor() as pool:
        asking = pool.submit(client.reset, TIMEOUT_S)
        loop.until(lambda: [one for one in loop.requests if one.id > MAX_QUESTIONS])
        for request in loop.requests:  # those of the crowd come too late and find nobody
            loop.link.reply(Reply(request.id, request.id > MAX_QUESTIONS, None))
        assert asking.result() == ResetAnswer(True, None)


def test_looking_around_asks_for_nothing(loop: Loop, stranger: zenoh.Session) -> None:
    replies = [reply.ok for reply in stranger.get("moby/**", timeout=TIMEOUT_S)]
    answers = {str(sample.key_expr): sample.payload.to_string() for sample in replies if sample}
    for rest in QUESTIONS:
        assert NOT_EXACT in answers[f"moby/{rest}"]
    loop.cycle()
    assert not loop.requests


def test_a_stop_is_confirmed_by_a_state_that_says_so(loop: Loop, client: Client) -> None:
    def say(mode: Mode) -> None:
        status = STATUS._replace(mode=mode)
        loop.link.publish(odometry=None, status=status, events=(), now_ns=0)

    say(Mode.ESTOP)
    assert client.wait_for_state(lambda state: state.status.mode is Mode.ESTOP, TIMEOUT_S)
    assert not client.stop(timeout=0.01), "that state was there before the stop"
    loop.cycle()
    loop.requests.clear()
    with ThreadPoolExecutor() as pool:
        stopping = pool.submit(client.stop, TIMEOUT_S)
        for _ in range(3):  # put again for as long as the robot says something else
            loop.until(lambda: loop.requests)
            loop.requests.clear()
            say(Mode.DRIVE)
        say(Mode.ESTOP)
        assert stopping.result()


def test_the_age_of_the_state_is_known(link: ZenohLink, client: Client) -> None:
    assert client.state_age() == float("inf")
    before = time.monotonic()
    link.publish(odometry=None, status=STATUS, events=(), now_ns=0)
    eventually(client.state)
    assert 0.0 <= client.state_age() <= time.monotonic() - before


def test_connections_that_say_nothing_keep_nobody_out(link: ZenohLink, endpoint: str) -> None:
    """Zenoh's own bounds admit a hundred of them and wait 10 s for each."""
    port = int(endpoint.rpartition(":")[2])
    with ExitStack() as stack:
        silent = [
            stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S / 2))
            for _ in range(300)
        ]
        client = stack.enter_context(Client("moby", connect=[endpoint]))
        assert client.wait_alive(TIMEOUT_S / 2)
        assert {one.recv(1) for one in silent} == {b""}, "their places are free again"
    assert link.drain(0) == ((), (), (), ())


def test_status_and_robot_file_are_answered(link: ZenohLink, client: Client) -> None:
    assert client.config_text(TIMEOUT_S) == "# the robot file\n"
    assert client.status(TIMEOUT_S) is None
    link.publish(odometry=None, status=STATUS, events=(), now_ns=2_000_000_000, extras={"recording": "healthy"})
    expected = StateMessage(2.0, STATUS, {"recording": "healthy"})
    assert eventually(lambda: client.status(TIMEOUT_S)) == expected


def _tells(client: Client, expected: AbilityMessage) -> bool:
    return client.reachable(TIMEOUT_S) == expected


def test_what_the_robot_can_do_is_told_when_it_changes_and_answered(
    link: ZenohLink, client: Client, endpoint: str
) -> None:
    assert client.reachable(TIMEOUT_S) is None
    full = STATUS._replace(ability=AbilityStatus(3, 1.0, 1.0, (), ()))
    for number, status in enumerate((STATUS, STATUS, full, full), 1):
        link.publish(odometry=None, status=status, events=(), now_ns=number * 1_000_000_000)
        expected = AbilityMessage(1.0 if number < 3 else 3.0, status.ability)
        assert eventually(partial(_tells, client, expected))


def test_who_listens_is_told_what_the_robot_can_do_when_it_changes_and_then_alone(
    link: ZenohLink, client: Client
) -> None:
    full = STATUS._replace(ability=AbilityStatus(3, 1.0, 1.0, (), ()))
    heard: list[AbilityMessage | None] = []
    subscriber = client._session.declare_subscriber(
        "moby/reachable", lambda sample: heard.append(decode_ability(sample.payload.to_bytes()))
    )

    def publish(status: Status, t: int) -> None:
        link.publish(odometry=None, status=status, events=(), now_ns=t * 1_000_000_000)

    def subscribed() -> bool:
        publish(STATUS, 1)
        publish(full, 1)
        return bool(heard)

    assert eventually(subscribed)
    assert eventually(partial(_tells, client, AbilityMessage(1.0, full.ability)))
    publish(full, 2)
    assert client.wait_for_state(lambda message: message.t == 2.0, TIMEOUT_S), "this much is published"
    publish(STATUS, 3)
    expected = AbilityMessage(3.0, STATUS.ability)
    assert eventually(lambda: expected in heard)
    assert AbilityMessage(2.0, full.ability) not in heard
    subscriber.undeclare()  # type: ignore[no-untyped-call]


def test_what_the_loop_says_is_published(link: ZenohLink, client: Client) -> None:
    event = Event(Level.WARNING, "slip", "wheel left slips")

    def subscribed() -> bool:
        link.publish(odometry=ODOMETRY, status=None, events=[], now_ns=1_000_000_000)
        return client.odometry() is not None

    assert eventually(subscribed)
    link.publish(odometry=ODOMETRY, status=STATUS, events=[event], now_ns=1_000_000_000)
    link.publish_truth(Pose(1.0, 2.0, 3.0), 1.0)
    state = client.wait_for_state(lambda message: message.status.mode is Mode.DEGRADED, TIMEOUT_S)
    assert state == StateMessage(1.0, STATUS, {})
    assert eventually(client.odometry) == OdometryMessage(1.0, 1.0, 2.0, 0.5, None, None, None, (0.0,) * 9, None)
    assert eventually(client.truth) == TruthMessage(1.0, 1.0, 2.0, 3.0)
    assert eventually(client.events) == [EventMessage(1.0, *event)]
    assert client.events() == []


def test_only_what_is_put_on_its_exact_key_reaches_the_client(link: ZenohLink, client: Client) -> None:
    forged, real = (encode_event(Event(Level.INFO, code, ""), 0) for code in ("forged", "real"))
    for key, payload in (("**", forged), ("**", b"garbage"), ("moby/event", b"garbage"), ("moby/event", real)):
        link._session.put(key, payload)  # peers of the gateway do not hear each other, only the gateway
    assert [event.code for event in eventually(client.events)] == ["real"]


def test_the_last_words_are_published_before_the_end(link: ZenohLink, client: Client) -> None:
    heard: list[str] = []

    def hear(code: str) -> bool:
        heard.extend(event.code for event in client.events())
        return code in heard

    def greet() -> bool:
        link.publish(odometry=None, status=None, events=[Event(Level.INFO, "hello", "")], now_ns=0)
        return hear("hello")

    assert eventually(greet), "the subscriptions have reached the publisher"
    link.publish(odometry=None, status=STATUS, events=[Event(Level.INFO, "end", "bye")], now_ns=1)
    link.close()
    assert eventually(lambda: hear("end"))
    assert client.wait_for_state(lambda message: message.status == STATUS, TIMEOUT_S)


def test_no_state_in_time_is_none(client: Client) -> None:
    assert client.wait_for_state(lambda _: True, 0.01) is None


def test_zero_on_exit(link: ZenohLink, endpoint: str) -> None:
    loop = Loop(link)
    with Client("moby", connect=[endpoint], zero_on_exit=True) as client:
        assert client.wait_alive(TIMEOUT_S)
        client.send_twist(1.0, 0.0, 0.0, source="teleop")
        loop.until(lambda: loop.commands)
    loop.until(lambda: loop.commands[1:])
    assert [command.twist.vx for command in loop.commands] == [1.0, 0.0]


def test_the_token_comes_and_goes_and_the_client_finds_the_next_gateway(endpoint: str) -> None:
    with Client("moby", connect=[endpoint]) as client:
        assert not client.alive
        assert not client.stop(timeout=0.01)
        assert client.reset(timeout=0.01) == ResetAnswer(False, "no answer from moby within 0.01 s")
        for _ in range(2):
            with ZenohLink(_robot(endpoint), ""):
                assert client.wait_alive(TIMEOUT_S)
            eventually(lambda: not client.alive)


def test_a_port_in_use_is_named(link: ZenohLink, endpoint: str) -> None:
    with pytest.raises(LinkError, match=rf"listen = \['{endpoint}'\].*Address already in use"):
        ZenohLink(_robot(endpoint), "")
    assert link.drain(0) == ((), (), (), ())


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ("tcp/127.0.0.1", "invalid socket address"),
        ("tcp/127.0.0.1:99999", "invalid port"),
        ("smoke/signals:1", "smoke"),
        ("nothing", "Endpoints must be of the form"),
    ],
)
def test_a_wrong_endpoint_is_named(wrong: str, why: str) -> None:
    with pytest.raises(LinkError, match=f"{wrong}.*{why}") as caught:
        open_zenoh(listen=[wrong], connect=[], max_message_size=1000)
    assert "cargo" not in str(caught.value)


def test_a_config_file_that_is_missing_is_named() -> None:
    with pytest.raises(ConfigError, match=r"config_file = /no/such\.json5"):
        open_zenoh(listen=[], connect=[], max_message_size=1000, config_file="/no/such.json5")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{ mode: ", "line 1, column 9: expected array, boolean"),
        ("{\n mod: 3 }", "line 2, column 2: unknown field `mod`, expected one of `id`"),
        ("{ mode: 3 }", "line 1, column 9: invalid type: integer `3`, expected either 'router'"),
        ("", "Empty config file"),
    ],
)
def test_a_wrong_config_file_is_named_with_the_place(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        open_zenoh(listen=[], connect=[], max_message_size=1000, config_file=str(file))
    message = str(caught.value)
    assert message.startswith(f"zenoh.config_file = {file}: {words}")
    assert not any(part in message for part in ("Message {", "JSON error", "-->", "lib.rs", "\n"))


def test_a_config_file_that_is_toml_is_not_printed_whole(tmp_path: Path) -> None:
    file = tmp_path / "robot.toml"
    file.write_text("[robot]\nsecret = 'whole'\n")
    with pytest.raises(ConfigError) as caught:
        open_zenoh(listen=[], connect=[], max_message_size=1000, config_file=str(file))
    assert f"{file}: unknown field `robot`" in str(caught.value)
    assert "whole" not in str(caught.value)


def test_a_config_file_counts_but_not_against_the_robot_file(tmp_path: Path, endpoint: str) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text('{mode: "router", /* as JSON5 */ listen: {endpoints: ["tcp/0.0.0.0:1"]}, namespace: "hall"}')
    config = _robot(endpoint)
    zenoh_section = config.zenoh.model_copy(update={"config_file": str(file)})
    with (
        ZenohLink(config.model_copy(update={"zenoh": zenoh_section}), "text"),
        open_zenoh(listen=[], connect=[endpoint], max_message_size=1000) as session,
    ):
        eventually(lambda: list(session.get("hall/moby/config", timeout=1.0)))


def test_a_name_that_would_address_others_is_refused(client: Client) -> None:
    with pytest.raises(LinkError, match=r"name = '\*'"):
        Client("*")
    with pytest.raises(LinkError, match="name = 'a/b'"):
        client.send_twist(0.0, 0.0, 0.0, source="a/b")


def test_the_loop_learns_that_the_session_has_ended(link: ZenohLink) -> None:
    link._session.close()  # type: ignore[no-untyped-call]
    with pytest.raises(LinkError, match=r"thread ended: moby/.*: channel closed"):
        eventually(lambda: link.drain(0).commands)


def test_close_twice(link: ZenohLink) -> None:
    link.close()
    link.close()
    assert not any(thread.is_alive() for thread in link._receivers._threads)


@pytest.mark.parametrize("ending", ["", "raise SystemExit(3)"], ids=["end", "exit"])
def test_the_process_ends_without_close(endpoint: str, ending: str) -> None:
    with _process(f'link = ZenohLink(_robot({endpoint!r}), "")', endpoint, ending) as process:
        _, errors = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, errors) == (3 if ending else 0, "")


def test_a_killed_gateway_is_no_longer_alive(endpoint: str) -> None:
    with _process(f'link = ZenohLink(_robot({endpoint!r}), "")', endpoint, "signal.pause()") as process:
        with Client("moby", connect=[endpoint]) as client:
            assert client.wait_alive(TIMEOUT_S)
            process.kill()
            eventually(lambda: not client.alive)
        process.communicate(timeout=TIMEOUT_S)


def test_a_frozen_onlooker_holds_up_neither_the_loop_nor_the_end(link: ZenohLink, endpoint: str) -> None:
    with _process("", endpoint, "signal.pause()") as process:
        process.send_signal(signal.SIGSTOP)
        slowest_s = 0.0
        for _ in range(400):  # 20 MB: more than the sockets' buffers hold
            started = time.perf_counter()
            link.publish(odometry=None, status=STATUS, events=(), now_ns=0, extras={"ballast": "x" * 50_000})
            slowest_s = max(slowest_s, time.perf_counter() - started)
            eventually(link._outbox.calls.empty)
        started = time.perf_counter()
        link.close()
        assert time.perf_counter() - started < 6.0
        assert slowest_s < 0.5
        process.kill()
        process.communicate(timeout=TIMEOUT_S)


COUNTS = """
def until(code):
    found = []
    while code not in found:
        client.wait_for_state(lambda _: bool(client._events), 0.1)
        found += [event.code for event in client.events()]
    return found
until("begin")
print("begun", flush=True)
print(len([code for code in until("end") if code == "one"]), flush=True)
client.close()
"""


def test_an_onlooker_that_stalls_misses_states_and_no_event(link: ZenohLink, endpoint: str) -> None:
    """20 MB of states that find no room in its sockets, and events between them: these come once."""

    def tell(code: str) -> None:
        link.publish(odometry=None, status=None, events=[Event(Level.INFO, code, "")], now_ns=0)
        eventually(link._outbox.calls.empty)

    with _process("", endpoint, COUNTS) as process:
        assert process.stdout is not None
        while not select.select([process.stdout], [], [], 0.05)[0]:
            tell("begin")  # until its subscription is known
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGSTOP)
        for _ in range(40):
            for _ in range(10):
                link.publish(odometry=None, status=STATUS, events=(), now_ns=0, extras={"ballast": "x" * 50_000})
                eventually(link._outbox.calls.empty)
            tell("one")
        tell("end")
        process.send_signal(signal.SIGCONT)
        try:
            assert process.communicate(timeout=TIMEOUT_S) == ("40\n", "")
        finally:
            process.kill()


def _process(opening: str, endpoint: str, ending: str) -> subprocess.Popen[str]:
    """Another interpreter with a client (and what else it opens), ready and on its way to its ending."""
    script = f"""
import signal
from tests.gateway.test_zenoh_link import Client, ZenohLink, _robot
{opening}
client = Client("moby", connect=[{endpoint!r}])
assert client.wait_alive({TIMEOUT_S})
print("ready", flush=True)
{ending}
"""
    process = subprocess.Popen(
        [sys.executable, "-W", "error", "-c", script],
        cwd=ROBOT_FILE.parents[2],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process

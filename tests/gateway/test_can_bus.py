"""The CAN edge against a scripted python-can bus, and against python-can's own virtual one."""

import errno
import os
import struct
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator
from threading import Event

import can
import pytest

from drivers.contract import CanFrame
from gateway.config import ConfigError, RobotConfig, load
from gateway.core.assembly import build
from gateway.edges.can_bus import MAX_FRAMES_PER_DRAIN, REOPEN_NS, STUCK_CYCLES, CanBuses, interface_exists
from gateway.edges.can_thread import AdapterThread
from gateway.edges.claims import Claims, InUseError
from gateway.types import BusEvent, BusEventKind
from tests.world import BUNDLED, ROBOTS, World

LEFT = 1 << 5
SETPOINT = CanFrame("can0", LEFT | 0x0D, bytes(8))
STEP_NS = 10_000_000
WAIT_S = 30.0
BUS_OFF, RESTARTED, CONTROLLER = 0x40, 0x100, 0x04
Kinds = list[BusEventKind]


class ScriptedBus:
    """A bus of which a test says what is received, and what fails how."""

    def __init__(self) -> None:
        self.inbox: deque[can.Message | BaseException] = deque()
        self.failure: BaseException | None = None
        self.closing: BaseException | None = None
        self.room: int | None = None  # frames that still fit
        self.sent: list[can.Message] = []
        self.closed = False

    def recv(self, _timeout: float) -> can.Message | None:
        if not self.inbox:
            return None
        item = self.inbox.popleft()
        if isinstance(item, BaseException):
            raise item
        return item

    def set_filters(self, filters: object) -> None:
        assert filters

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        assert timeout is not None
        if self.failure is not None and self.room in (None, len(self.sent)):
            raise self.failure
        self.sent.append(message)

    def shutdown(self) -> None:
        self.closed = True
        if self.closing is not None:
            raise self.closing


class Bench:
    """The edge on one scripted bus that can be opened or not."""

    def __init__(self, config: RobotConfig, monkeypatch: pytest.MonkeyPatch) -> None:
        self.opened: list[ScriptedBus] = []
        self.open_failure: BaseException | None = None
        self.now_ns = 10**12
        self.threads: list[AdapterThread] = []
        monkeypatch.setattr(can, "Bus", self._open)
        monkeypatch.setattr("gateway.edges.can_bus.AdapterThread", self._thread)
        monkeypatch.setattr("gateway.edges.can_bus.interface_exists", lambda _channel: True)
        monkeypatch.setattr("gateway.edges.can_thread.MAX_AGE_NS", 10**12)  # so that a slow machine changes nothing
        self.edge = CanBuses(config)

    @property
    def bus(self) -> ScriptedBus:
        return self.opened[-1]

    def _thread(self, name: str) -> AdapterThread:
        self.threads.append(AdapterThread(name))
        return self.threads[-1]

    def _open(self, **_: object) -> ScriptedBus:
        if self.open_failure is not None:
            raise self.open_failure
        self.opened.append(ScriptedBus())
        return self.opened[-1]

    def cycle(self, *frames: CanFrame) -> tuple[list[CanFrame], Kinds]:
        """Receive, then send, as the service does; an adapter with a thread has done what it can by then."""
        self.now_ns += STEP_NS
        received, events = self.edge.receive(self.now_ns)
        self.edge.send(frames, self.now_ns)
        assert all(thread.settle(WAIT_S) for thread in self.threads)
        return received, [event.kind for event in events]

    def events(self) -> list[BusEvent]:
        """Receive only; what is told."""
        self.now_ns += STEP_NS
        events = self.edge.receive(self.now_ns)[1]
        assert all(thread.settle(WAIT_S) for thread in self.threads)
        return events

    def cycles(self, number: int, *frames: CanFrame) -> Kinds:
        return [kind for _ in range(number) for kind in self.cycle(*frames)[1]]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[Bench]:
    """On SocketCAN, which answers at once."""
    bench = Bench(on_interface("socketcan", request.node.name), monkeypatch)
    bench.cycle()
    yield bench
    bench.edge.close()


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[Bench]:
    """On a serial adapter, which may hold its caller; it is open, and its first frames were written."""
    bench = Bench(on_interface("slcan", request.node.name), monkeypatch)
    assert bench.cycles(3, SETPOINT) == [BusEventKind.DOWN, BusEventKind.TX_DROPPED]
    assert bench.cycle(SETPOINT)[1] == [BusEventKind.UP]
    bench.bus.sent.clear()
    yield bench
    bench.edge.close()


def on_interface(interface: str, channel: str) -> RobotConfig:
    config = load(ROBOTS / "moby.toml")[0]
    bus = config.bus[0].model_copy(update={"interface": interface, "channel": channel[:64]})
    return config.model_copy(update={"bus": [bus]})


def failure(number: int) -> can.CanOperationError:
    return can.CanOperationError(os.strerror(number), number)


def heartbeat(timestamp: float = 0.0, *, is_rx: bool = True) -> can.Message:
    return can.Message(arbitration_id=LEFT | 1, data=bytes(8), is_extended_id=False, timestamp=timestamp, is_rx=is_rx)


def error_frame(classes: int, state: int = 0) -> can.Message:
    return can.Message(arbitration_id=classes, data=bytes([0, state, 0, 0, 0, 0, 0, 0]), is_error_frame=True)


def test_a_link_that_is_down_is_told_once_and_comes_back_on_the_same_socket(bench: Bench) -> None:
    bench.bus.failure = failure(errno.ENETDOWN)
    kinds = bench.cycles(10, SETPOINT)
    assert kinds.count(BusEventKind.DOWN) == 1
    assert kinds.count(BusEventKind.TX_DROPPED) == 9
    bench.bus.inbox.append(heartbeat())
    assert BusEventKind.UP not in bench.cycles(2, SETPOINT)  # hearing is not enough
    bench.bus.failure = None
    assert bench.cycles(2, SETPOINT).count(BusEventKind.UP) == 1
    assert len(bench.opened) == 1


def test_what_could_not_be_sent_in_its_cycle_is_never_sent(bench: Bench) -> None:
    bench.bus.failure = failure(errno.ENETDOWN)
    stale = SETPOINT._replace(data=b"\1" * 8)
    bench.cycles(5, stale)
    bench.bus.failure = None
    bench.cycles(5, SETPOINT)
    assert {bytes(message.data) for message in bench.bus.sent} == {bytes(8)}


@pytest.mark.parametrize("number", [errno.ENODEV, errno.ENXIO])
def test_a_deleted_interface_is_reopened_when_it_is_there_again(bench: Bench, number: int) -> None:
    first = bench.bus
    first.inbox.append(failure(number))
    bench.open_failure = OSError(errno.ENODEV, "No such device")
    assert bench.cycles(2, SETPOINT) == [BusEventKind.DOWN, BusEventKind.TX_DROPPED]
    assert first.closed
    bench.cycles(2 * REOPEN_NS // STEP_NS, SETPOINT)
    bench.open_failure = None
    assert BusEventKind.UP in bench.cycles(REOPEN_NS // STEP_NS + 4, SETPOINT)
    assert len(bench.opened) == 2


@pytest.mark.parametrize("interface", ["socketcan", "scripted"])
def test_an_interface_that_is_missing_at_the_start_is_waited_for(
    interface: str, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    bench = Bench(on_interface(interface, request.node.name), monkeypatch)
    bench.open_failure = OSError(errno.ENODEV, "No such device")
    texts = [event.text for _ in range(3) for event in bench.events()]
    assert texts[-1] == f"{interface} {request.node.name[:64]} cannot be opened: [Errno 19] No such device"
    assert texts[:-1] == ([] if interface == "socketcan" else [f"scripted {request.node.name[:64]} is being opened"])
    bench.open_failure = None
    assert BusEventKind.UP in bench.cycles(REOPEN_NS // STEP_NS + 4, SETPOINT)
    bench.edge.close()


@pytest.mark.parametrize("room", [None, 1])
def test_a_queue_that_stays_full_is_down_though_motors_are_heard(bench: Bench, room: int | None) -> None:
    bench.bus.failure, bench.bus.room = failure(errno.ENOBUFS), room
    kinds: Kinds = []
    for _ in range(2 * STUCK_CYCLES):
        bench.bus.inbox.append(heartbeat())
        kinds += bench.cycle(SETPOINT, SETPOINT)[1]
    assert kinds.index(BusEventKind.DOWN) == STUCK_CYCLES
    assert kinds.count(BusEventKind.DOWN) == 1
    assert BusEventKind.UP not in kinds
    bench.bus.failure = None
    assert BusEventKind.UP in bench.cycles(2, SETPOINT, SETPOINT)


def test_a_queue_that_is_full_for_a_moment_only_drops(bench: Bench) -> None:
    bench.bus.failure = can.CanOperationError("Transmit buffer full")
    assert set(bench.cycles(STUCK_CYCLES - 1, SETPOINT)) == {BusEventKind.TX_DROPPED}
    bench.bus.failure = None
    assert bench.cycles(3, SETPOINT) == [BusEventKind.TX_DROPPED]


def test_bus_off_lasts_until_the_controller_says_so_or_hears_somebody(bench: Bench) -> None:
    for end in (error_frame(RESTARTED), heartbeat(), error_frame(CONTROLLER, 0x40)):
        bench.bus.inbox.append(error_frame(BUS_OFF))
        assert bench.cycle(SETPOINT)[1] == [BusEventKind.BUS_OFF, BusEventKind.DOWN]
        bench.bus.inbox.append(heartbeat(is_rx=False))  # of this very machine
        assert bench.cycles(3, SETPOINT) == []
        bench.bus.inbox.append(end)
        assert BusEventKind.UP in bench.cycles(2, SETPOINT)


def test_a_shower_of_error_frames_is_one_event_and_no_frame(bench: Bench) -> None:
    bench.bus.inbox.extend(error_frame(CONTROLLER, 0x10) for _ in range(100))
    bench.now_ns += STEP_NS
    frames, events = bench.edge.receive(bench.now_ns)
    assert frames == []
    assert [(event.kind, event.occurrences) for event in events] == [(BusEventKind.ERROR_PASSIVE, 100)]


def test_a_flood_is_taken_in_parts(bench: Bench) -> None:
    bench.bus.inbox.extend(heartbeat() for _ in range(MAX_FRAMES_PER_DRAIN + 5))
    assert len(bench.cycle()[0]) == MAX_FRAMES_PER_DRAIN
    assert len(bench.cycle()[0]) == 5


def test_stamps_neither_fall_nor_lie_in_the_future(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    bench = Bench(on_interface("socketcan", request.node.name), monkeypatch)
    bench.cycle()
    bench.bus.inbox.extend(heartbeat(stamp) for stamp in (3e9, 1.0, 2.0))  # a wall clock that was set meanwhile
    received, _ = bench.cycle()
    stamps = [frame.received_ns or 0 for frame in received]
    assert stamps == sorted(stamps)
    assert max(stamps) <= bench.now_ns
    bench.edge.close()


# Seen of python-can's adapters on corrupt serial lines, on unplugged devices, and what else there may be.
WILD = [
    ValueError("invalid literal for int() with base 16: b'zz'"),
    TypeError("'NoneType' object is not subscriptable"),
    OverflowError("int too big to convert"),
    struct.error("unpack requires a buffer of 8 bytes"),
    IndexError(),
    AttributeError("'NoneType' object has no attribute 'read'"),
    UnicodeDecodeError("ascii", b"\xff", 0, 1, "ordinal not in range(128)"),
    ZeroDivisionError("division by zero"),
    RuntimeError("device disconnected"),
    can.CanOperationError("lost"),
    can.CanInterfaceNotImplementedError("no driver library"),
    OSError(errno.EIO, "Input/output error"),
]
paths = pytest.mark.parametrize("path", ["bench", "slow"])
wild = pytest.mark.parametrize("error", WILD, ids=lambda error: type(error).__name__)


@wild
@paths
def test_whatever_receiving_raises_is_a_bus_that_is_down_and_reopened(
    path: str, error: Exception, request: pytest.FixtureRequest
) -> None:
    bench: Bench = request.getfixturevalue(path)
    first = bench.bus
    first.inbox += [heartbeat(), error, heartbeat()]
    frames, kinds = bench.cycle(SETPOINT)
    assert (len(frames), kinds) == (1, [BusEventKind.DOWN])
    assert first.closed
    assert BusEventKind.UP in bench.cycles(REOPEN_NS // STEP_NS + 4, SETPOINT)
    assert len(bench.opened) == 2


@wild
@paths
def test_whatever_sending_raises_is_a_bus_that_is_down_and_reopened(
    path: str, error: Exception, request: pytest.FixtureRequest
) -> None:
    bench: Bench = request.getfixturevalue(path)
    bench.bus.failure = error
    assert bench.cycles(3, SETPOINT)[:2] == [BusEventKind.TX_DROPPED, BusEventKind.DOWN]
    assert BusEventKind.UP in bench.cycles(REOPEN_NS // STEP_NS + 4, SETPOINT)
    assert len(bench.opened) == 2


@wild
@paths
def test_whatever_opening_and_closing_raise_is_survived(
    path: str, error: Exception, request: pytest.FixtureRequest
) -> None:
    bench: Bench = request.getfixturevalue(path)
    bench.open_failure = bench.bus.closing = error
    bench.bus.inbox.append(error)
    kinds = bench.cycles(3 * REOPEN_NS // STEP_NS, SETPOINT)
    assert kinds.count(BusEventKind.DOWN) == 1
    bench.open_failure = None
    assert BusEventKind.UP in bench.cycles(REOPEN_NS // STEP_NS + 4, SETPOINT)
    bench.bus.closing = error
    bench.edge.close()
    assert bench.bus.closed


def test_a_bus_that_fails_half_opened_is_closed(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    bench = Bench(on_interface("socketcan", request.node.name), monkeypatch)
    monkeypatch.setattr(ScriptedBus, "set_filters", lambda *_: 1 // 0)
    assert bench.cycle()[1] == [BusEventKind.DOWN]
    assert bench.bus.closed
    bench.edge.close()


def test_the_words_of_the_adapter_are_told(bench: Bench) -> None:
    bench.bus.inbox.append(WILD[0])
    _, events = bench.edge.receive(bench.now_ns)
    assert [(event.kind, event.text) for event in events] == [
        (BusEventKind.DOWN, "receive: ValueError: invalid literal for int() with base 16: b'zz'")
    ]


@pytest.mark.parametrize("end", [KeyboardInterrupt, SystemExit])
def test_the_end_of_the_process_is_no_failure_of_a_bus(bench: Bench, end: type[BaseException]) -> None:
    bench.bus.inbox.append(end())
    with pytest.raises(end):
        bench.cycle()


def malformed() -> dict[str, can.Message]:
    """By what is wrong with them; can.Message checks nothing unless asked."""
    headless, short, error = heartbeat(), heartbeat(), error_frame(CONTROLLER, 0x10)
    headless.data = error.data = None  # type: ignore[assignment]
    short.data = bytearray(3)
    return {
        "fd": can.Message(arbitration_id=LEFT | 1, data=bytes(8), is_extended_id=False, is_fd=True),
        "too long": can.Message(arbitration_id=LEFT | 1, data=bytes(9), is_extended_id=False),
        "no data": headless,
        "less data than told": short,
        "standard id": can.Message(arbitration_id=0x800, data=bytes(8), is_extended_id=False),
        "extended id": can.Message(arbitration_id=1 << 29, data=bytes(8), is_extended_id=True),
        "negative id": can.Message(arbitration_id=-1, data=bytes(8), is_extended_id=False),
        "error frame without data": error,
    }


@pytest.mark.parametrize("wrong", malformed())
def test_what_no_classic_bus_carries_is_dropped_and_counted(bench: Bench, wrong: str) -> None:
    message = malformed()[wrong]
    bench.bus.inbox += [message, heartbeat(), message]
    bench.now_ns += STEP_NS
    frames, events = bench.edge.receive(bench.now_ns)
    assert [frame.id for frame in frames] == [LEFT | 1]
    assert [(event.kind, event.occurrences) for event in events] == [(BusEventKind.RX_MALFORMED, 2)]
    assert bench.cycles(3, SETPOINT) == []
    assert len(bench.opened) == 1


def fd_bench(monkeypatch: pytest.MonkeyPatch, channel: str) -> tuple[Bench, list[dict[str, object]]]:
    config = on_interface("socketcan", channel)
    bus = config.bus[0].model_copy(update={"fd": True, "data_bitrate": 5_000_000})
    bench = Bench(config.model_copy(update={"bus": [bus]}), monkeypatch)
    asked: list[dict[str, object]] = []

    def opening(**settings: object) -> ScriptedBus:
        asked.append(settings)
        return bench._open(**settings)

    monkeypatch.setattr(can, "Bus", opening)
    return bench, asked


def test_an_fd_bus_is_opened_as_one_and_a_classic_one_is_not(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    bench, asked = fd_bench(monkeypatch, request.node.name)
    bench.cycle()
    assert [(one.get("fd"), one.get("data_bitrate")) for one in asked] == [(True, 5_000_000)]
    bench.edge.close()


def test_an_fd_bus_carries_both_kinds(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    bench, _ = fd_bench(monkeypatch, request.node.name)
    bench.cycle()
    long = can.Message(arbitration_id=1, data=bytes(64), is_extended_id=True, is_fd=True, bitrate_switch=True)
    bench.bus.inbox += [long, heartbeat()]
    frames, _ = bench.cycle()
    assert [(len(frame.data), frame.fd, frame.bit_rate_switch) for frame in frames] == [
        (64, True, True),
        (8, False, False),
    ]
    wrong = {
        "no such length": can.Message(arbitration_id=1, data=bytes(9), is_fd=True),
        "remote": can.Message(arbitration_id=1, is_fd=True, is_remote_frame=True),
        "classic": can.Message(arbitration_id=1, data=bytes(12)),
    }
    for message in wrong.values():
        bench.bus.inbox.append(message)
        assert bench.cycle() == ([], [BusEventKind.RX_MALFORMED])
    bench.edge.close()


@pytest.mark.parametrize("stamp", [0.0, 12.5, -3.0, 5e9, 1e300, float("nan"), float("inf"), None])
def test_stamps_of_other_adapters_are_not_trusted(slow: Bench, stamp: float) -> None:
    message = heartbeat()
    message.timestamp = stamp
    for _ in range(3):
        slow.bus.inbox.append(message)
        received, _ = slow.cycle()
        assert [frame.received_ns for frame in received] == [slow.now_ns]


def test_stamps_of_socketcan_are_trusted(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    bench = Bench(on_interface("socketcan", request.node.name), monkeypatch)
    bench.now_ns = time.monotonic_ns()
    bench.cycle()
    age_s = 0.003
    bench.now_ns = time.monotonic_ns()
    stamp = time.clock_gettime(time.CLOCK_REALTIME) - age_s
    bench.bus.inbox += [heartbeat(stamp), heartbeat(float("nan"))]
    frames, _ = bench.edge.receive(bench.now_ns)
    first, second = (frame.received_ns or 0 for frame in frames)
    assert 0 < bench.now_ns - first < 1_000_000_000
    assert first < second == bench.now_ns
    bench.edge.close()


def test_a_slow_loop_keeps_up_with_a_full_bus(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    config = on_interface("scripted", request.node.name)
    slow = config.model_copy(update={"loop": config.loop.model_copy(update={"rate": 10.0})})
    motors = [
        motor.model_copy(update={"watchdog": None, "watchdog_waiver": "a test of the bus alone", "options": {}})
        for motor in config.motor
    ]
    bench = Bench(slow.model_copy(update={"motor": motors}), monkeypatch)
    bench.cycle()
    in_a_period = round(1e6 / 47 / 10)
    bench.bus.inbox.extend(heartbeat() for _ in range(in_a_period))
    assert len(bench.cycle()[0]) == in_a_period
    bench.edge.close()


def test_an_unknown_interface_is_an_error_of_the_robot_file(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    bus = can.Bus
    bench = Bench(on_interface("nonsense", request.node.name), monkeypatch)
    monkeypatch.setattr(can, "Bus", bus)
    bench.events()
    with pytest.raises(ConfigError, match=r"bus can0: interface: .*nonsense"):
        bench.events()
    bench.edge.close()


def test_two_services_for_the_same_motors_refuse_until_the_first_has_ended(request: pytest.FixtureRequest) -> None:
    config = on_interface("virtual", request.node.name)
    first = CanBuses(config)
    with pytest.raises(InUseError, match=f"process {os.getpid()} already commands CAN id 0x"):
        CanBuses(config)
    first.close()
    CanBuses(config).close()


def test_other_motors_on_the_same_bus_are_nobodys_business(request: pytest.FixtureRequest) -> None:
    claims = Claims("socketcan", request.node.name, [0x200])
    others = Claims("socketcan", request.node.name, [0x1FF])
    with pytest.raises(InUseError):
        Claims("socketcan", request.node.name, [0x100, 0x200])
    Claims("socketcan", request.node.name, [0x100]).release()  # a refused claim holds nothing
    claims.release()
    others.release()


def test_a_killed_process_holds_nothing(request: pytest.FixtureRequest) -> None:
    program = (
        "import sys, time; from gateway.edges.claims import Claims; "
        f"claims = Claims('socketcan', {request.node.name!r}, [1]); print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(InUseError, match=f"process {holder.pid} "):
            Claims("socketcan", request.node.name, [1])
        holder.kill()
    Claims("socketcan", request.node.name, [1]).release()


@pytest.mark.parametrize("name", BUNDLED)
def test_the_kernel_filters_let_pass_whatever_the_motors_say_and_nothing_foreign(name: str) -> None:
    world = World(name)
    world.start()
    robot = build(world.config)
    filters = [wanted for bus in world.config.bus for wanted in robot.receive_filters(bus.name)]
    heard = {(frame.id, frame.extended) for inputs, _ in world.records for frame in inputs.frames}
    for identifier, extended in heard:
        assert any(extended == long and identifier & mask == wanted for wanted, mask, long in filters)
        assert not any(extended != long and identifier & mask == wanted for wanted, mask, long in filters)
    assert not any(0x7A5 & mask == wanted for wanted, mask, _ in filters)


@pytest.mark.parametrize(("name", "expected"), [("lo", True), ("nonsense0", False)])
def test_interfaces_are_found(name: str, expected: bool) -> None:
    assert interface_exists(name) is expected


def test_frames_pass_both_ways_on_a_virtual_bus(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    bus = can.Bus
    bench = Bench(on_interface("virtual", request.node.name), monkeypatch)
    monkeypatch.setattr(can, "Bus", bus)
    channel = request.node.name[:64]
    bench.cycles(2)
    with can.Bus(interface="virtual", channel=channel) as motors:
        bench.cycle(SETPOINT)
        message = motors.recv(1.0)
        assert message is not None
        assert (message.arbitration_id, message.is_extended_id) == (SETPOINT.id, False)
        motors.send(heartbeat())
        frames, _ = bench.cycle()
        assert [(frame.bus, frame.id, frame.extended) for frame in frames] == [("can0", LEFT | 1, False)]
    bench.edge.close()


# -- adapters that hold their caller ----------------------------------------------------------------------------------


class Held:
    """A call that does not return before it is let go."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        self._gate = Event()
        self.entered = Event()
        call = getattr(ScriptedBus, name)

        def wait(*args: object, **kwargs: object) -> object:
            self.entered.set()
            assert self._gate.wait(WAIT_S)
            return call(*args, **kwargs)

        monkeypatch.setattr(ScriptedBus, name, wait)

    def release(self) -> None:
        self._gate.set()


def run(bench: Bench, cycles: int) -> Kinds:
    """Cycles of a loop that waits for nobody."""
    kinds: Kinds = []
    for _ in range(cycles):
        bench.now_ns += STEP_NS
        kinds += [event.kind for event in bench.edge.receive(bench.now_ns)[1]]
        bench.edge.send([SETPOINT, SETPOINT], bench.now_ns)
    return kinds


def test_a_write_that_never_returns_is_a_bus_that_is_down_and_the_loop_goes_on(
    slow: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = Held(monkeypatch, "send")
    kinds = run(slow, 4 * STUCK_CYCLES)
    assert held.entered.wait(WAIT_S)
    kinds += run(slow, STUCK_CYCLES)
    assert kinds.count(BusEventKind.DOWN) == 1
    assert kinds[-1] is BusEventKind.TX_DROPPED
    assert len(slow.opened) == 1, "nothing is opened beside a call that did not return"
    held.release()


def test_what_waited_for_a_slow_write_is_not_sent_late(slow: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    held = Held(monkeypatch, "send")
    stale = SETPOINT._replace(data=b"\1" * 8)
    slow.edge.send([SETPOINT], slow.now_ns)
    assert held.entered.wait(WAIT_S)
    slow.edge.send([stale, stale], slow.now_ns)
    monkeypatch.setattr("gateway.edges.can_thread.MAX_AGE_NS", -1)  # by now they are too old
    held.release()
    assert slow.threads[0].settle(WAIT_S)
    assert [bytes(message.data) for message in slow.bus.sent] == [bytes(8)]
    monkeypatch.setattr("gateway.edges.can_thread.MAX_AGE_NS", 10**12)
    assert slow.cycles(3, SETPOINT) == [BusEventKind.TX_DROPPED]
    assert len(slow.bus.sent) == 3


def test_opening_that_never_returns_is_a_bus_that_is_down_and_is_not_begun_again(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    held = Held(monkeypatch, "__init__")
    bench = Bench(on_interface("slcan", request.node.name), monkeypatch)
    kinds = run(bench, 3 * REOPEN_NS // STEP_NS)
    assert kinds[0] is BusEventKind.DOWN
    assert set(kinds[1:]) == {BusEventKind.TX_DROPPED}
    assert held.entered.wait(WAIT_S)
    assert not bench.opened
    held.release()
    assert bench.threads[0].settle(WAIT_S)
    assert BusEventKind.UP in bench.cycles(3, SETPOINT)
    assert len(bench.opened) == 1
    bench.edge.close()
    assert bench.bus.closed


@pytest.mark.parametrize("name", ["send", "shutdown"])
def test_the_end_does_not_wait_for_an_adapter_for_long(name: str, slow: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.edges.can_thread.END_S", 0.01)
    held = Held(monkeypatch, name)
    slow.edge.send([SETPOINT], slow.now_ns)
    slow.edge.close()
    assert held.entered.wait(WAIT_S)
    held.release()


def test_the_last_frames_are_written_before_the_end(slow: Bench) -> None:
    slow.edge.send([SETPOINT] * 20, slow.now_ns)
    slow.edge.close()
    assert len(slow.bus.sent) == 20
    assert slow.bus.closed

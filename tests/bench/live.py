"""The service in real time: how late its loop is, and how long a command takes from Zenoh to CAN. Both beside a peer.

How this works
--------------
Four processes at once, on one machine: the service with link and recorder, the simulated robot, an empty loop with the
same period, and a bare subscriber of Zenoh. This process puts, in turn and at uneven times, a twist for the service and
a few bytes for the bare subscriber, through one session. Whatever else the machine does meanwhile meets all of them.
The bus is a socket pair behind python-can, as a CAN interface is a socket: where there is no CAN in the kernel too.
"""

import logging
import multiprocessing
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from struct import Struct
from typing import Any, NamedTuple

import can
import zenoh

from drivers.contract import CanFrame
from gateway.client import Client
from gateway.config import RobotConfig, parse
from gateway.core.snapshot import State
from gateway.edges import keys, messages
from gateway.edges.can_adapter import AdapterError, ask, frame_of, message_of
from gateway.edges.estop_latch import EstopFile, EstopLatch
from gateway.edges.signals import EndRequest
from gateway.edges.systemd import Notifier
from gateway.edges.zenoh_link import ZenohLink
from gateway.edges.zenoh_session import Receivers, open_zenoh
from gateway.recording.recorder import Recorder
from gateway.service import Service
from gateway.types import BusEvent, CycleTiming, Event, Inputs, Mode, Outputs
from replay.sim.server import SimulationServer
from tests.recordings import stored
from tests.world import robot_text

RATE_HZ = 1000.0
PERIOD_NS = 1_000_000
SECONDS = 15.0
SETTLING = 1000  # cycles at the beginning that do not count
ROBOT = "omni4"
SOURCE = "teleop"
BARE_KEY, RING_KEY = "bare/callback", "bare/ring"
PUT_EVERY_S = (0.004, 0.008)  # twist and bare ones in turn
SWITCH_INTERVAL_S = 0.0005  # as `drivegate run` sets it
READY_S = 30.0
MICRO = 1e-3
_CAN = Struct("<I?B8s")


class SocketBus(can.BusABC):
    """Frames as packets of a socket."""

    def __init__(self, end: socket.socket) -> None:
        super().__init__(channel="socket")
        self._socket = end
        end.setblocking(False)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Raises OSError when the other side does not read."""
        self._socket.send(_CAN.pack(msg.arbitration_id, msg.is_extended_id, msg.dlc, bytes(msg.data)))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        try:
            identifier, extended, length, data = _CAN.unpack(self._socket.recv(_CAN.size))
        except BlockingIOError:
            return None, True
        return can.Message(arbitration_id=identifier, is_extended_id=extended, data=data[:length]), True


class Edge:
    """The bus of the service; notes when the frames of a cycle were handed over."""

    def __init__(self, bus: can.BusABC, name: str) -> None:
        self.handed_ns = 0
        self._bus = bus
        self._name = name

    def receive(self, now_ns: int) -> tuple[list[CanFrame], list[BusEvent]]:
        frames = []
        while (message := ask(self._bus.recv, 0)) is not None:
            frames.append(frame_of(message, bus=self._name, received_ns=now_ns))
        return frames, []

    def send(self, frames: Sequence[CanFrame], now_ns: int) -> None:
        for frame in frames:
            try:
                ask(self._bus.send, message_of(frame), timeout=0)
            except AdapterError:
                break
        self.handed_ns = time.monotonic_ns()

    def close(self) -> None:
        self._bus.shutdown()


class Stages(NamedTuple):
    """A command on its way through the service: arrived in the link's thread, taken by a cycle, handed to CAN."""

    sequence: int
    received_ns: int
    taken_ns: int
    handed_ns: int


class Noting:
    """The recorder, and what this measurement wants to know of each cycle."""

    def __init__(self, recorder: Recorder, edge: Edge) -> None:
        self.begun_ns: list[int] = []
        self.late_ns: list[int] = []
        self.work_ns: list[int] = []
        self.stages: list[Stages] = []
        self._recorder = recorder
        self._edge = edge

    @property
    def dropped(self) -> int:
        return self._recorder.dropped

    def put(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming, state: Callable[[], State]) -> None:
        self._recorder.put(inputs, outputs, timing, state)
        self.begun_ns.append(inputs.now_ns)
        self.late_ns.append(timing.late_ns)
        self.work_ns.append(timing.work_ns)
        for command in inputs.commands:
            if command.sequence is not None:
                self.stages.append(Stages(command.sequence, command.received_ns, inputs.now_ns, self._edge.handed_ns))

    def poll(self) -> Sequence[Event]:
        return self._recorder.poll()

    def health(self) -> dict[str, object]:
        return self._recorder.health()


class Served(NamedTuple):
    begun_ns: list[int]
    late_ns: list[int]
    work_ns: list[int]
    stages: list[Stages]
    dropped: int  # records


# each of these is a process


def serve(end: socket.socket, endpoint: str, folder: str, answer: Connection) -> None:
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    ending = EndRequest()
    ending.listen()
    logging.disable(logging.WARNING)
    config, text = _config(Path(folder))
    config = config.model_copy(update={"zenoh": config.zenoh.model_copy(update={"listen": [endpoint]})})
    edge = Edge(SocketBus(end), config.bus[0].name)
    latch = EstopLatch(EstopFile(Path(folder), config.robot.name))
    recorder = Recorder(config, text, "bench")
    noting = Noting(recorder, edge)
    with ZenohLink(config, text) as link:
        service = Service(config, bus=edge, link=link, recorder=noting, latch=latch, notifier=Notifier(), ending=ending)
        service.run()
    recorder.close(READY_S)
    latch.close()
    answer.send(Served(noting.begun_ns, noting.late_ns, noting.work_ns, noting.stages, recorder.dropped))


def simulate(end: socket.socket, _answer: Connection) -> None:
    logging.disable(logging.WARNING)
    config, _ = _config(Path())
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    bus = SocketBus(end)
    SimulationServer(config, {config.bus[0].name: bus}).run(stop)
    bus.shutdown()


def _empty(answer: Connection) -> None:
    """Sleeps to absolute deadlines and does nothing, in the service's own way of waiting."""
    ends = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ends.set())
    late_ns: list[int] = []
    deadline_ns = time.monotonic_ns()
    while not ends.is_set():
        late_ns.append(Service._wait(deadline_ns) - deadline_ns)
        deadline_ns += PERIOD_NS * max(1, -(-late_ns[-1] // PERIOD_NS))
    answer.send(late_ns)


def _listen(endpoint: str, answer: Connection) -> None:
    """The bare subscribers: note when each payload, a number, was handed to Python; by a thread of Zenoh, and by ours.

    The second is how the service receives: a ring, read by a thread.
    """
    heard: tuple[dict[int, int], dict[int, int]] = ({}, {})

    def hear(found: dict[int, int], sample: zenoh.Sample) -> None:
        now_ns = time.monotonic_ns()
        found[int(sample.payload.to_bytes())] = now_ns

    ends = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ends.set())
    session = open_zenoh(listen=[endpoint], connect=[], max_message_size=65_536)
    receivers = Receivers(session)
    receivers.subscribe(RING_KEY, partial(hear, heard[1]))
    _subscriber = session.declare_subscriber(BARE_KEY, partial(hear, heard[0]))
    ends.wait()
    receivers.close()
    answer.send(heard)


def measure() -> dict[str, float]:
    """Microseconds. `rest`: what the service adds to bare Zenoh and to the half period that a command waits for."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    endpoints = [f"tcp/127.0.0.1:{free_port()}" for _ in range(2)]
    with (
        tempfile.TemporaryDirectory() as folder,
        Child(simulate, theirs),
        Child(serve, ours, endpoints[0], folder) as service,
        Child(_listen, endpoints[1]) as listener,
        Client(ROBOT, connect=endpoints[:1]) as client,
        Commander(endpoints) as commander,
    ):
        if not client.wait_alive(READY_S):
            raise RuntimeError("the service does not start")
        commander.start(client)
        with Child(_empty) as empty:
            commander.drive()
            empty_ns = empty.end()
        heard, served = listener.end(), service.end()
    bare_ns = [
        [found[number] - put_ns for number, put_ns in puts.items() if number in found]
        for found, puts in zip(heard, (commander.bare, commander.ringed), strict=True)
    ]
    return _figures(served, empty_ns, commander.twists, bare_ns)


class Commander:
    """Puts twists for the service and numbers for the bare subscriber; notes when each was put."""

    def __init__(self, endpoints: Sequence[str]) -> None:
        self.twists: dict[int, int] = {}
        self.bare: dict[int, int] = {}
        self.ringed: dict[int, int] = {}
        self._sequence = 0
        self._session = open_zenoh(listen=[], connect=endpoints, max_message_size=65_536)
        express = {"congestion_control": zenoh.CongestionControl.DROP, "express": True}
        key = keys.key(ROBOT, keys.twist(SOURCE))
        self._twist = self._session.declare_publisher(key, **express)  # type: ignore[arg-type]
        self._bare = self._session.declare_publisher(BARE_KEY, **express)  # type: ignore[arg-type]
        self._ringed = self._session.declare_publisher(RING_KEY, **express)  # type: ignore[arg-type]

    def __enter__(self) -> "Commander":
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()  # type: ignore[no-untyped-call]

    def start(self, client: Client) -> None:
        """Zeros until the robot may drive."""
        deadline = time.monotonic() + READY_S
        while (state := client.state()) is None or state.status.mode is not Mode.DRIVE:
            if time.monotonic() > deadline:
                raise RuntimeError(f"the robot does not drive: {state}")
            self._put_twist(0.0)
            time.sleep(max(PUT_EVERY_S))

    def drive(self) -> None:
        """To and fro, at times that have nothing to do with those of the loop."""
        self.twists.clear()
        random, end = Random(1), time.monotonic() + SECONDS
        while (left := end - time.monotonic()) > 0.0:
            time.sleep(random.uniform(*PUT_EVERY_S))
            self._put_twist(0.3 if left % 4.0 > 2.0 else -0.3)
            for puts, publisher in ((self.bare, self._bare), (self.ringed, self._ringed)):
                time.sleep(random.uniform(*PUT_EVERY_S))
                number = len(puts)
                puts[number] = time.monotonic_ns()
                publisher.put(str(number).encode())

    def _put_twist(self, vx: float) -> None:
        self._sequence += 1
        payload = messages.encode_twist((vx, 0.0, 0.0), sequence=self._sequence, sender="bench")
        self.twists[self._sequence] = time.monotonic_ns()
        self._twist.put(payload)


class Child:
    """A process that answers once, when it is told to end; only then its answer is waited for."""

    def __init__(self, target: Callable[..., None], *arguments: object) -> None:
        context = multiprocessing.get_context("spawn")
        self._answers, answer = context.Pipe(duplex=False)
        self._process = context.Process(target=target, args=(*arguments, answer))
        self._process.start()
        answer.close()

    @property
    def pid(self) -> int:
        """Process id."""
        assert self._process.pid is not None
        return self._process.pid

    def __enter__(self) -> "Child":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.join(READY_S)
        self._process.kill()

    def end(self) -> Any:  # noqa: ANN401  whatever it has to say
        self._process.terminate()
        if not self._answers.poll(READY_S):
            raise RuntimeError(f"{self._process.name} does not answer")
        return self._answers.recv()


def _config(folder: Path) -> tuple[RobotConfig, str]:
    text = robot_text(ROBOT, rate_hz=RATE_HZ)
    return stored(parse(text, ROBOT), folder), text


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _figures(
    served: Served, empty_ns: list[int], twists: dict[int, int], bare_ns: Sequence[list[int]]
) -> dict[str, float]:
    mine = [stage for stage in served.stages if stage.sequence in twists]
    parts = {
        "put_to_can": [stage.handed_ns - twists[stage.sequence] for stage in mine],
        "put_to_thread": [stage.received_ns - twists[stage.sequence] for stage in mine],
        "thread_to_cycle": [stage.taken_ns - stage.received_ns for stage in mine],
        "cycle_to_can": [stage.handed_ns - stage.taken_ns for stage in mine],
        "bare_zenoh": bare_ns[0],
        "bare_zenoh_thread": bare_ns[1],
    }
    figures = {"live_commands": float(len(mine)), "live_cycles": float(len(served.late_ns))}
    shares = {"p50": 0.5, "p99": 0.99, "p999": 0.999}
    for name, all_ns in (("loop", served.late_ns[SETTLING:]), ("empty_loop", empty_ns[SETTLING:])):
        figures |= {f"{name}_late_{word}_us": quantile(all_ns, share) for word, share in shares.items()}
    for name, all_ns in parts.items():
        figures |= {f"{name}_{word}_us": quantile(all_ns, shares[word]) for word in ("p50", "p99")}
    figures["loop_work_p50_us"] = quantile(served.work_ns[SETTLING:], 0.5)
    expected = figures["bare_zenoh_p50_us"] + 0.5 * PERIOD_NS * MICRO
    return figures | {
        "bare_zenoh_and_half_period_us": expected,
        "command_rest_p50_us": figures["put_to_can_p50_us"] - expected,
    }


def quantile(values: Sequence[int], share: float) -> float:
    """In microseconds."""
    return sorted(values)[min(int(share * len(values)), len(values) - 1)] * MICRO


if __name__ == "__main__":
    for figure, microseconds in measure().items():
        print(f"{figure:30} {microseconds:10.1f}")

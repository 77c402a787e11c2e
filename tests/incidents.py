"""Drives through what keeps incidents, without a service and without processes. For tests."""

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from gateway.config import RobotConfig
from gateway.core.engine import Engine
from gateway.recording.bundle import kept
from gateway.recording.incidents import Incidents, Order, Written
from gateway.recording.packets import Gap, Packet, Record, Snapshot, encode
from gateway.types import CycleTiming, Inputs, Outputs, Request, RequestKind, SensorSample, Twist, TwistCommand
from tests.recordings import STARTED_NS, hello, stored
from tests.world import World

RATE_HZ = 100.0
PRE_S, POST_S = 1.0, 0.5
SESSION = "moby-20260921T141320Z"


class Given:
    """Takes orders in the place of a process; `written`: what it answers, None: it is still at work."""

    def __init__(self, written: Written | None = None) -> None:
        self.orders: list[Order] = []
        self.answer = written
        self.error: OSError | None = None

    def __call__(self, order: bytes) -> Any:  # noqa: ANN401  it stands in for a process
        if self.error is not None:
            raise self.error
        self.orders.append(msgspec.msgpack.decode(order, type=Order))
        return self

    def written(self) -> Written | None:
        return self.answer


def short(config: RobotConfig, directory: Path, *, pre: float = PRE_S, min_free: int = 1_000_000) -> RobotConfig:
    """The same robot, with short incidents in this directory."""
    incidents = config.recording.incidents.model_copy(update={"pre": pre, "post": POST_S})
    return stored(config, directory, incidents=incidents, min_free=min_free)


def with_budget(config: RobotConfig, budget: int) -> RobotConfig:
    """The same with so many bytes for all incidents."""
    incidents = config.recording.incidents.model_copy(update={"budget": budget})
    return config.model_copy(update={"recording": config.recording.model_copy(update={"incidents": incidents})})


def record(inputs: Inputs, outputs: Outputs) -> Record:
    return Record(inputs, outputs, CycleTiming(0, 0, STARTED_NS + inputs.now_ns))


class MarkedWorld(World):
    """Somebody marks these cycles."""

    def __init__(self, name: str, marked: Collection[int], *, rate_hz: float = RATE_HZ) -> None:
        super().__init__(name, rate_hz=rate_hz)
        self._marked = marked

    def cycle(
        self,
        *,
        commands: Iterable[TwistCommand] = (),
        requests: Iterable[Request] = (),
        samples: Iterable[SensorSample] = (),
    ) -> Outputs:
        here, now_ns = len(self.records), self.now_ns + self.period_ns
        marks = [Request(RequestKind.MARK, 8, now_ns, text=f"in {here}")] if here in self._marked else []
        return super().cycle(commands=commands, requests=[*requests, *marks], samples=samples)

    def drive(self, cycles: int) -> None:
        """Until there are so many."""
        self.start()
        while len(self.records) < cycles:
            self.cycle(commands=[self.command(Twist(0.2, 0.0, 0.1))] if len(self.records) % 5 == 0 else [])

    @property
    def packets(self) -> list[Record]:
        """Every cycle as a recorder gets it."""
        return [record(*cycle) for cycle in self.records]


def with_snapshots(config: RobotConfig, records: Sequence[Record], after: Iterable[int]) -> list[Packet]:
    """The packets of a recorder: cycles, with the state of the core behind these."""
    engine, behind = Engine(config), set(after)
    packets: list[Packet] = []
    for one in records:
        engine.step(one.inputs)
        packets.append(one)
        if one.inputs.cycle in behind:
            packets.append(Snapshot.of(one.inputs.cycle, engine.snapshot()))
    return packets


def without(packets: Iterable[Packet], first: int, last: int) -> list[Packet]:
    """The same with a gap, and the word that there is one, in front of what follows."""
    left: list[Packet] = []
    for packet in packets:
        cycle = (
            packet.inputs.cycle if isinstance(packet, Record) else packet.cycle if isinstance(packet, Snapshot) else 0
        )
        if not first <= cycle <= last:
            if cycle == last + 1 and isinstance(packet, Record):
                left.append(Gap(first, last, "the recorder could not keep up"))
            left.append(packet)
    return left


def orders(world: World, config: RobotConfig, packets: Iterable[Packet]) -> list[Order]:
    """What would be written of this drive."""
    given = Given()
    incidents = Incidents(config, hello(config, text=world.text), SESSION, write=given)
    for packet in packets:
        incidents.take(packet, encode(packet))
        incidents.poll()
    incidents.close()
    return given.orders


def bundles(world: World, config: RobotConfig, packets: Iterable[Packet]) -> list[Path]:
    """The files of the incidents of this drive."""
    written = map(kept, orders(world, config, packets))
    return [Path(one.file) for one in written if one.file is not None]

"""What those who look on cost the service: none, one, ten, one that is frozen, one that is killed.

How this works
--------------
One service at 1 kHz with link and recorder, and the simulated robot in a process of its own, as in `live`. Onlookers
are processes that subscribe to the view. The frozen one is stopped by a signal, and has told Zenoh that it may be
silent for an hour, so that nobody throws it out. The conditions take turns in short rounds, in random order, and the
middle one of the rounds counts: whatever else the machine does for some seconds meets all of them, and decides for
none. The loop's lateness and the processor time of the whole service are compared with those of nobody looking on. Its
memory grows by the notes of this measurement, so that too is compared.
"""

import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import NamedTuple

from gateway.client import Client
from gateway.edges import keys
from tests.bench import live

ROUNDS = 15
ROUND_S = 2.0
SETTLE_S = 0.5  # before a round: starting a process and subscribing are no viewing
MEMORY_S = 30.0
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
ONLOOKER = """
import json, sys, zenoh
config = zenoh.Config()
for key, value in {"mode": "client", "connect/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False,
                   "transport/link/tx/lease": 3_600_000}.items():
    config.insert_json5(key, json.dumps(value))
sessions = [zenoh.open(config) for _ in range(int(sys.argv[3]))]
subscribers = [session.declare_subscriber(sys.argv[2], zenoh.handlers.RingChannel(1)) for session in sessions]
for subscriber in subscribers:
    subscriber.recv()
print("all see", flush=True)
while True:
    subscribers[0].recv()
"""


class Round(NamedTuple):
    begin_ns: int
    end_ns: int
    cpu_s: float


class Figures(NamedTuple):
    """Of a round."""

    late_p50_us: float
    late_p99_us: float
    cycles_missed_percent: float
    cpu_ms_per_s: float


@contextmanager
def onlooker(endpoint: str, sessions: int = 1) -> Iterator[subprocess.Popen[str]]:
    """It sees the robot."""
    command = [sys.executable, "-c", ONLOOKER, endpoint, keys.key(live.ROBOT, keys.VIEW), str(sessions)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "all see\n"
            yield process
        finally:
            process.kill()


class Stand:
    """The running service, and what is done to it in a round."""

    def __init__(self, endpoint: str, pid: int) -> None:
        self.conditions: dict[str, Callable[[], Round]] = {
            "none": self._watch,
            "one": lambda: self._with(lambda _: self._watch()),
            "ten": lambda: self._with(lambda _: self._watch(), sessions=10),
            "frozen": lambda: self._with(self._frozen),
            "killed": lambda: self._with(self._killed),
        }
        self._endpoint = endpoint
        self._pid = pid

    def memory_kb(self, frozen: bool) -> float:
        """By how much the service's memory grows, with nobody looking on or with one who is frozen."""
        if not frozen:
            return self._growth()
        with onlooker(self._endpoint) as process:
            process.send_signal(signal.SIGSTOP)
            time.sleep(SETTLE_S)
            return self._growth()

    def _with(self, run: Callable[[subprocess.Popen[str]], Round], *, sessions: int = 1) -> Round:
        with onlooker(self._endpoint, sessions) as process:
            time.sleep(SETTLE_S)
            return run(process)

    def _frozen(self, process: subprocess.Popen[str]) -> Round:
        process.send_signal(signal.SIGSTOP)
        return self._watch()

    def _killed(self, process: subprocess.Popen[str]) -> Round:
        process.kill()
        return self._watch()

    def _watch(self) -> Round:
        begin_ns, cpu_s = time.monotonic_ns(), self._cpu_s()
        time.sleep(ROUND_S)
        return Round(begin_ns, time.monotonic_ns(), self._cpu_s() - cpu_s)

    def _growth(self) -> float:
        before = self._resident_kb()
        time.sleep(MEMORY_S)
        return self._resident_kb() - before

    def _cpu_s(self) -> float:
        fields = Path(f"/proc/{self._pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICKS_PER_S

    def _resident_kb(self) -> float:
        text = Path(f"/proc/{self._pid}/status").read_text(encoding="ascii")
        (line,) = (line for line in text.splitlines() if line.startswith("VmRSS"))
        return float(line.split()[1])


def measure() -> dict[str, float]:
    """Medians of the rounds: microseconds, percent, processor milliseconds per second; and kB."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    endpoint = f"tcp/127.0.0.1:{live.free_port()}"
    rounds: dict[str, list[Round]] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        live.Child(live.simulate, theirs),
        live.Child(live.serve, ours, endpoint, folder) as service,
        Client(live.ROBOT, connect=[endpoint]) as client,
    ):
        if not client.wait_alive(live.READY_S):
            raise RuntimeError("the service does not start")
        time.sleep(2.0)
        stand = Stand(endpoint, service.pid)
        random = Random(1)
        for _ in range(ROUNDS):
            for name in random.sample(list(stand.conditions), len(stand.conditions)):
                rounds.setdefault(name, []).append(stand.conditions[name]())
        grown = {name: stand.memory_kb(name == "frozen") for name in ("none", "frozen")}
        served = service.end()
    figures = {f"view_memory_growth_kb_{name}": kilobytes for name, kilobytes in grown.items()}
    figures["view_records_dropped"] = float(served.dropped)
    of_rounds = {name: [_figures(one, served) for one in some] for name, some in rounds.items()}
    for name in stand.conditions:
        for word in Figures._fields:
            figures[f"view_{word}_{name}"] = statistics.median(getattr(one, word) for one in of_rounds[name])
    return figures


def _figures(one: Round, served: live.Served) -> Figures:
    first, last = (bisect_left(served.begun_ns, at_ns) for at_ns in (one.begin_ns, one.end_ns))
    late_ns, seconds = served.late_ns[first:last], (one.end_ns - one.begin_ns) * 1e-9
    return Figures(
        late_p50_us=live.quantile(late_ns, 0.5),
        late_p99_us=live.quantile(late_ns, 0.99),
        cycles_missed_percent=100.0 * (1.0 - len(late_ns) / (seconds * live.RATE_HZ)),
        cpu_ms_per_s=1000.0 * one.cpu_s / seconds,
    )


if __name__ == "__main__":
    for figure, value in measure().items():
        print(f"{figure:44} {value:10.2f}")

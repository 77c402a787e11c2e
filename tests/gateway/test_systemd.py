"""What the service manager hears, over a real notification socket."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.edges.systemd import MOTORS_LIMIT_NS, STATUS_LINE_NS, Notifier, Readiness
from gateway.types import AbilityStatus, BusEvent, BusEventKind, Mode, MotorStatus, Pose, Status, Twist

MOTOR = MotorStatus("left", "idle", None, None, None, None, None, None, None)
STATUS = Status(
    mode=Mode.IDLE,
    reason="waiting for a fresh zero command",
    faults=(),
    winner=None,
    winner_age_s=None,
    sources=(),
    motors=(MOTOR,),
    limits_active=(),
    stop_category=1,
    standing=True,
    pose=Pose(0.0, 0.0, 0.0),
    twist=None,
    refused=0,
    tx_dropped=0,
    overruns=0,
    dropped_records=0,
    cycle=0,
    ability=AbilityStatus(2, 0.5, 0.3, (Twist(0.3, 0.0, 0.0), Twist(0.0, 0.3, 0.1)), (Twist(0.0, 0.0, 1.0),)),
    chassis={"region": "pull", "turn_radius": None},
)
SILENT = STATUS._replace(motors=(MOTOR._replace(state="silent"),))
DOWN = BusEvent("can0", BusEventKind.DOWN, 1, "no such device")
UP = BusEvent("can0", BusEventKind.UP, 1, "works again")
LINE = "idle, standing: waiting for a fresh zero command"


class Manager:
    """The other end."""

    def __init__(self, path: Path, **variables: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.setblocking(False)
        self.environment = {"NOTIFY_SOCKET": str(path), **variables}
        self.notifier = Notifier(self.environment)

    def heard(self) -> list[str]:
        """Everything since the last call."""
        texts = []
        while True:
            try:
                texts.append(self._socket.recv(4096).decode())
            except BlockingIOError:
                return texts

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    manager = Manager(tmp_path / "notify", WATCHDOG_USEC="3000000", WATCHDOG_PID=str(os.getpid()))
    yield manager
    manager.notifier.close()
    manager.close()


def test_without_a_service_manager_nothing_happens() -> None:
    notifier = Notifier({})
    notifier.ready("x")
    notifier.feed_watchdog(10**12)


def test_children_cannot_speak_for_us(manager: Manager) -> None:
    assert manager.environment == {}


def test_the_watchdog_is_fed_at_a_third_of_its_interval(manager: Manager) -> None:
    for now_ms in range(2000, 5000, 100):
        manager.notifier.feed_watchdog(now_ms * 1_000_000)
    assert manager.heard() == ["WATCHDOG=1"] * 3


def test_a_manager_that_does_not_listen_stops_nothing(manager: Manager) -> None:
    manager.close()
    manager.notifier.status("still here")
    manager.notifier.close()
    manager.notifier.status("not any more")


def test_ready_at_once_when_bus_and_motors_are_there(manager: Manager) -> None:
    Readiness(manager.notifier, 0).tell(STATUS, 1)
    assert manager.heard() == [f"READY=1\nSTATUS={LINE}"]


def test_not_ready_while_a_bus_is_down_however_long_and_says_why(manager: Manager) -> None:
    readiness = Readiness(manager.notifier, 0)
    readiness.hear([DOWN])
    readiness.tell(SILENT, 1)
    readiness.tell(SILENT, 10 * MOTORS_LIMIT_NS)
    assert manager.heard() == ["EXTEND_TIMEOUT_USEC=10000000\nSTATUS=waiting: can0: no such device"] * 2
    readiness.hear([UP])
    readiness.tell(STATUS, 11 * MOTORS_LIMIT_NS)
    assert manager.heard() == [f"READY=1\nSTATUS={LINE}"]


def test_silent_motors_are_declared_absent_after_a_while(manager: Manager, caplog: pytest.LogCaptureFixture) -> None:
    readiness = Readiness(manager.notifier, 0)
    readiness.tell(SILENT, 1)
    assert manager.heard() == ["EXTEND_TIMEOUT_USEC=10000000\nSTATUS=waiting: no answer yet from left"]
    readiness.tell(SILENT, MOTORS_LIMIT_NS)
    assert manager.heard()[0].startswith("READY=1\n")
    assert caplog.messages == ["declared absent: left"]


def test_the_status_line_tells_mode_and_motion_once_per_second(manager: Manager) -> None:
    readiness = Readiness(manager.notifier, 0)
    driving = STATUS._replace(mode=Mode.DRIVE, standing=False, reason=None)
    readiness.tell(STATUS, 1)
    readiness.tell(driving, STATUS_LINE_NS // 2)
    readiness.tell(driving, STATUS_LINE_NS + 2)
    readiness.hear([DOWN])
    readiness.tell(driving._replace(standing=None), 3 * STATUS_LINE_NS)
    assert manager.heard()[1:] == ["STATUS=drive, moving", "STATUS=drive, motion unknown"]


def test_a_manager_whose_queue_is_full_holds_up_nobody_and_hears_ready_later(manager: Manager) -> None:
    for _ in range(1000):
        manager.notifier.status("the queue is short")
    readiness = Readiness(manager.notifier, 0)
    readiness.tell(STATUS, 1)
    assert not any(text.startswith("READY") for text in manager.heard())
    readiness.tell(STATUS, 2)
    assert manager.heard() == [f"READY=1\nSTATUS={LINE}"]

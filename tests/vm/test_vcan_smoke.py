"""What the kernel and python-can really do on vcan0: the facts the CAN edge relies on."""

import errno
import gc
import logging
import re
import socket
import struct
import subprocess
from collections.abc import Iterator
from itertools import pairwise

import can
import pytest

pytestmark = pytest.mark.vcan

FRAME = can.Message(arbitration_id=0x123, data=b"12345678", is_extended_id=False)
NO_QUEUE = "tc qdisc replace dev vcan0 root pfifo limit 0"  # every transmission finds the queue full
ONE_FRAME_PER_20_MS = "tc qdisc replace dev vxcan0 root tbf rate 6400bit burst 16 limit 48"  # a frame counts 16 bytes
BUS_OFF = 0x40  # linux/can/error.h: CAN_ERR_BUSOFF


def shell(command: str) -> str:
    """Output of a shell command that must succeed."""
    return subprocess.run(command, shell=True, check=True, capture_output=True, text=True).stdout


def open_bus(channel: str = "vcan0") -> can.BusABC:
    """A socket of its own."""
    return can.Bus(interface="socketcan", channel=channel)


def error_code(action: object, *arguments: object) -> int | None:
    """The errno python-can reports for this call."""
    assert callable(action)
    with pytest.raises(can.CanOperationError) as caught:
        action(*arguments)
    return caught.value.error_code


def opening_error() -> int | None:
    """The errno of a failed opening, which is no can.CanError."""
    with pytest.raises(OSError, match="No such device") as caught:
        open_bus()
    assert not isinstance(caught.value, can.CanError)
    return caught.value.errno


@pytest.fixture(autouse=True)
def _fresh_vcan0() -> None:
    shell("ip link del vcan0 2>/dev/null; ip link add dev vcan0 type vcan; ip link set vcan0 up")


@pytest.fixture
def sender(_fresh_vcan0: None) -> Iterator[can.BusABC]:
    """One end."""
    with open_bus() as bus:
        yield bus


@pytest.fixture
def receiver(_fresh_vcan0: None) -> Iterator[can.BusABC]:
    """The other end."""
    with open_bus() as bus:
        yield bus


@pytest.fixture
def wire() -> Iterator[tuple[can.BusABC, can.BusABC]]:
    """Two ends of a wire with an interface each, like the robot's and the motors'."""
    shell("ip link add dev vxcan0 type vxcan peer name vxcan1; ip link set vxcan0 up; ip link set vxcan1 up")
    with open_bus("vxcan0") as near, open_bus("vxcan1") as far:
        yield near, far
    shell("ip link del vxcan0")


def test_frames_arrive_in_order_with_rising_kernel_stamps(sender: can.BusABC, receiver: can.BusABC) -> None:
    for index in range(50):
        sender.send(can.Message(arbitration_id=index, data=bytes([index]), is_extended_id=False))
    frames = [frame for _ in range(50) if (frame := receiver.recv(1.0)) is not None]
    assert [frame.arbitration_id for frame in frames] == list(range(50))
    assert all(first.timestamp <= second.timestamp for first, second in pairwise(frames))
    assert sender.recv(0) is None  # nobody hears himself


def test_candump_sees_what_is_sent(sender: can.BusABC) -> None:
    with subprocess.Popen(["candump", "-L", "-n", "1", "-T", "5000", "vcan0"], stdout=subprocess.PIPE) as candump:
        while candump.poll() is None:  # until its socket is open
            sender.send(FRAME)
        assert candump.stdout is not None
        assert re.fullmatch(rb"\(\d+\.\d{6}\) vcan0 123#3132333435363738\n", candump.stdout.read())


def test_link_down_raises_and_link_up_recovers_the_same_socket(sender: can.BusABC, receiver: can.BusABC) -> None:
    shell("ip link set vcan0 down")
    assert error_code(sender.send, FRAME) == errno.ENETDOWN
    assert error_code(sender.send, FRAME) == errno.ENETDOWN
    assert error_code(receiver.recv, 0) == errno.ENETDOWN
    assert receiver.recv(0) is None  # the error is told once; after that a dead link looks like a quiet one
    shell("ip link set vcan0 up")
    sender.send(FRAME)
    assert receiver.recv(1.0) is not None


def test_a_deleted_interface_needs_a_new_socket(sender: can.BusABC, receiver: can.BusABC) -> None:
    shell("ip link del vcan0")
    assert error_code(sender.send, FRAME) == errno.ENXIO
    assert error_code(receiver.recv, 0) == errno.ENODEV
    assert receiver.recv(0) is None
    shell("ip link add dev vcan0 type vcan && ip link set vcan0 up")
    assert error_code(sender.send, FRAME) == errno.ENXIO  # for ever: the old socket does not find the new interface
    with open_bus() as new_sender:
        new_sender.send(FRAME)
        assert receiver.recv(0.1) is None


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # python-can does not close the socket it could not bind
def test_opening_a_missing_interface_is_a_plain_oserror(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL, logger="can")  # a kept log record would keep that socket
    shell("ip link del vcan0")
    assert opening_error() == errno.ENODEV
    gc.collect()


def test_a_full_queue_is_enobufs_at_once_even_with_a_timeout(sender: can.BusABC, receiver: can.BusABC) -> None:
    shell(NO_QUEUE)
    assert error_code(sender.send, FRAME) == errno.ENOBUFS
    assert error_code(sender.send, FRAME, 1.0) == errno.ENOBUFS
    shell("tc qdisc del dev vcan0 root")
    sender.send(FRAME)
    assert receiver.recv(1.0) is not None


def test_a_vxcan_pair_is_a_wire_whose_speed_and_losses_tc_sets(wire: tuple[can.BusABC, can.BusABC]) -> None:
    near, far = wire
    shell(ONE_FRAME_PER_20_MS)  # on vcan the queue fills the same way, but listeners hear a frame as it enters
    for _ in range(4):
        near.send(FRAME)
    assert error_code(near.send, FRAME) == errno.ENOBUFS
    frames = [frame for _ in range(4) if (frame := far.recv(1.0)) is not None]
    assert all(second.timestamp - first.timestamp > 0.01 for first, second in pairwise(frames))
    assert [frame.is_rx for frame in frames] == [True] * 4  # on vcan False: sent by this host


def test_error_frames_pass_the_filter_and_are_marked(sender: can.BusABC) -> None:
    only_0x123: list[can.typechecking.CanFilter] = [{"can_id": 0x123, "can_mask": 0x7FF}]
    with can.Bus(interface="socketcan", channel="vcan0", can_filters=only_0x123) as receiver:
        shell(f"cansend vcan0 {0x20000000 | BUS_OFF:08X}#0000000000000000")
        frame = receiver.recv(1.0)
        assert frame is not None
        assert frame.is_error_frame
        assert frame.arbitration_id == BUS_OFF
        assert not frame.is_extended_id
        assert sender.state is can.BusState.ACTIVE  # python-can never changes this for socketcan


def test_a_raw_socket_injects_error_frames_too(receiver: can.BusABC) -> None:
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw:
        raw.bind(("vcan0",))
        raw.send(struct.pack("=IB3x8s", socket.CAN_ERR_FLAG | BUS_OFF, 8, bytes(8)))
    frame = receiver.recv(1.0)
    assert frame is not None
    assert frame.is_error_frame

"""A wire that loses frames: the four-wheel robot drives on, with a pair of interfaces between service and motors."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.types import Mode
from replay.compare.verify import verify
from tests.vm.vcan_robot import GO, VcanRobot, candump, heard, in_mode, sent, shell

pytestmark = pytest.mark.vcan

FRESH_NS = (
    100_000_000  # a frame on the bus was commanded at most this long ago; its cycle is 10 ms, stalls are the host's
)


@pytest.fixture
def _lossy_wire() -> Iterator[None]:
    """vxcan0 for the service, vxcan1 for the motors; one frame of twenty is lost, either way."""
    shell("ip link add dev vxcan0 type vxcan peer name vxcan1; ip link set vxcan0 up; ip link set vxcan1 up")
    for end in ("vxcan0", "vxcan1"):
        shell(f"tc qdisc replace dev {end} root netem loss 5%")
    yield
    shell("ip link del vxcan0")


@pytest.mark.usefixtures("_lossy_wire")
def test_lost_frames_and_a_cut_wire(tmp_path: Path, free_port: int) -> None:
    log = tmp_path / "candump.log"
    with candump(log, "vxcan1"), VcanRobot("omni4", tmp_path, free_port, channel="vxcan0", motors="vxcan1") as robot:
        robot.drive()
        state = robot.stream(GO, lambda state: state.status.pose.x > 0.5)
        assert state.status.mode is Mode.DRIVE
        truth = robot.client.truth()
        assert truth is not None
        assert truth.x == pytest.approx(state.status.pose.x, abs=0.1)

        # C620 controllers hold their last current: without the bus only the relay would stop this robot.
        shell("ip link set vxcan0 down")
        robot.stream(GO, lambda state: any("Network is down" in fault for fault in state.status.faults))
        robot.client.events()
        shell("ip link set vxcan0 up")
        robot.stream(GO, in_mode(Mode.IDLE))
        robot.await_truth_at_rest(GO)
        assert "mode_starting" not in {event.code for event in robot.client.events()}
        robot.drive()
        session = robot.finish()
    offset_ns = session.header.wall_minus_mono_ns
    commanded = [(time_ns + offset_ns, data) for time_ns, identifier, data in sent(session) if identifier == 0x200]
    on_bus = [(frame.wall_ns, frame.data) for frame in heard(log) if frame.id == 0x200]
    assert 0.90 * len(commanded) < len(on_bus) < 0.98 * len(commanded)
    assert_fresh(commanded, on_bus)
    verdict = verify(session)
    assert verdict.identical, verdict


def assert_fresh(commanded: list[tuple[int, bytes]], on_bus: list[tuple[int, bytes]]) -> None:
    """Whatever was on the bus had been commanded just then."""
    place = 0
    for heard_ns, data in on_bus[:-8]:  # the last release the motors, after the last recorded cycle
        while commanded[place][0] < heard_ns - FRESH_NS:
            place += 1
        recent = (recorded for time_ns, recorded in commanded[place : place + 50] if time_ns <= heard_ns)
        assert data in recent, f"stale at {heard_ns}"

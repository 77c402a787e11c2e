"""Recorded drives once more on the kernel's buses: a robot of each kind, one with a bus in front and one behind.

The offset-differential one is in test_vcan_replay.py. Their sessions are made in virtual time, in here.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from replay.compare.verify import verify
from replay.sessions.reader import open_session
from tests.redriven import on_two_buses, short_drive
from tests.vm.test_vcan_replay import replay
from tests.vm.vcan_robot import candump, fresh_vcan0, heard, paced, shell

pytestmark = pytest.mark.vcan

TICK_MS = "10"
PACE = 0.5  # of the speeds: a command that comes late matters the less
SLOWER = (  # than the other tests: each robot has more motors, or another bus
    ("\nrate = 50.0\n\n", "\nrate = 15.0\n\n"),  # of a sensor
    ("[loop]\nrate = 100.0", "[loop]\nrate = 50.0"),
)


def slow(text: str) -> str:
    text = paced(text)
    for before, after in SLOWER:
        text = text.replace(before, after)
    return text


@pytest.fixture
def _two_buses() -> Iterator[None]:
    fresh_vcan0()
    shell("ip link del vcan1 2>/dev/null; ip link add dev vcan1 type vcan; ip link set vcan1 up")
    yield
    shell("ip link del vcan1")


@pytest.mark.usefixtures("_two_buses")
def test_each_of_two_buses_on_an_interface_of_its_own(tmp_path: Path) -> None:
    session = short_drive("omni4", tmp_path / "first", edit=lambda text: on_two_buses(slow(text)), pace=PACE)
    out, log = tmp_path / "second", tmp_path / "candump.log"
    channels = ("--channel", "rear=vcan0", "--channel", "front=vcan1")
    with candump(log, "vcan1"):
        code, report = replay("run", str(session.path), *channels, "--out", str(out), "--tick", TICK_MS)
    assert code == 0, report
    assert report["modes_redriven"] == report["modes_recorded"]
    again = open_session(Path(str(report["session"])))
    assert {frame.bus for inputs, _ in again.cycles() for frame in inputs.frames} == {"front", "rear"}
    assert {frame.id for frame in heard(log)} == {0x200, 0x201, 0x202}  # commands, and the front motors' feedback
    assert verify(again).identical


@pytest.mark.usefixtures("_two_buses")
@pytest.mark.parametrize("name", ["mecanum4", "odd"])
def test_the_other_kinds_drive_alike(name: str, tmp_path: Path) -> None:
    session = short_drive(name, tmp_path / "first", edit=slow, pace=PACE)
    places = ("--channel", "vcan0", "--out", str(tmp_path / "second"), "--tick", TICK_MS)
    code, report = replay("run", str(session.path), *places)
    assert code == 0, report
    assert report["modes_redriven"] == report["modes_recorded"]

"""How controllers are recognised on an unknown bus: examples of the protocols, and simulated drives."""

import pytest

from drivers import DRIVERS
from drivers.sighting import Evidence, Sighting
from gateway.types import ZERO_TWIST, Twist
from tests.drivers.rig import can_frame
from tests.world import World

ROBOTS = ("moby", "omni4", "omni4_gm6020", "omni4_vesc")


def readings(text: str) -> list[Sighting]:
    return [one for driver in DRIVERS.values() for one in driver.sighted(can_frame(text, received_ns=0))]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        # Worked examples of the makers' references.
        ("061#0000000101030000", ("odrive", ("0.6",), 3, Evidence.PROOF)),
        ("061#4000000001010080", ("odrive", ("0.5",), 3, Evidence.PROOF)),
        ("069#000028C152B81E40", ("odrive", ("0.5", "0.6"), 3, Evidence.TALK)),
        ("067#0800000000000000", ("odrive", ("0.5", "0.6"), 3, Evidence.COMMAND)),
        ("06D#00002040CDCCCC3D", ("odrive", ("0.5", "0.6"), 3, Evidence.COMMAND)),
        ("0000000A#000061A8", ("vesc", ("vesc",), 10, Evidence.COMMAND)),
        ("0000030A#FFFFF254", ("vesc", ("vesc",), 10, Evidence.COMMAND)),
        ("0000090A#FFFFF254FF85FF69", ("vesc", ("vesc",), 10, Evidence.PROOF)),
        ("0000100A#01A1027800232328", ("vesc", ("vesc",), 10, Evidence.PROOF)),
        ("00001B0A#0001E24000F10000", ("vesc", ("vesc",), 10, Evidence.PROOF)),
        ("00000801#0A01320000800005", ("vesc", ("vesc",), 10, Evidence.PROOF)),
        ("00001280#0A00", ("vesc", ("vesc",), 10, Evidence.PROOF)),
        ("201#1000F1F0F99A2900", ("dji", ("c620",), 1, Evidence.PROOF)),
        ("204#1000F1F0F99A0000", ("dji", ("c610",), 4, Evidence.PROOF)),
        ("20B#1000000000002900", ("dji", ("gm6020",), 7, Evidence.PROOF)),
        ("201#2000F1F0F99A2900", ("dji", ("c620", "c610"), 1, Evidence.AGAINST)),
    ],
)
def test_examples(text: str, expected: tuple[str, tuple[str, ...], int, Evidence]) -> None:
    found = [(one.driver, one.variants, one.id, one.evidence) for one in readings(text)]
    assert expected in found
    if expected[3] is Evidence.PROOF:
        assert [one for one in found if one[3] is Evidence.PROOF] == [expected]


def test_what_is_told_in_words() -> None:
    told = {text: dict(readings(text)[0].told) for text in ("061#0000000101030000", "00001B0A#0001E24000F10000")}
    assert told["061#0000000101030000"] == {"state": "IDLE", "error": "WATCHDOG_TIMER_EXPIRED"}
    assert told["00001B0A#0001E24000F10000"] == {"voltage": "24.1 V"}
    (fault,) = readings("00000801#0A01320000800005")
    assert dict(fault.told) == {"error": "OVER_TEMP_FET"}


def test_a_command_of_four_is_one_for_each_slot_that_is_used() -> None:
    found = [(one.driver, one.id) for one in readings("200#0666F99A00004000") if one.driver == "dji"]
    assert sorted(set(found)) == [("dji", 1), ("dji", 2), ("dji", 4)]


def test_a_heartbeat_that_no_firmware_knows_speaks_against_it() -> None:
    (found,) = [one for one in readings("201#100000001E000000") if one.driver == "odrive"]
    assert (found.id, found.evidence) == (16, Evidence.AGAINST)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_drive_is_seen_as_what_it_is(name: str) -> None:
    world = World(name)
    world.start()
    world.run(0.3, Twist(0.3, 0.0, 0.0))
    world.run(0.2, ZERO_TWIST)
    motors = {(motor.driver, motor.id): motor.variant for motor in world.config.motor}
    drivers = {driver for driver, _ in motors}
    proven, commanded = set(), set()
    for inputs, outputs in world.records:
        for frames, host in ((inputs.frames, False), (outputs.frames, True)):
            for frame in frames:
                for one in [one for driver in drivers for one in DRIVERS[driver].sighted(frame)]:
                    if motors.get((one.driver, one.id)) not in one.variants:
                        continue
                    assert one.evidence is not Evidence.AGAINST
                    assert (one.evidence is Evidence.COMMAND) <= host
                    assert (one.evidence is Evidence.PROOF) <= (not host)
                    if one.evidence is Evidence.PROOF:
                        proven.add((one.driver, one.id))
                    if one.evidence is Evidence.COMMAND:
                        commanded.add((one.driver, one.id))
    assert proven == commanded == set(motors)

"""What a frame would mean to an ODrive of either firmware; see drivers/sighting.py."""

from collections.abc import Callable, Collection
from enum import IntEnum
from math import tau
from typing import Final

from drivers.contract import CanFrame
from drivers.odrive import tables
from drivers.odrive.endpoints import version_request
from drivers.odrive.firmware import FIRMWARES, error_words, told_versions
from drivers.odrive.renaming import serial_of
from drivers.sighting import Evidence, Sighting

NAME: Final = "odrive"
LAST_NODE: Final = 62
BOTH: Final = ("0.5", "0.6")
FASTEST: Final = 1000.0  # rev/s that a rotor may tell; source: ours
FURTHEST: Final = 1e7  # rev


class StateWord(IntEnum):
    """Axis states in words; ODrive Firmware/odrive-interface.yaml, and enums.py of 0.6.11."""

    IDLE = 1
    STARTUP_SEQUENCE = 2
    FULL_CALIBRATION_SEQUENCE = 3
    MOTOR_CALIBRATION = 4
    ENCODER_INDEX_SEARCH = 6
    ENCODER_OFFSET_CALIBRATION = 7
    CLOSED_LOOP_CONTROL = 8
    LOCKIN_SPIN = 9
    ENCODER_DIR_FIND = 10
    HOMING = 11
    ENCODER_HALL_POLARITY_CALIBRATION = 12
    ENCODER_HALL_PHASE_CALIBRATION = 13
    ANTICOGGING_CALIBRATION = 14
    HARMONIC_CALIBRATION = 15
    HARMONIC_CALIBRATION_COMMUTATION = 16


STATE_WORDS: Final[dict[int, str]] = {state.value: state.name for state in StateWord}
LAST_RESULT: Final = 16  # of PROCEDURE_RESULTS_06


def sighted(frame: CanFrame) -> Sighting | None:
    """What this frame is to an ODrive; None: nothing."""
    node, command = frame.id >> tables.NODE_SHIFT, frame.id & tables.COMMAND_MASK
    if frame.extended or frame.remote or frame.fd or not 0 <= node <= LAST_NODE:
        return None
    read = _READERS.get(command)
    if read is not None:
        return read(node, frame.data)
    for variant in BOTH:
        firmware = FIRMWARES[variant]
        for messages, evidence in ((firmware.to_device, Evidence.COMMAND), (firmware.from_device, Evidence.TALK)):
            if command in messages:
                return Sighting(NAME, BOTH, node, messages[command].name, evidence)
    return None


def questions(bus: str, heard: Collection[int]) -> list[CanFrame]:
    """Asks those that were heard for their firmware; 0.5 does not answer, but its watchdog is fed, this once.

    Nobody else is asked: to another controller the id might mean something.
    """
    return [version_request(node)._replace(bus=bus) for node in sorted(heard)]


def _heartbeat(node: int, data: bytes) -> Sighting:
    variants: list[str] = []
    told: tuple[tuple[str, str], ...] = ()
    for variant in BOTH:
        firmware = FIRMWARES[variant]
        message = firmware.from_device[tables.HEARTBEAT]
        if len(data) < message.layout.size or not _fits(variant, data):
            continue
        errors, state, _ = firmware.heartbeat(message.layout.unpack(data))
        if errors & ~_known(variant) or state not in STATE_WORDS:
            continue
        variants.append(variant)
        told = (("state", STATE_WORDS[state]), ("error", error_words(errors, firmware.errors)))
    evidence = Evidence.PROOF if variants else Evidence.AGAINST
    return Sighting(NAME, tuple(variants) or BOTH, node, "Heartbeat", evidence, told)


def _fits(variant: str, data: bytes) -> bool:
    """Bytes 5 to 7: procedure result, trajectory done, nothing; of 0.5 three error flags, the last with bit 7."""
    if variant == "0.6":
        return data[5] <= LAST_RESULT and data[6] <= 1 and data[7] == 0
    return data[5] <= 1 and data[6] <= 1 and data[7] & 0x7E == 0


def _known(variant: str) -> int:
    known = 0
    for bit in FIRMWARES[variant].errors:
        known |= bit
    return known


def _estimates(node: int, data: bytes) -> Sighting:
    message = tables.COMMON_FROM_DEVICE[tables.GET_ENCODER_ESTIMATES]
    if len(data) < message.needed:
        return Sighting(NAME, BOTH, node, message.name, Evidence.AGAINST)
    position, velocity = message.layout.unpack_from(data)
    if not (abs(position) <= FURTHEST and abs(velocity) <= FASTEST):  # NaN is in no range
        return Sighting(NAME, BOTH, node, message.name, Evidence.AGAINST)
    return Sighting(NAME, BOTH, node, message.name, Evidence.TALK, angle=position * tau, velocity=velocity * tau)


def _version(node: int, data: bytes) -> Sighting:
    message = tables.FROM_DEVICE_06[tables.GET_VERSION]
    if len(data) < message.needed:
        return Sighting(NAME, BOTH, node, message.name, Evidence.TALK)
    items = message.layout.unpack_from(data)
    protocol, _, _, _, major, minor, _, _ = items
    if protocol == 0 or major != 0 or minor < 6:
        return Sighting(NAME, BOTH, node, message.name, Evidence.TALK)
    firmware, hardware = told_versions(items)
    told = (("firmware", firmware), ("hardware", hardware))
    return Sighting(NAME, ("0.6",), node, message.name, Evidence.TALK, told)


def _address(node: int, data: bytes) -> Sighting:
    """Of an ODrive itself, which tells its own node; else a host gives somebody another one."""
    serial = serial_of(node, data)
    if serial is None:
        return Sighting(NAME, BOTH, node, "Address", Evidence.COMMAND)
    return Sighting(NAME, ("0.6",), node, "Address", Evidence.TALK, (("serial", f"{serial:012X}"),))


_READERS: Final[dict[int, Callable[[int, bytes], Sighting]]] = {
    tables.HEARTBEAT: _heartbeat,
    tables.GET_ENCODER_ESTIMATES: _estimates,
    tables.GET_VERSION: _version,
    tables.ADDRESS: _address,
}

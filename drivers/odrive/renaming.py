"""Another id for an ODrive, by its serial number: so two that are fresh from the factory are told apart.

How this works
--------------
Firmware 0.6: asked by a remote frame to the node of all (0x3F), every ODrive answers Address, with its node id and its
serial number, whatever its id. Address from the host to the node of all gives the ODrive of that serial number a node
id; another one that had it gives it up and has none (0x3F). Reboot with 1 saves the configuration and starts it anew;
without it a power cut brings the old id back. Sources: the vendor's can_enumerate.py (ODriveResources) and
odrive-cansimple-0.6.10.dbc, read and not run on hardware. Unverified: that answers are spread over some 0.5 s, so that
two of one id do not collide for good; ask again. Firmware 0.5 has one message for that, which renames all that have the
old id, and cannot save over CAN: it is set over USB.
"""

from typing import Final

from drivers.contract import CanFrame, Identity, RenamingOverCan
from drivers.odrive import tables
from drivers.records import data_frame

EVERYBODY: Final = 0x3F  # and the node of one that has none
SAVE: Final = 1  # of Reboot
SERIAL_BYTES: Final = 6
_SIZE: Final = 1 + SERIAL_BYTES


def _ask(bus: str) -> list[CanFrame]:
    return [CanFrame(bus, EVERYBODY << tables.NODE_SHIFT | tables.ADDRESS, b"", remote=True)]


def _told(frame: CanFrame) -> Identity | None:
    """An answer: the node of its id is that of its data, which what the host itself sends to everybody is not."""
    if frame.extended or frame.remote or frame.fd or frame.id & tables.COMMAND_MASK != tables.ADDRESS:
        return None
    sender, data = frame.id >> tables.NODE_SHIFT, frame.data
    if len(data) < _SIZE or data[0] != sender:
        return None
    serial = int.from_bytes(data[1:_SIZE], "little")
    return Identity(serial, None if sender == EVERYBODY else sender)


def _give(bus: str, serial: int, node: int) -> list[CanFrame]:
    data = bytes([node]) + serial.to_bytes(SERIAL_BYTES, "little")
    return [data_frame(bus, EVERYBODY << tables.NODE_SHIFT | tables.ADDRESS, data)]


def _keep(bus: str, node: int) -> list[CanFrame]:
    return [data_frame(bus, node << tables.NODE_SHIFT | tables.REBOOT, bytes([SAVE]))]


def claim(node: int) -> int:
    """The identifier that whoever commands this node holds."""
    return node << tables.NODE_SHIFT | tables.SET_AXIS_STATE


OVER_CAN: Final = RenamingOverCan(_ask, _told, _give, _keep, claim)


def over_usb(node: int) -> tuple[str, ...]:
    """What a person does for this id; ODrive docs/can-protocol.rst of 0.5."""
    return (
        "connect the board by USB and start odrivetool",
        f"odrv0.axis0.config.can.node_id = {node}   (or axis1: each has its own)",
        "odrv0.save_configuration(), which starts it anew",
    )

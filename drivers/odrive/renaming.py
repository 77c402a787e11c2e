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
from drivers.odrive.endpoints import save_request
from drivers.records import data_frame

EVERYBODY: Final = 0x3F  # and the node of one that has none
_ADDRESS: Final = tables.TO_DEVICE_06[tables.ADDRESS]
_NODE, _SERIAL = _ADDRESS.fields


def _ask(bus: str) -> list[CanFrame]:
    return [CanFrame(bus, EVERYBODY << tables.NODE_SHIFT | tables.ADDRESS, b"", remote=True)]


def serial_of(sender: int, data: bytes) -> int | None:
    """Serial number in an Address from this node; None: no answer, of which the node tells its own id."""
    told = _ADDRESS.values(data)
    if told is None:
        return None
    (_, node), (_, serial) = told
    return int(serial) if node == sender else None


def _told(frame: CanFrame) -> Identity | None:
    """An answer, which what the host itself sends to everybody is not."""
    if frame.extended or frame.remote or frame.fd or frame.id & tables.COMMAND_MASK != tables.ADDRESS:
        return None
    sender = frame.id >> tables.NODE_SHIFT
    serial = serial_of(sender, frame.data)
    return None if serial is None else Identity(serial, None if sender == EVERYBODY else sender)


def _give(bus: str, serial: int, node: int) -> list[CanFrame]:
    data = _ADDRESS.layout.pack(node << _NODE.shift | serial << _SERIAL.shift)[: _ADDRESS.needed]
    return [data_frame(bus, EVERYBODY << tables.NODE_SHIFT | tables.ADDRESS, data)]


def _keep(bus: str, node: int) -> list[CanFrame]:
    return [save_request(node)._replace(bus=bus)]


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

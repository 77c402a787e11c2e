"""Parameters of an ODrive 0.6 over CAN: the vendor's flat_endpoints.json, and the frames that read and write them.

The file says which number a parameter has in one firmware on one hardware, and its type. Its form and the frames are
as in the vendor's examples (github odriverobotics/ODriveResources, examples/can_param_access.py): a value has as many
bytes as its type, a read has none, and from 0.6.11 on a write is confirmed by a TxSdo of its own.
"""

import json
from collections.abc import Mapping
from re import fullmatch
from struct import Struct, error
from typing import Any, Final, NamedTuple

from drivers.contract import CanFrame
from drivers.odrive import tables

_HEAD: Final = Struct("<BHB")  # opcode, endpoint, reserved
_VALUES: Final = {  # what fits a classic frame
    "bool": Struct("<?"),
    "uint8": Struct("<B"),
    "int8": Struct("<b"),
    "uint16": Struct("<H"),
    "int16": Struct("<h"),
    "uint32": Struct("<I"),
    "int32": Struct("<i"),
    "float": Struct("<f"),
}
_THREE: Final = r"\d{1,3}\.\d{1,3}\.\d{1,3}"
LARGEST: Final = 0xFFFF

Value = bool | int | float


class EndpointError(ValueError):
    """What is wrong with the vendor's file; the text says where."""


class Endpoint(NamedTuple):
    """One parameter in one firmware."""

    path: str
    number: int
    type: str

    def raw(self, value: Value) -> bytes:
        """As it goes over the bus. Raises EndpointError for a value that its type has not."""
        try:
            return _VALUES[self.type].pack(value)
        except error as flaw:
            raise EndpointError(f"{self.path} = {value}: is no {self.type}: {flaw}") from None

    def value(self, raw: bytes) -> Value | None:
        """The other way round; None where there are too few bytes."""
        layout = _VALUES[self.type]
        found: Value | None = layout.unpack_from(raw)[0] if len(raw) >= layout.size else None
        return found


class FlatEndpoints(NamedTuple):
    """The vendor's file: of which firmware and hardware, as Get_Version tells them, and its parameters by path."""

    firmware: str
    hardware: str
    endpoints: Mapping[str, Endpoint]


def read_flat(text: str) -> FlatEndpoints:
    """From the text of flat_endpoints.json. Raises EndpointError."""
    try:
        document = json.loads(text)
    except ValueError as flaw:
        raise EndpointError(f"is no JSON: {flaw}") from None
    if not isinstance(document, dict) or not isinstance(document.get("endpoints"), dict):
        raise EndpointError("has no endpoints: must be flat_endpoints.json as the vendor publishes it")
    firmware, hardware = _version(document, "fw_version"), _version(document, "hw_version")
    found = {path: _endpoint(path, entry) for path, entry in document["endpoints"].items()}
    return FlatEndpoints(firmware, hardware, {path: one for path, one in found.items() if one is not None})


def read_request(node: int, endpoint: Endpoint) -> CanFrame:
    """Asks for its value."""
    return _request(node, _HEAD.pack(tables.SDO_READ, endpoint.number, 0))


def write_request(node: int, endpoint: Endpoint, raw: bytes) -> CanFrame:
    """Puts a value into it."""
    return _request(node, _HEAD.pack(tables.SDO_WRITE, endpoint.number, 0) + raw)


def answered(node: int, endpoint: Endpoint, frame: CanFrame) -> bytes | None:
    """The value that this node tells of it in this frame; None: it tells something else."""
    if frame.id != node << tables.NODE_SHIFT | tables.TX_SDO or frame.extended or frame.remote or frame.fd:
        return None
    if len(frame.data) <= _HEAD.size or _HEAD.unpack_from(frame.data)[1] != endpoint.number:
        return None
    return frame.data[_HEAD.size :]


def version_request(node: int) -> CanFrame:
    """Asks for firmware and hardware."""
    return CanFrame("", node << tables.NODE_SHIFT | tables.GET_VERSION, b"", remote=True)


def save_request(node: int) -> CanFrame:
    """Has it save its settings, and restart."""
    return CanFrame("", node << tables.NODE_SHIFT | tables.REBOOT, bytes((tables.REBOOT_SAVE,)))


def _request(node: int, data: bytes) -> CanFrame:
    return CanFrame("", node << tables.NODE_SHIFT | tables.RX_SDO, data)


def _version(document: Mapping[str, Any], key: str) -> str:
    """Three numbers; the firmware's may have more behind a dash."""
    given = document.get(key)
    version = given.partition("-")[0] if isinstance(given, str) else ""
    if fullmatch(_THREE, version) is None:
        raise EndpointError(f'{key} = {given!r}: must be three numbers like "0.6.10"')
    return version


def _endpoint(path: str, entry: object) -> Endpoint | None:
    """None: no parameter of a kind that is read or written here (a function, a text, a 64 bit number)."""
    if not isinstance(entry, dict):
        raise EndpointError(f"endpoints.{path}: must have id and type")
    kind, number = entry.get("type"), entry.get("id")
    if kind not in _VALUES:
        return None
    if type(number) is not int or not 0 < number <= LARGEST:
        raise EndpointError(f"endpoints.{path}.id = {number!r}: must be 1 to {LARGEST}")
    return Endpoint(path, number, kind)

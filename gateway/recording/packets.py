"""What the service and its recorder process say to each other: packets of msgpack, one per cycle and direction."""

from typing import NamedTuple

import msgspec

from gateway.core.snapshot import State
from gateway.types import CycleTiming, Inputs, Outputs


class Hello(NamedTuple):
    """First packet to a recorder process. `folder`: the session to go on with; None starts a new one.

    `config_json` is what the service runs with, which a command line may have changed; `config_text` is the file.
    `plant`: by what a simulated robot moves; None: nothing is simulated. `imported`: as of the header. `chain`: in the
    last report of the process before this one.
    """

    config_json: str
    config_text: str
    config_origin: str
    folder: str | None
    started_wall_ns: int
    wall_minus_mono_ns: int
    plant: str | None = None
    imported: str | None = None
    chain: str | None = None


class Record(msgspec.Struct, frozen=True, array_like=True, tag="cycle"):
    """One cycle, as the service saw it."""

    inputs: Inputs
    outputs: Outputs
    timing: CycleTiming


class Snapshot(msgspec.Struct, frozen=True, array_like=True, tag="snapshot"):
    """State of the core after this cycle (`Engine.snapshot`, packed): from here a replay can begin."""

    cycle: int
    state: bytes

    @classmethod
    def of(cls, cycle: int, state: State) -> "Snapshot":
        """Raises TypeError, ValueError, OverflowError on a state that is no plain data."""
        return cls(cycle, encode(state))


class Gap(msgspec.Struct, frozen=True, array_like=True, tag="gap"):
    """Cycles that are missing from the recording, first to last, and why."""

    first_cycle: int
    last_cycle: int
    reason: str


class End(msgspec.Struct, frozen=True, array_like=True, tag="end"):
    """The last packet of a service that ends in order: every cycle has come before it, or its gap has."""


class IncidentReport(NamedTuple):
    """How incidents stand, since the start of the recorder process: how many are kept, and how many could not be.

    `file`: the last one kept; `error`: of the last one, None: it is kept; `pending`: one is being collected or written.
    """

    kept: int
    failed: int
    file: str | None
    error: str | None
    pending: bool


class RecorderReport(NamedTuple):
    """State of the recorder process; each report replaces the one before.

    `records` came in and are dealt with, the last of them `settled_cycle`; `lost` of them are not on the disk.
    `error` None: all is well. `chain`: value of the digest chain (`gateway.recording.chain`) up to there, hex.
    `folder`: empty where no session is recorded. `incidents`: None: none are to be kept.
    """

    folder: str
    segment: int
    records: int
    settled_cycle: int | None
    lost: int
    error: str | None
    closed: bool
    chain: str | None = None
    incidents: IncidentReport | None = None


Packet = Record | Snapshot | Gap | End

SNAPSHOT_PERIOD_NS = 5_000_000_000  # of taking one: 0.2 ms in the loop, some 3 kB on the disk
PACKET_LIMIT = 1 << 20  # bytes; a cycle of 1 MB has some 40 000 frames

_encoder = msgspec.msgpack.Encoder()
_packets: msgspec.msgpack.Decoder[Packet] = msgspec.msgpack.Decoder(Packet)
_hellos = msgspec.msgpack.Decoder(Hello)
_reports = msgspec.msgpack.Decoder(RecorderReport)

encode = _encoder.encode
decode_packet = _packets.decode
decode_hello = _hellos.decode
decode_report = _reports.decode

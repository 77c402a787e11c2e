"""A network interface as `ip -details -statistics -json link show` describes it (iproute2)."""

from typing import NamedTuple

import msgspec


class CanLink(NamedTuple):
    """State of a CAN interface; None: `ip` does not say."""

    kind: str | None  # can, vcan, ...
    up: bool
    queue: int
    mtu: int | None  # 16: frames of classic CAN only
    bitrate: int | None
    fd: bool
    data_bitrate: int | None  # of CAN FD
    restart_ms: int | None
    state: str | None  # of the controller: ERROR-ACTIVE, ERROR-WARNING, ERROR-PASSIVE, BUS-OFF, STOPPED
    errors: tuple[int, int] | None  # transmit and receive error counter
    bus_offs: int | None
    dropped: int | None  # frames received and lost


class _BitTiming(msgspec.Struct):
    bitrate: int | None = None


class _Counter(msgspec.Struct):
    tx: int = 0
    rx: int = 0


class _Data(msgspec.Struct):
    state: str | None = None
    restart_ms: int = 0
    ctrlmode: list[str] = []
    bittiming: _BitTiming = msgspec.field(default_factory=_BitTiming)
    data_bittiming: _BitTiming = msgspec.field(default_factory=_BitTiming)
    berr_counter: _Counter | None = None


class _Extra(msgspec.Struct):
    bus_off: int | None = None


class _Info(msgspec.Struct):
    info_kind: str | None = None
    info_data: _Data = msgspec.field(default_factory=_Data)
    info_xstats: _Extra = msgspec.field(default_factory=_Extra)


class _Received(msgspec.Struct):
    dropped: int | None = None


class _Statistics(msgspec.Struct):
    rx: _Received = msgspec.field(default_factory=_Received)


class _Link(msgspec.Struct):
    flags: list[str] = []
    txqlen: int = 0
    mtu: int | None = None
    linkinfo: _Info = msgspec.field(default_factory=_Info)
    stats64: _Statistics = msgspec.field(default_factory=_Statistics)


def parse_link(text: str) -> CanLink | None:
    """The interface in the output of `ip`; None if there is none."""
    try:
        links = msgspec.json.decode(text, type=list[_Link])
    except msgspec.MsgspecError:
        return None
    if not links:
        return None
    info, data = links[0].linkinfo, links[0].linkinfo.info_data
    counter = data.berr_counter
    return CanLink(
        kind=info.info_kind,
        up="UP" in links[0].flags,
        queue=links[0].txqlen,
        mtu=links[0].mtu,
        bitrate=data.bittiming.bitrate,
        fd="FD" in data.ctrlmode,
        data_bitrate=data.data_bittiming.bitrate,
        restart_ms=data.restart_ms if info.info_kind == "can" else None,
        state=data.state,
        errors=None if counter is None else (counter.tx, counter.rx),
        bus_offs=info.info_xstats.bus_off,
        dropped=links[0].stats64.rx.dropped,
    )

"""The last seconds of a drive in memory, packed, from a state of the core on.

How this works
--------------
Packets are kept as they came, some 64 kB of them compressed together: 150 bytes per cycle at 1 kHz, 300 at 250 Hz. A
piece begins anew where a snapshot of the core comes, so that what is kept always can begin with one; the oldest pieces
are forgotten once a later one begins with a snapshot that is old enough.
"""

import zlib
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from gateway.recording.packets import SNAPSHOT_PERIOD_NS, Packet, decode_packet, encode

PIECE_BYTES = 65_536
RING_BYTES = 64_000_000  # packed, at most
LATE_NS = 3 * SNAPSHOT_PERIOD_NS  # a snapshot that has not come by then does not come
_LEVEL = 1  # of compression: 3 us of a cycle at 1 kHz; more takes twice the time for 2 % less

_lists = msgspec.msgpack.Decoder(list[bytes])


class _Piece(NamedTuple):
    begin_ns: int  # of the cycle before its first packet
    known: bool  # it begins with a snapshot
    packed: bytes


class Ring:
    """One writer; times are those of the cycles. `most`: bytes in all, `piece`: of packets compressed together."""

    def __init__(self, most: int = RING_BYTES, piece: int = PIECE_BYTES) -> None:
        self._most = most
        self._piece = piece
        self._pieces: deque[_Piece] = deque()
        self._bytes = 0
        self._open: list[bytes] = []
        self._open_bytes = 0
        self._open_known = False
        self._begin_ns = 0
        self._now_ns = 0

    @property
    def size(self) -> int:
        """Bytes that it takes up, but for the overhead of objects."""
        return self._bytes + self._open_bytes

    def cycle(self, packet: bytes, now_ns: int) -> None:
        """Keep a cycle."""
        if not self._open:
            self._begin_ns = self._now_ns or now_ns
        self._now_ns = now_ns
        self._keep(packet)

    def snapshot(self, packet: bytes) -> None:
        """Keep the state of the core behind the last cycle."""
        self._close()
        self._begin_ns, self._open_known = self._now_ns, True
        self._keep(packet)

    def gap(self, packet: bytes) -> None:
        """Keep the word that cycles are missing here."""
        if not self._open:
            self._begin_ns = self._now_ns
        self._keep(packet)

    def forget(self, before_ns: int) -> None:
        """What nobody will ask for: what lies in front of the last snapshot from before that time."""
        while self._first_needed(before_ns) > 0 or self._is_too_much(before_ns):
            self._bytes -= len(self._pieces.popleft().packed)

    def since(self, since_ns: int) -> list[bytes]:
        """Pieces from the last snapshot on that is not behind that time, or from where it begins."""
        self._close()
        first = self._first_needed(since_ns)
        return [piece.packed for piece in list(self._pieces)[first:]]

    def _first_needed(self, since_ns: int) -> int:
        places = [place for place, piece in enumerate(self._pieces) if piece.known and piece.begin_ns <= since_ns]
        return places[-1] if places else 0

    def _is_too_much(self, before_ns: int) -> bool:
        if not self._pieces:
            return False
        return self.size > self._most or self._pieces[0].begin_ns < before_ns - LATE_NS

    def _keep(self, packet: bytes) -> None:
        self._open.append(packet)
        self._open_bytes += len(packet)
        if self._open_bytes >= self._piece:
            self._close()

    def _close(self) -> None:
        if not self._open:
            return
        packed = zlib.compress(encode(self._open), _LEVEL)
        self._pieces.append(_Piece(self._begin_ns, self._open_known, packed))
        self._bytes += len(packed)
        self._open, self._open_bytes, self._open_known = [], 0, False


def packets(piece: bytes) -> Sequence[Packet]:
    """What is in a piece."""
    return [decode_packet(packet) for packet in _lists.decode(zlib.decompress(piece))]

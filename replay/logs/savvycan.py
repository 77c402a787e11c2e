"""SavvyCAN's CSV (GVRET): a line per frame, with its time in us and the columns that the first line names."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain

from drivers.contract import CanFrame
from replay.logs.logged import EPOCH_BEGINS_NS, MAX_LENGTH, Account, Clock, Logged, UnreadError, each_line, sound

HEAD = re.compile(r"\s*Time Stamp,ID,Extended,", re.IGNORECASE)
_MICROSECOND_NS = 1000
_BYTES = tuple(f"d{number}" for number in range(1, 65))
_TRUTH = {"true": True, "1": True, "false": False, "0": False}


def is_savvycan(lines: Iterable[str]) -> bool:
    """Whether one of these names the columns of such a log."""
    return any(HEAD.match(line) for line in lines)


def frames(text: Iterable[str], account: Account) -> Iterator[Logged]:
    """Every frame of these lines; what is none is in the account."""
    account.style, account.clock = "SavvyCAN CSV", Clock.BEGINNING
    log = _Log()
    found = each_line(text, account, log.frame)
    for first in found:
        if first.time_ns is not None and first.time_ns >= EPOCH_BEGINS_NS:
            account.clock = Clock.EPOCH
        yield from chain([first], found)


class _Log:
    def __init__(self) -> None:
        self._places: Mapping[str, int] = {}

    def frame(self, line: str) -> Logged | None:
        """The frame of a line, None if there is none. Raises UnreadError."""
        cells = [cell.strip() for cell in line.split(",")]
        if HEAD.match(line):
            self._places = {name.lower(): place for place, name in enumerate(cells)}
            return None
        if not any(cells):
            return None
        try:
            return self._made(cells)
        except (KeyError, IndexError):
            raise UnreadError("a line with fewer cells than there are columns") from None
        except UnreadError:
            raise
        except ValueError:
            raise UnreadError("a cell that is no number") from None

    def _made(self, cells: Sequence[str]) -> Logged:
        """Raises KeyError, IndexError, ValueError."""
        stamp, identifier, extended, bus, length = (
            cells[self._places[name]] for name in ("time stamp", "id", "extended", "bus", "len")
        )
        size = int(length)
        if not 0 <= size <= len(_BYTES):
            raise UnreadError("more or less data than a frame can have")
        data = bytes(int(cells[self._places[name]], 16) for name in _BYTES[:size])
        time_ns = int(stamp) * _MICROSECOND_NS
        if time_ns < 0 or extended.lower() not in _TRUTH:
            raise ValueError(stamp)
        frame = CanFrame(bus, int(identifier, 16), data, _TRUTH[extended.lower()], fd=size > MAX_LENGTH)
        direction = cells[self._places["dir"]].lower() if "dir" in self._places else ""
        return Logged(time_ns, sound(frame), {"tx": True, "rx": False}.get(direction))

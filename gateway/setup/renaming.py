"""Another id for a controller: who is there by serial number, or which id went and which one came. Pure."""

from collections.abc import Callable, Iterable, Mapping
from typing import Final, NamedTuple

from drivers import DRIVERS
from drivers.contract import CanFrame, Identity, RenamingOverCan
from drivers.sighting import Evidence
from gateway.setup.census import Found

KINDS: Final[dict[str, tuple[str, str]]] = {
    (f"{name}-{variant}" if variant[0].isdigit() else variant): (name, variant)
    for name, driver in DRIVERS.items()
    for variant in driver.variants
}
HEARD: Final = 3  # frames, from which an id counts as heard
GONE_NS: Final = 2_500_000_000  # without a frame
SETTLED_NS: Final = 3_000_000_000  # after an id has come, until nothing more is expected
_AT_REST: Final = "IDLE"  # what an ODrive that drives nothing tells of its state
_COMMANDED: Final = "commanded by somebody"


class RenamingError(ValueError):
    """Why no id is given; nothing was changed."""


How = RenamingOverCan | Callable[[int], tuple[str, ...]]


def way(kind: str, to: int | None) -> tuple[str, str, How]:
    """Driver, variant, and how one of this kind gets an id. Raises RenamingError."""
    if kind not in KINDS:
        raise RenamingError(f"{kind}: must be one of {', '.join(KINDS)}")
    driver, variant = KINDS[kind]
    ids, how = DRIVERS[driver].renaming(variant)
    if to is not None and to not in ids:
        raise RenamingError(f"--to {to}: {kind} has an id of {ids.start} to {ids.stop - 1}")
    return driver, variant, how


class RollCall:
    """Controllers that tell their serial numbers; `ids`: by serial number, as last told."""

    def __init__(self, over_can: RenamingOverCan) -> None:
        self.ids: dict[int, int | None] = {}
        self._told = over_can.told

    def take(self, frame: CanFrame) -> None:
        """What was received."""
        one = self._told(frame)
        if one is not None:
            self.ids[one.serial] = one.id

    def chosen(self, serial: str | None) -> Identity:
        """The one meant: by its serial number, or the only one. Raises RenamingError."""
        if not self.ids:
            raise RenamingError("nobody tells a serial number: power, cable, bit rate, firmware?")
        if serial is None:
            if len(self.ids) > 1:
                raise RenamingError(f"--serial is missing: {len(self.ids)} are there: {'; '.join(self.lines())}")
            (one,) = self.ids
            return Identity(one, self.ids[one])
        try:
            one = int(serial, 16)
        except ValueError:
            raise RenamingError(f"--serial {serial}: must be a number in hexadecimal") from None
        if one not in self.ids:
            raise RenamingError(f"--serial {serial}: not there; there is {'; '.join(self.lines())}")
        return Identity(one, self.ids[one])

    def lines(self) -> list[str]:
        """Each in words, by id."""
        return [named(Identity(serial, at)) for serial, at in sorted(self.ids.items(), key=_by_id)]

    def shared(self) -> list[int]:
        """Ids that more than one has."""
        ids = [at for at in self.ids.values() if at is not None]
        return sorted({at for at in ids if ids.count(at) > 1})


def _by_id(entry: tuple[int, int | None]) -> tuple[int, int]:
    return (-1 if entry[1] is None else entry[1]), entry[0]


def named(one: Identity) -> str:
    """In words."""
    return f"serial {one.serial:012X}, " + ("no id" if one.id is None else f"id {one.id}")


def check_free(ids: Mapping[int, int | None], found: Iterable[Found], one: Identity, to: int) -> None:
    """Raises RenamingError where another one has this id; `found`: who was heard, whether it tells a serial or not."""
    for serial, at in ids.items():
        if at == to and serial != one.serial:
            raise RenamingError(f"id {to} is that of serial {serial:012X}: give that one another id first")
    for other in found:
        if other.id == to and to not in ids.values():
            raise RenamingError(f"id {to} is that of {other.name}, which tells no serial: give that one another first")


class RestWatch:
    """What each id of one driver tells of its state: everything, as two may share an id. Listens only."""

    def __init__(self, driver: str) -> None:
        self._driver = driver
        self._states: dict[int, set[str]] = {}

    def take(self, frame: CanFrame) -> None:
        """What was received."""
        for one in DRIVERS[self._driver].sighted(frame):
            states = self._states.setdefault(one.id, set())
            states.update(value for name, value in one.told if name == "state")
            if one.evidence is Evidence.COMMAND:
                states.add(_COMMANDED)

    def check(self, one: Identity) -> None:
        """Raises RenamingError unless all of its id are told to be at rest: one that drives would be let go at once.

        One without an id drives nothing.
        """
        if one.id is None:
            return
        states = self._states.get(one.id, set())
        if states != {_AT_REST}:
            busy = " and ".join(sorted(states - {_AT_REST})) or "in a state that it does not tell"
            raise RenamingError(f"{self._driver} id {one.id} is {busy}: let it go first")


class Change(NamedTuple):
    """Ids that are heard now and were not, and the other way round."""

    came: tuple[int, ...]
    went: tuple[int, ...]


class IdWatch:
    """Which ids of one kind of controller are heard, while a person sets one. Listens only."""

    def __init__(self, driver: str, variant: str) -> None:
        self._driver = driver
        self._variant = variant
        self._heard: dict[int, tuple[int, int]] = {}  # how often, and when last
        self._before: frozenset[int] = frozenset()
        self._came_ns: int | None = None
        self._now_ns = 0

    def take(self, frame: CanFrame) -> None:
        """What was received."""
        self._now_ns = max(self._now_ns, frame.received_ns or 0)
        for one in DRIVERS[self._driver].sighted(frame):
            if one.evidence is Evidence.PROOF and self._variant in one.variants:
                often, _ = self._heard.get(one.id, (0, 0))
                self._heard[one.id] = (often + 1, self._now_ns)
        if self._came_ns is None and self.ids() - self._before:
            self._came_ns = self._now_ns

    def ids(self) -> frozenset[int]:
        """Those that are heard."""
        since_ns = self._now_ns - GONE_NS
        return frozenset(at for at, (often, last_ns) in self._heard.items() if often >= HEARD and last_ns >= since_ns)

    def begin(self) -> None:
        """From here on an id is set."""
        self._before, self._came_ns = self.ids(), None

    @property
    def over(self) -> bool:
        """Whether an id came, and what went with it is gone."""
        return self._came_ns is not None and self._now_ns - self._came_ns >= SETTLED_NS

    def change(self) -> Change:
        """Since `begin`."""
        now = self.ids()
        return Change(tuple(sorted(now - self._before)), tuple(sorted(self._before - now)))

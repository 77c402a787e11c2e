"""Every code that DriveGate and the controllers tell, in words: one table for `doctor --explain` and the docs.

How this works
--------------
The tables are data, by where a code comes from. What can be told is said by the enumerations and registries of the
rooms that tell it; a test walks those, and asks for an entry here for each, and for nothing more.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

from gateway.words.contract import Words
from gateway.words.drivers import DRIVERS
from gateway.words.events import EVENTS
from gateway.words.faults import FAULTS
from gateway.words.odrive import ODRIVE
from gateway.words.sensors import SENSORS
from gateway.words.vesc import VESC

CLEARED: Final = "cleared_"  # before the kind of a fault that is gone
FAULT: Final = "fault_"
TABLES: Final[Mapping[str, Mapping[str, Words]]] = {
    "fault": FAULTS,
    "event": EVENTS,
    "driver": DRIVERS,
    "odrive": ODRIVE,
    "vesc": VESC,
    "sensor": SENSORS,
}
TITLES: Final[Mapping[str, str]] = {
    "fault": "fault, in `faults` of the state and as an event",
    "event": "event",
    "driver": "reason of a driver, behind fault_motor",
    "odrive": "word of an ODrive, in the text of fault_motor",
    "vesc": "word of a VESC, in the text of fault_motor",
    "sensor": "reason of a sensor, in `sensors` of the state",
}
VENDORS: Final[Mapping[str, Mapping[str, Words]]] = {"odrive": ODRIVE, "vesc": VESC, "dji": {}}  # dji tells no errors


class Explanation(NamedTuple):
    """One entry, and the table that it is of."""

    table: str
    code: str
    words: Words


def every() -> list[Explanation]:
    """All there is, table by table."""
    return [Explanation(table, code, words) for table, codes in TABLES.items() for code, words in codes.items()]


def explain(asked: str) -> list[Explanation]:
    """The entries for a code as a person has it, in any case, with or without `fault_`; or of a whole table.

    Empty where there is none.
    """
    wanted = asked.strip().lower()
    if wanted in TABLES:
        return [one for one in every() if one.table == wanted]
    if wanted.startswith(CLEARED):
        wanted = FAULT + wanted.removeprefix(CLEARED)
    return [one for one in every() if one.code.lower() in (wanted, FAULT + wanted)]


def codes() -> list[str]:
    """All there are."""
    return [one.code for one in every()]

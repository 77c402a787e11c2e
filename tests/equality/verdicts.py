"""What `replay verify` says of recorded sessions here: `python -m tests.equality.verdicts SESSION...`, as JSON.

Needs what reading a session needs (numpy, pyarrow, msgspec) besides the core, and nothing else of what a robot needs.
"""

import json
import platform
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from gateway.build import FORM
from replay.compare.differences import differences
from replay.compare.verify import EXIT_DIFFERENT, EXIT_IDENTICAL, verify
from replay.sessions.reader import Session, SessionError, open_session

MOST_SIGNALS = 6  # that are named
Told = Mapping[str, object]


class Verdicts(NamedTuple):
    """What one machine says, by session: the document of `verify --json` without how long it took, and what differs."""

    machine: str
    form: str
    sessions: Mapping[str, Told]


def verdict(path: Path) -> Told:
    """Of one session; `exit_code` and `problem` of what cannot be read."""
    try:
        session = open_session(path)
        told = verify(session).as_json()
        signals = _signals(session) if told["exit_code"] == EXIT_DIFFERENT else []
    except (SessionError, ValueError) as error:
        return {"exit_code": None, "problem": str(error), "first_difference": None, "signals": []}
    del told["realtime_ratio"]
    return told | {"signals": signals}


def _signals(session: Session) -> list[str]:
    """Whatever differs, in the order in which it first does."""
    groups = sorted(differences(session.again()).groups, key=lambda group: group.first_cycle)
    return [
        f"{f'{group.motor} ' if group.motor else ''}{group.field} from cycle {group.first_cycle} on"
        f"{'' if group.largest is None else f' by at most {group.largest:.2g}'}"
        for group in groups
    ]


def problems(here: Mapping[str, Told], there: Mapping[str, Told]) -> list[str]:
    """Whatever is not identical, and whatever is not the same, byte for byte, as here; in words."""
    return [
        f"session {name}: {words}"
        for name, expected in here.items()
        if (words := _problem(expected, there.get(name))) is not None
    ]


def _problem(here: Told, there: Told | None) -> str | None:
    if there is None:
        return "no verdict"
    difference, signals = there["first_difference"], there["signals"]
    if isinstance(difference, Mapping) and isinstance(signals, list):
        more = f", and {len(signals) - MOST_SIGNALS} more" if len(signals) > MOST_SIGNALS else ""
        return f"cycle {difference['cycle']}: {', '.join(signals[:MOST_SIGNALS])}{more}"
    if there["exit_code"] != EXIT_IDENTICAL:
        return f"not identical: {there['problem']}"
    other = [name for name in here if json.dumps(here[name]) != json.dumps(there.get(name))]
    return f"another verdict than here in {', '.join(other)}" if other else None


def main(arguments: Sequence[str]) -> int:
    """Every session that is named, by the name of its folder."""
    sessions = {path.name: verdict(path) for path in map(Path, arguments)}
    sys.stdout.write(json.dumps(Verdicts(platform.machine(), FORM, sessions)._asdict()) + "\n")
    return 0 if sessions else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

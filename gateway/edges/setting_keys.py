"""A key of the robot file where a setting is meant: that needs a restart, but something like it may not."""

from functools import cache

from gateway.config import RobotConfig
from gateway.core.settings import SETTINGS
from gateway.file_keys import Rule, matching, rules


def objection(name: str) -> str | None:
    """Why this is no setting, of a key of the robot file, and what may have been meant; None: it is no such key."""
    if name in SETTINGS:
        return None
    found = matching(_every(), name)
    if not found:
        return None
    near = [row.name for row in SETTINGS.values() if not {rule.key for rule in found}.isdisjoint(row.keys)]
    meant = f"; did you mean {' or '.join(near)}?" if near else ""
    key = name if found[0].key.startswith(name) else found[0].key
    return (
        f"{name}: needs a restart: it is in the robot file ({key}), which is read at the start; settings that can be "
        f"changed while it runs: {', '.join(SETTINGS)}{meant}"
    )


@cache
def _every() -> tuple[Rule, ...]:
    """Looked up once: anybody may ask as often as he likes, and it takes 10 ms."""
    return tuple(rules(RobotConfig))

"""What a scenario expects of its drive: each expectation watches every cycle and says in the end what was broken."""

from collections.abc import Callable, Iterable

from gateway.types import Mode
from replay.drive.moment import Moment
from replay.drive.scenario_file import Expect, Scenario

Holds = Callable[[Moment], bool]
Found = Callable[[Moment], str]


class Watcher:
    """One condition in one window. `always`: it must hold in every cycle there; otherwise in one is enough."""

    def __init__(
        self, words: str, *, start: float, end: float, always: bool, holds: Holds, found: Found | None = None
    ) -> None:
        self._words = f"{words} from {start:g} to {end:g} s" if always else f"{words} between {start:g} and {end:g} s"
        self._start = start
        self._end = end
        self._always = always
        self._holds = holds
        self._found = found
        self._seen = 0
        self._held = 0
        self._broken: str | None = None

    def watch(self, moment: Moment) -> None:
        """One cycle."""
        if not self._start <= moment.t < self._end:
            return
        self._seen += 1
        if self._holds(moment):
            self._held += 1
        elif self._always and self._broken is None:
            self._broken = self._told(moment)

    def verdict(self) -> str | None:
        """What was broken and when; None: nothing."""
        if self._broken is not None:
            return f"{self._words}: {self._broken}"
        if self._seen == 0:
            return f"{self._words}: no cycle ran then"
        return None if self._held else f"{self._words}: never"

    def _told(self, moment: Moment) -> str:
        found = "" if self._found is None else f"{self._found(moment)} "
        return f"{found}at {moment.t:.3f} s"


def watchers(scenario: Scenario) -> list[Watcher]:
    """Every condition of every expectation."""
    return [watcher for place, one in enumerate(scenario.expect) for watcher in _of(place, one, scenario.seconds)]


def verdicts(watching: Iterable[Watcher]) -> tuple[str, ...]:
    """Everything that was broken."""
    return tuple(verdict for watcher in watching if (verdict := watcher.verdict()) is not None)


def _of(place: int, expect: Expect, seconds: float) -> list[Watcher]:
    start, end, always = expect.start, expect.end(seconds), expect.within is None
    found: list[Watcher] = []

    def add(words: str, holds: Holds, told: Found | None = None, *, every: bool = always) -> None:
        words = f"expect[{place}]: {words}"
        found.append(Watcher(words, start=start, end=end, always=every, holds=holds, found=told))

    if expect.mode is not None:
        right = frozenset(expect.mode)
        add(f"mode {_modes(expect.mode)}", lambda now: now.outputs.mode in right, _mode_found)
    if expect.max_speed is not None:
        most = expect.max_speed
        add(f"at most {most:g} m/s", lambda now: now.speed <= most, _speed_found)
    if expect.min_speed is not None:
        least = expect.min_speed
        add(f"at least {least:g} m/s", lambda now: now.speed >= least, _speed_found)
    if expect.event is not None:
        code = expect.event
        add(f"event {code}", lambda now: any(event.code == code for event in now.outputs.events), every=False)
    return found


def _modes(modes: Iterable[Mode]) -> str:
    return " or ".join(mode.value for mode in modes)


def _mode_found(moment: Moment) -> str:
    return f"was {moment.outputs.mode.value}"


def _speed_found(moment: Moment) -> str:
    return f"was {moment.speed:.3f} m/s"

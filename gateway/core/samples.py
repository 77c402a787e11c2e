"""What is drawn of a drive: the same cycles, numbers and frames in a recording and for whoever looks on live.

How this works
--------------
Everything drawn follows from the inputs, so it is drawn at a viewing rate: plots 50 times a second, the robot 20 times,
of each CAN message the first of every half second, so that a rare one is always there; every event, every status and
every change of the mode. Of the loop's timing the worst since the point before is drawn, so that no cycle hides between
two points. Periods are counted from the zero of the clock and not from the first cycle: whoever begins to look later
is shown the same cycles.
"""

from collections.abc import Sequence
from operator import itemgetter
from typing import Final

from drivers.contract import CanFrame
from gateway.types import CycleTiming, Inputs, Mode, Outputs, Sample

PLOT_PERIOD_NS: Final = 20_000_000
PICTURE_PERIOD_NS: Final = 50_000_000
CAN_PERIOD_NS: Final = 500_000_000
_KEY: Final = itemgetter(CanFrame._fields.index("bus"), CanFrame._fields.index("id"))


class Sampler:
    """Chooses what is drawn. Give it every cycle, in order; after a gap it goes on."""

    def __init__(self) -> None:
        self._since = self._next = -1
        self._plot = self._picture = self._slot = -1
        self._late_ns = self._work_ns = 0
        self._mode: Mode | None = None
        self._seen_in: set[tuple[str, int]] = set()
        self._seen_out: set[tuple[str, int]] = set()

    def step(self, inputs: Inputs, outputs: Outputs, timing: CycleTiming) -> Sample | None:
        """What is drawn of this cycle; None: nothing."""
        cycle, now_ns = inputs.cycle, inputs.now_ns
        broken = cycle != self._next
        self._next = cycle + 1
        if broken:
            self._since = cycle
        self._late_ns, self._work_ns = max(self._late_ns, timing.late_ns), max(self._work_ns, timing.work_ns)
        plot, picture = now_ns // PLOT_PERIOD_NS, now_ns // PICTURE_PERIOD_NS
        plotted, pictured = plot != self._plot, picture != self._picture
        self._forget(now_ns // CAN_PERIOD_NS)
        frames_in = _first(inputs.frames, self._seen_in)
        frames_out = _first(outputs.frames, self._seen_out)
        shown = plotted or pictured or frames_in or frames_out or outputs.events or outputs.status is not None
        if not (shown or broken or outputs.mode is not self._mode):
            return None
        sample = Sample(
            since=self._since,
            cycle=cycle,
            wall_ns=timing.wall_ns,
            mode=outputs.mode,
            plotted=plotted,
            pictured=pictured,
            late_ns=self._late_ns,
            work_ns=self._work_ns,
            trace=outputs.trace if plotted or pictured else None,
            status=outputs.status,
            events=outputs.events,
            frames_in=frames_in,
            frames_out=frames_out,
        )
        self._since, self._plot, self._picture, self._mode = self._next, plot, picture, outputs.mode
        if plotted:
            self._late_ns = self._work_ns = 0
        return sample

    def _forget(self, slot: int) -> None:
        if slot != self._slot:
            self._slot = slot
            self._seen_in.clear()
            self._seen_out.clear()


def _first(frames: Sequence[CanFrame], seen: set[tuple[str, int]]) -> tuple[CanFrame, ...]:
    """Those of which none was seen: mostly nothing, and then it is quick."""
    if seen.issuperset(map(_KEY, frames)):
        return ()
    found: list[CanFrame] = []
    for frame in frames:
        if (frame.bus, frame.id) not in seen:
            seen.add((frame.bus, frame.id))
            found.append(frame)
    return tuple(found)

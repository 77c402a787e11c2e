"""Which steered joints stand at a known angle: an angle that is not trusted is an angle that is not known.

How this works
--------------
An encoder that the robot file declares absolute is believed from the first measurement on; any other joint only after
somebody has said at which angle it stands (a reference). Trust is lost
- when the position jumps by more than the joint can turn, whatever the encoder: something slipped or restarted;
- when a joint that is not absolute comes back from silence elsewhere, or after longer than a hiccup: its controller may
  have restarted and count from zero again;
- when an absolute one comes back from silence further away than it can have turned meanwhile.
Only a reference gives it back.
"""

from collections.abc import Sequence
from typing import Final

HICCUP_NS: Final = 500_000_000  # no motor controller boots faster; a longer silence may have been a restart
UNKNOWN: Final = "joint angle unknown"  # how a fault or a refusal of such a joint begins
HICCUP_WAY: Final = 0.05  # rad; further off after a hiccup, and the counter may have been another one


class JointTrust:
    """Angles of the steered joints; one writer, the engine. Places are those of the robot file."""

    def __init__(self, steered: Sequence[int], *, absolute: Sequence[bool], top_speeds: Sequence[float]) -> None:
        self._absolute = tuple(absolute)
        self._top_speeds = tuple(top_speeds)
        self._offsets = {index: 0.0 for index in steered}
        self._seen: dict[int, tuple[float, int]] = {}  # last position (rad) and when it was measured
        self._silent = set(steered)
        self.unknown = {index: "its encoder is not absolute" for index in steered if not absolute[index]}

    def angles(self, positions: Sequence[float | None]) -> list[float | None]:
        """Output positions with every reference applied; those of silent joints are None, as they came."""
        angles = list(positions)
        for index, offset in self._offsets.items():
            angle = angles[index]
            if angle is not None:
                angles[index] = angle + offset
        return angles

    def trusted(self, angles: Sequence[float | None]) -> list[float | None]:
        """The angles without those that must not be believed."""
        trusted = list(angles)
        for index in self.unknown:
            trusted[index] = None
        return trusted

    def watch(self, angles: Sequence[float | None], jumped: Sequence[int], now_ns: int) -> None:
        """Take the angles of this cycle, and which of them moved further than they can."""
        for index in self._offsets:
            angle = angles[index]
            if angle is None:
                self._silent.add(index)
                continue
            if index in jumped:
                self.unknown[index] = "its position jumped"
            elif index in self._silent and index in self._seen:
                self._welcome(index, angle, now_ns)
            self._silent.discard(index)
            self._seen[index] = (angle, now_ns)

    def reference(self, index: int, angle: float, position: float) -> None:
        """Somebody says that the joint, which reads `position`, stands at this angle (both rad at the output)."""
        self._offsets[index] = angle - position
        self._seen.pop(index, None)
        self.unknown.pop(index, None)

    def _welcome(self, index: int, angle: float, now_ns: int) -> None:
        before, seen_ns = self._seen[index]
        moved, silent_ns = abs(angle - before), now_ns - seen_ns
        if self._absolute[index]:
            if moved > HICCUP_WAY + self._top_speeds[index] * silent_ns * 1e-9:
                self.unknown[index] = "its position jumped while it was silent"
        elif silent_ns > HICCUP_NS or moved > HICCUP_WAY:
            self.unknown[index] = "it was silent and may have restarted"

"""What a simulated sensor makes of the truth: late, with a bias, and with noise that is the same on every run."""

from collections import deque
from collections.abc import Sequence
from random import Random

Values = tuple[float | None, ...]


class Signal:
    """One kind of value. `noise`: standard deviation of each number, `bias` of each, `delay_ns`: all may be changed."""

    def __init__(self, noise: Sequence[float], *, delay_ns: int, seed: int) -> None:
        self.noise = list(noise)
        self.bias = [0.0] * len(self.noise)
        self.delay_ns = delay_ns
        self.stuck = False
        self._random = Random(seed)
        self._past: deque[tuple[int, Values]] = deque()
        self._told: Values = (None,) * len(self.noise)

    def look(self, values: Values, now_ns: int) -> None:
        """The truth of now."""
        self._past.append((now_ns, values))
        while len(self._past) > 1 and self._past[1][0] <= now_ns - self.delay_ns:
            self._past.popleft()

    def tell(self, now_ns: int) -> Values:
        """What it measures now, which was true a delay ago; what there is not, it does not tell."""
        if self._past and not self.stuck:
            seen = [values for at_ns, values in self._past if at_ns <= now_ns - self.delay_ns]
            self._told = tuple(map(self._disturbed, seen[-1] if seen else self._past[0][1], self.noise, self.bias))
        return self._told

    def _disturbed(self, value: float | None, noise: float, bias: float) -> float | None:
        return None if value is None else value + bias + self._random.gauss(0.0, noise)

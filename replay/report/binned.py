"""Many numbers over time in few places: of each stretch of time the least and the greatest, so that no peak is lost."""

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]
CHUNK = 4096
MOST_STRETCHES = 1000
MOST_NUMBERS = 60_000  # of all columns together; a page has some ten bytes for each
CYCLES_PER_STRETCH = 3  # at the least, so that none is empty because a cycle came late


class Stretches:
    """A session from 0 to `seconds` in `size` equal stretches of `width`, s."""

    def __init__(self, seconds: float, size: int) -> None:
        self.size = size
        self.width = seconds / size if seconds > 0.0 else 1.0

    @property
    def times(self) -> Numbers:
        """Of the middle of each stretch, s."""
        middles: Numbers = np.array([(place + 0.5) * self.width for place in range(self.size)])
        return middles

    def places(self, times: list[float]) -> Counts:
        """In which stretch each time lies."""
        return np.clip(np.floor_divide(times, self.width).astype(np.int64), 0, self.size - 1)

    def place(self, t: float) -> int:
        """The same of one."""
        return min(max(int(t // self.width), 0), self.size - 1)


def stretches_of(seconds: float, cycles: int, columns: int) -> Stretches:
    """As fine as a page can show so many columns."""
    most = min(MOST_STRETCHES, MOST_NUMBERS // max(columns, 1))
    return Stretches(seconds, max(1, min(most, cycles // CYCLES_PER_STRETCH)))


class Binned:
    """Least and greatest of each column in each stretch; NaN: none was told.

    Rows are given in order of time, t in s. `low` and `high` are of shape (size, columns) once `finish` was called.
    """

    def __init__(self, stretches: Stretches, columns: int) -> None:
        self.low: Numbers = np.full((stretches.size, columns), np.nan)
        self.high: Numbers = np.full((stretches.size, columns), np.nan)
        self._stretches = stretches
        self._times: list[float] = []
        self._rows: list[list[float | None]] = []

    def add(self, t: float, row: list[float | None]) -> None:
        """The numbers of a cycle, None where one is unknown."""
        self._times.append(t)
        self._rows.append(row)
        if len(self._rows) >= CHUNK:
            self.finish()

    def finish(self) -> None:
        """Take in what has been added."""
        if not self._rows:
            return
        values: Numbers = np.array(self._rows, np.float64)
        values[~np.isfinite(values)] = np.nan
        bins, starts = np.unique(self._stretches.places(self._times), return_index=True)
        self.low[bins] = np.fmin(self.low[bins], np.fmin.reduceat(values, starts, axis=0))
        self.high[bins] = np.fmax(self.high[bins], np.fmax.reduceat(values, starts, axis=0))
        self._times.clear()
        self._rows.clear()

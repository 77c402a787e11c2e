"""Many numbers over time in few places: of each stretch of time the least and the greatest, so that no peak is lost."""

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]
CHUNK = 4096


class Binned:
    """Least and greatest of each column in each of `size` equal stretches from 0 to `seconds`; NaN: none was told.

    Rows are given in order of time, t in s. `low` and `high` are of shape (size, columns) once `finish` was called.
    """

    def __init__(self, seconds: float, size: int, columns: int) -> None:
        self.low: Numbers = np.full((size, columns), np.nan)
        self.high: Numbers = np.full((size, columns), np.nan)
        self.width = seconds / size if seconds > 0.0 else 1.0
        self._times: list[float] = []
        self._rows: list[list[float | None]] = []

    @property
    def times(self) -> Numbers:
        """Of the middle of each stretch, s."""
        middles: Numbers = (np.arange(len(self.low)) + 0.5) * self.width
        return middles

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
        places = np.clip(np.floor_divide(self._times, self.width).astype(np.int64), 0, len(self.low) - 1)
        bins, starts = np.unique(places, return_index=True)
        self.low[bins] = np.fmin(self.low[bins], np.fmin.reduceat(values, starts, axis=0))
        self.high[bins] = np.fmax(self.high[bins], np.fmax.reduceat(values, starts, axis=0))
        self._times.clear()
        self._rows.clear()

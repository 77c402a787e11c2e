"""The endpoint table of a simulated ODrive: what RxSdo reads and writes, and what survives a power cycle."""

from struct import Struct

from replay.sim.controllers.contract import MotorSetup

_BOOL = Struct("<?")
_FLOAT = Struct("<f")


class Parameters:
    """Watchdog settings, off by default. Writes live in RAM; `save` makes them survive (Reboot with payload 1)."""

    def __init__(self, setup: MotorSetup, *, over_usb: bool) -> None:
        timeout = setup.watchdog_s
        self._layouts: dict[int, Struct] = {}
        self._enable_endpoint = self._timeout_endpoint = -1
        self._saved: dict[int, float] = {-1: 0.0}
        if timeout is not None:
            self._enable_endpoint = int(setup.options["watchdog_enable_endpoint"])
            self._timeout_endpoint = int(setup.options["watchdog_timeout_endpoint"])
            self._layouts = {self._enable_endpoint: _BOOL, self._timeout_endpoint: _FLOAT}
            self._saved = {
                self._enable_endpoint: float(over_usb),
                self._timeout_endpoint: timeout if over_usb else 0.0,
            }
        self._factory = dict.fromkeys(self._saved, 0.0)
        self.reboot()

    def reboot(self) -> None:
        """Take the saved values."""
        self._put(dict(self._saved))

    def save(self) -> None:
        self._saved = dict(self._values)

    def erase(self) -> None:
        """Back to the factory values."""
        self._saved = dict(self._factory)

    def read(self, endpoint: int) -> bytes | None:
        """Value as on the wire; None: no such endpoint."""
        layout = self._layouts.get(endpoint)
        return None if layout is None else layout.pack(self._values[endpoint])

    def write(self, endpoint: int, value: bytes) -> None:
        """Store a value; unknown endpoints and short values are ignored."""
        layout = self._layouts.get(endpoint)
        if layout is not None and len(value) >= layout.size:
            self._put(self._values | {endpoint: float(layout.unpack_from(value)[0])})

    def _put(self, values: dict[int, float]) -> None:
        self._values = values
        self.watchdog_enabled = bool(values[self._enable_endpoint])
        self.watchdog_timeout = values[self._timeout_endpoint]  # s

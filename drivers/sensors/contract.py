"""What the core and the driver of a sensor on CAN say to each other.

One driver hears one sensor and tells one kind of value of it; what tells several (an IMU) has a driver for each. It
owns no bus, no clock and no thread, and never sends. Which value may be believed is for `gateway.core.sensors` to say.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

from drivers.contract import CanFrame, DecodedFrame, IdUse, ReceiveFilter, Traffic


class SensorSpec(NamedTuple):
    """What the driver is told of one sensor."""

    name: str
    id: int  # above 0x7FF: an extended one
    kind: str  # one of `SensorType.kinds`
    rate: float  # Hz, of its measurements


class Heard(NamedTuple):
    """What a frame of the sensor brought: a measurement, the flaw for which it is none, or a part of one (both None).

    `values`: SI, in the order of the kind; None where the sensor does not tell one. `measured_ns`: of the earliest of
    its frames.
    """

    values: tuple[float | None, ...] | None = None
    flaw: str | None = None
    measured_ns: int = 0


class SensorDriver(Protocol):
    """Sans-IO listener of one sensor."""

    def receive(self, frame: CanFrame) -> Heard | None:
        """Take one received frame; None when it was not ours. Foreign, short and wild frames never raise."""
        ...

    def decode(self, frame: CanFrame) -> DecodedFrame | None:
        """A frame in words, or None when it is not of this sensor, or damaged."""
        ...

    def traffic(self) -> tuple[Traffic, ...]:
        """Every frame that it sends."""
        ...

    def receive_filters(self) -> tuple[ReceiveFilter, ...]:
        """At least every frame that `receive` may take."""
        ...

    def ids(self) -> tuple[IdUse, ...]:
        """Every id that it sends: nobody else on the bus may use them."""
        ...


class SensorType(NamedTuple):
    """The value type of the registry `drivers.sensors.SENSORS`.

    `make`: from bus and spec. Raises ValueError naming sensor, key, value and allowed range.
    """

    kinds: tuple[str, ...]
    make: Callable[[str, SensorSpec], SensorDriver]

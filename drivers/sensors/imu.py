"""An inertial measurement unit that tells angles and rates about the body's axes (REP-103), gravity and mounting done.

    id        bytes 0 to 5: roll, pitch, yaw, 0.1 mrad each; byte 6: counter and state; byte 7: checksum
    id + 1    bytes 0 to 5: rates about x, y and z, 1 mrad/s each; byte 6: counter and state; byte 7: checksum

All signed, -32768 not told. Both frames of a measurement have one counter and one state. Yaw counts from any zero.
"""

from struct import Struct
from typing import Final

from drivers.sensors.counted import Field, FrameLayout, Kind, Layout

_NUMBERS: Final = Struct("<3h")
_UNTOLD: Final = -32768


def _fields(names: tuple[str, ...], per_unit: float) -> tuple[Field, ...]:
    return tuple([Field(name, per_unit, _UNTOLD) for name in names])


LAYOUT: Final = Layout(
    frames=(
        FrameLayout("Angles", _NUMBERS, _fields(("roll", "pitch", "yaw"), 1e4)),
        FrameLayout("Rates", _NUMBERS, _fields(("roll_rate", "pitch_rate", "yaw_rate"), 1e3)),
    ),
    kinds={
        "attitude": Kind(("roll", "pitch", "roll_rate", "pitch_rate", "yaw_rate"), needed=2),
        "heading": Kind(("yaw",), needed=1),
    },
)

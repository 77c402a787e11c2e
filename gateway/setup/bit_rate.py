"""Whether the bit rate of a link can be right, from what was heard through it. Pure; nothing here touches a link."""

from collections.abc import Mapping
from typing import Final, NamedTuple

# As they leave the factory; ODrive Firmware/communication/can/odrive_can.hpp, bldc applications/appconf_default.h,
# RoboMaster C610 manual.
USUAL: Final[dict[str, int]] = {"ODrive": 250_000, "VESC": 500_000, "DJI": 1_000_000}
HEALTHY: Final = "ERROR-ACTIVE"


class Link(NamedTuple):
    """A CAN interface of the kernel after listening; None: it does not say."""

    up: bool
    virtual: bool
    bitrate: int | None
    state: str | None
    errors: tuple[int, int] | None  # transmit and receive error counter


def usual_rates() -> str:
    """In words."""
    return ", ".join(f"{name} {rate // 1000}k" for name, rate in USUAL.items())


def words(link: Link | None, channel: str, *, frames: int, errors: Mapping[str, int]) -> list[str]:
    """What there is to say of the bit rate; `link` None: not one of the kernel, or there is no `ip` to ask."""
    said = [f"{text} ({count} times)" for text, count in errors.items()]
    if link is None:
        return said
    if not link.up:
        up = f"ip link set {channel} up" + ("" if link.virtual else " type can bitrate RATE restart-ms 100")
        return [*said, f"{channel} is down; nothing here changes it. By hand: {up}; from the factory: {usual_rates()}"]
    if link.virtual:
        return [*said, f"{channel} is virtual and has no bit rate"]
    rate = "unknown" if link.bitrate is None else f"{link.bitrate} bit/s"
    received = 0 if link.errors is None else link.errors[1]
    struggling = bool(errors) or received > 0 or link.state not in (None, HEALTHY)
    if frames:
        doubt = f", but there are errors too (receive error counter {received}): look at cable and termination"
        return [*said, f"bit rate {rate}: right, frames pass" + (doubt if struggling else "")]
    if struggling:
        wrong = f"bit rate {rate} is probably wrong: errors, and no frame"
        return [*said, f"{wrong}; from the factory: {usual_rates()}"]
    return [*said, f"bit rate {rate}: nothing was heard, so nobody can say; is anything connected and powered?"]

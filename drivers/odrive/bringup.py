"""Bring-up and recovery of one ODrive axis.

How this works
--------------
Every axis is in one `Step`. The table RULES says what is sent on entering it, what has to be heard to leave it, how
often to send again meanwhile, and after which time it has failed and where that leads. `advance` is called once per
cycle and does at most one move. The order of the steps is one line per firmware, in `_successors`:

    HEARTBEAT -> VERSION -> FIRMWARE -> CONFIGURE -> VERIFY -> READY | -> CLEAR -> MODE -> LIMITS -> ARM -> ACTIVE

- Left of the bar runs whatever the command is, so that it is known early whether the motor answers; right of it runs
  only while the host asks for torque or velocity. CONFIGURE and VERIFY are the controller's watchdog; without one they
  are left out, and firmware 0.5 has none of the four checks.
- A heartbeat gap or a booting controller leads back to HEARTBEAT from anywhere: nothing is remembered of the checks.
- Asking for coast, or for another control mode, leads from the right side back to READY. Outside the right side an
  axis that does not say IDLE is told so every 100 ms. The mode is only ever changed in IDLE.
- Mode and limits are confirmed by nobody: each is sent in three cycles, so that one lost frame leaves no motor at the
  limits, or in the mode, that its controller has by itself.
- The controller's own watchdog is no failure but leads back to READY: it only says that our frames did not arrive.
  Its fault lasts until the host asks for coast, so nothing is armed again by itself.
- Failures lead to ASK_WHY -> REFUSE, and only `clear_faults` leads out: RESET -> HEARTBEAT. A check that is merely
  not answered keeps asking, and its fault goes away by itself.

The setpoint is no part of the table: the driver sends one in every cycle, zero unless the axis is ACTIVE and heard.
It is what keeps the controller's watchdog fed during all of this.
"""

from collections.abc import Callable
from itertools import pairwise
from math import isclose
from struct import Struct
from typing import Final, NamedTuple

from drivers.contract import CanFrame, DriverFault
from drivers.odrive import tables
from drivers.odrive.axis import ARMING, Axis, Step
from drivers.odrive.tables import AxisState, Control

MS: Final = 1_000_000
RELEASE_PERIOD_NS: Final = 100 * MS
ARM_PATIENCE_NS: Final = 1000 * MS
CONFIGURE_ATTEMPTS: Final = 5
UNCONFIRMED_ATTEMPTS: Final = 3
OUTLIVE_SILENCE: Final = frozenset({Step.HEARTBEAT, Step.ASK_WHY, Step.REFUSE})

_FLOAT: Final = Struct("<f")
_UINT32: Final = Struct("<I")

Failure = tuple[Step, DriverFault | None]


class Rule(NamedTuple):
    """One row: sent on entry, left when `until` holds, sent again every `retry_ns`, failed after `patience_ns`."""

    sends: Callable[[Axis], tuple[CanFrame, ...]]
    until: Callable[[Axis, int], bool]
    retry_ns: int | None = None
    patience_ns: int | None = None
    failure: Callable[[Axis], Failure] | None = None


def advance(axis: Axis, now_ns: int) -> list[CanFrame]:
    """Move the axis towards what is wanted; the frames for it, without the setpoint."""
    if now_ns >= axis.heartbeat_until_ns and axis.step not in OUTLIVE_SILENCE:
        axis.fault = None
        axis.enter(Step.HEARTBEAT)
    if axis.step in ARMING and axis.wanted is not axis.control:
        axis.enter(Step.READY)
    axis.control = axis.wanted
    if axis.step is Step.READY and axis.wanted is None:
        axis.fault = None
    frames = _move(axis, now_ns)
    return [*_release(axis, now_ns), *frames]


def _move(axis: Axis, now_ns: int) -> tuple[CanFrame, ...]:
    rule = RULES[axis.step]
    if axis.entered_ns is None:
        return _begin(axis, now_ns)
    if rule.until(axis, now_ns):
        if rule.failure is not None and axis.fault is not None and not axis.fault.latched:
            axis.fault = None
        axis.enter(_successors(axis)[axis.step])
        return _begin(axis, now_ns)
    if rule.failure is not None and rule.patience_ns is not None and now_ns - axis.entered_ns >= rule.patience_ns:
        _fail(axis, *rule.failure(axis))
        return _begin(axis, now_ns)
    if rule.retry_ns is not None and now_ns - axis.sent_ns >= rule.retry_ns:
        axis.sent_ns = now_ns
        return rule.sends(axis)
    return ()


def _begin(axis: Axis, now_ns: int) -> tuple[CanFrame, ...]:
    axis.entered_ns = axis.sent_ns = now_ns
    return RULES[axis.step].sends(axis)


def _fail(axis: Axis, step: Step, fault: DriverFault | None) -> None:
    if fault is not None and fault.latched:
        axis.judge(fault)
    elif fault is not None:
        axis.fault = fault
    axis.enter(step)


def _release(axis: Axis, now_ns: int) -> tuple[CanFrame, ...]:
    idle = axis.axis_state == AxisState.IDLE or axis.heartbeat_ns is None
    if axis.step in ARMING or idle or now_ns < axis.next_release_ns:
        return ()
    axis.next_release_ns = now_ns + RELEASE_PERIOD_NS
    return (axis.frame(tables.SET_AXIS_STATE, AxisState.IDLE),)


def _successors(axis: Axis) -> dict[Step, Step]:
    return _SUCCESSORS[axis.firmware.tells_version, axis.watchdog is not None]


_ARM_STEPS: Final = (Step.READY, Step.CLEAR, Step.MODE, Step.LIMITS, Step.ARM, Step.ACTIVE)
_RECOVERY: Final = {Step.RESET: Step.HEARTBEAT, Step.ASK_WHY: Step.REFUSE}
_VERSION_STEPS: Final = (Step.HEARTBEAT, Step.VERSION, Step.FIRMWARE)
_SUCCESSORS: Final[dict[tuple[bool, bool], dict[Step, Step]]] = {
    # (tells its version, watchdog given)
    (False, False): dict(pairwise((Step.HEARTBEAT, *_ARM_STEPS))) | _RECOVERY,
    (True, False): dict(pairwise((*_VERSION_STEPS, *_ARM_STEPS))) | _RECOVERY,
    (True, True): dict(pairwise((*_VERSION_STEPS, Step.CONFIGURE, Step.VERIFY, *_ARM_STEPS))) | _RECOVERY,
}


def _nothing(_axis: Axis) -> tuple[CanFrame, ...]:
    return ()


def _never(_axis: Axis, _now_ns: int) -> bool:
    return False


def _told_often(axis: Axis, _now_ns: int) -> bool:
    return axis.told >= UNCONFIRMED_ATTEMPTS


def _heard(axis: Axis, now_ns: int) -> bool:
    return now_ns < axis.heartbeat_until_ns and not axis.booting


def _ask_version(axis: Axis) -> tuple[CanFrame, ...]:
    return (axis.request(tables.GET_VERSION),)


def _version_told(axis: Axis, _now_ns: int) -> bool:
    return axis.version is not None


def _no_version(_axis: Axis) -> Failure:
    text = "does not answer Get_Version: firmware older than 0.6, or a broken line"
    return Step.VERSION, DriverFault("no_version", text, latched=False)


def _right_firmware(axis: Axis, _now_ns: int) -> bool:
    watchdog = axis.watchdog
    if watchdog is not None:
        return axis.version == watchdog.firmware and watchdog.hardware in (None, axis.hardware)
    return axis.version is not None and axis.version.startswith("0.6.")


def _wrong_firmware(axis: Axis) -> Failure:
    watchdog = axis.watchdog
    if watchdog is None:
        text = f"firmware {axis.version}, but this driver's variant is 0.6"
        return Step.REFUSE, DriverFault("wrong_firmware", text, latched=True)
    text = f"firmware {axis.version}, but the watchdog endpoints are those of {watchdog.firmware}: not written"
    if axis.version == watchdog.firmware:
        text = f"hardware {axis.hardware}, but the watchdog endpoints are those of {watchdog.hardware}: not written"
    return Step.REFUSE, DriverFault("watchdog_unverified", text, latched=True)


def _write_watchdog(axis: Axis) -> tuple[CanFrame, ...]:
    watchdog = axis.watchdog
    if watchdog is None:
        return ()
    axis.configured += 1
    (timeout,) = _UINT32.unpack(_FLOAT.pack(watchdog.timeout_s))
    # The timeout first: a watchdog enabled with the default of 0 s expires at once.
    return (
        axis.frame(tables.RX_SDO, tables.SDO_WRITE, watchdog.timeout_endpoint, 0, timeout),
        axis.frame(tables.RX_SDO, tables.SDO_WRITE, watchdog.enable_endpoint, 0, 1),
    )


def _settled(axis: Axis, now_ns: int) -> bool:
    # From 0.6.11 on a write is confirmed by a TxSdo of its own, not to be taken for the read-back.
    return axis.entered_ns is not None and now_ns - axis.entered_ns >= 20 * MS


def _read_watchdog(axis: Axis) -> tuple[CanFrame, ...]:
    watchdog = axis.watchdog
    if watchdog is None:
        return ()
    return (
        axis.frame(tables.RX_SDO, tables.SDO_READ, watchdog.timeout_endpoint, 0, 0),
        axis.frame(tables.RX_SDO, tables.SDO_READ, watchdog.enable_endpoint, 0, 0),
    )


def _watchdog_on(axis: Axis, _now_ns: int) -> bool:
    watchdog = axis.watchdog
    if watchdog is None or axis.timeout_read is None or not axis.enable_read:
        return False
    return isclose(axis.timeout_read, watchdog.timeout_s, rel_tol=1e-6)  # f32 has 24 bits


def _watchdog_off(axis: Axis) -> Failure:
    if axis.configured < CONFIGURE_ATTEMPTS or axis.watchdog is None:
        return Step.CONFIGURE, None
    if axis.timeout_read is None or axis.enable_read is None:
        text = "does not answer the read-back of its watchdog"
        return Step.CONFIGURE, DriverFault("watchdog_unverified", text, latched=False)
    enabled = "on" if axis.enable_read else "off"
    text = (
        f"watchdog reads back {enabled} with {axis.timeout_read:g} s instead of on with {axis.watchdog.timeout_s:g} s"
    )
    return Step.REFUSE, DriverFault("watchdog_unverified", text, latched=True)


def _asked_and_able(axis: Axis, now_ns: int) -> bool:
    idle = axis.axis_state == AxisState.IDLE
    return axis.control is not None and axis.fault is None and idle and now_ns < axis.measured_until_ns


def _clear_errors(axis: Axis) -> tuple[CanFrame, ...]:
    values = (0,) * len(axis.firmware.to_device[tables.CLEAR_ERRORS].fields)  # 0.6: do not blink to identify
    return (axis.frame(tables.CLEAR_ERRORS, *values),)


def _set_mode(axis: Axis) -> tuple[CanFrame, ...]:
    axis.told += 1
    control = Control.VELOCITY if axis.control is None else axis.control
    return (axis.frame(tables.SET_CONTROLLER_MODE, control, tables.INPUT_PASSTHROUGH),)


def _set_limits(axis: Axis) -> tuple[CanFrame, ...]:
    axis.told += 1
    return (axis.frame(tables.SET_LIMITS, *axis.limits()),)


def _arm(axis: Axis) -> tuple[CanFrame, ...]:
    return (axis.frame(tables.SET_AXIS_STATE, AxisState.CLOSED_LOOP),)


def _armed(axis: Axis, _now_ns: int) -> bool:
    return axis.axis_state == AxisState.CLOSED_LOOP


def _not_armed(axis: Axis) -> Failure:
    text = f"did not reach CLOSED_LOOP_CONTROL within {ARM_PATIENCE_NS / 1e9:g} s{axis.result_words()}"
    return Step.ASK_WHY, DriverFault("arming_failed", text, latched=True)


def _cleared(axis: Axis, _now_ns: int) -> bool:
    return not axis.errors


def _not_cleared(axis: Axis) -> Failure:
    return Step.ASK_WHY, axis.device_fault()


def _ask_why(axis: Axis) -> tuple[CanFrame, ...]:
    return tuple(axis.request(command) for command in axis.firmware.reasons if command not in axis.reasons)


def _explained(axis: Axis, _now_ns: int) -> bool:
    return len(axis.reasons) == len(axis.firmware.reasons)


def _unexplained(axis: Axis) -> Failure:
    return Step.REFUSE, axis.verdict


RULES: Final[dict[Step, Rule]] = {
    # step: sends, left when, sent again after, fails after, failure
    Step.HEARTBEAT: Rule(_nothing, _heard),
    Step.VERSION: Rule(_ask_version, _version_told, 100 * MS, 1000 * MS, _no_version),
    Step.FIRMWARE: Rule(_nothing, _right_firmware, None, 0, _wrong_firmware),
    Step.CONFIGURE: Rule(_write_watchdog, _settled),
    Step.VERIFY: Rule(_read_watchdog, _watchdog_on, None, 100 * MS, _watchdog_off),
    Step.READY: Rule(_nothing, _asked_and_able),
    Step.CLEAR: Rule(_clear_errors, _cleared, 100 * MS, 500 * MS, _not_cleared),
    Step.MODE: Rule(_set_mode, _told_often, 0),
    Step.LIMITS: Rule(_set_limits, _told_often, 0),
    Step.ARM: Rule(_arm, _armed, 300 * MS, ARM_PATIENCE_NS, _not_armed),
    Step.ACTIVE: Rule(_nothing, _never),
    Step.RESET: Rule(_clear_errors, _cleared, 100 * MS, 500 * MS, _not_cleared),
    Step.ASK_WHY: Rule(_ask_why, _explained, 100 * MS, 300 * MS, _unexplained),
    Step.REFUSE: Rule(_nothing, _never),
}

"""What probes of a robot computer mean for one robot, each with a cure. Pure: the probes are in `gateway.cli.doctor`.

A `problem` keeps the robot from driving or makes it drive badly; a `note` is worth knowing.
"""

from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

from gateway.config import Bus
from gateway.core.joint_trust import UNKNOWN
from gateway.edges.can_link import CanLink
from gateway.types import Status

CLASSIC_MTU, FD_MTU = 16, 72  # bytes of `struct can_frame` and `struct canfd_frame` (linux/can.h)
MIN_QUEUE = 16  # frames; the service itself keeps at most about ten waiting
PLAUSIBLE_WALL_S = 1_704_067_200.0  # 2024-01-01: an earlier clock was never set
COARSEST_CLOCK_S = 1e-5
LATE_S = 2e-3  # half a cycle at 250 Hz


class Grade(Enum):
    """How serious a finding is."""

    OK = "ok"
    NOTE = "note"
    PROBLEM = "problem"


class Finding(NamedTuple):
    """One line of the report."""

    subject: str
    grade: Grade
    text: str
    cure: str | None = None


class Unit(NamedTuple):
    """The robot's unit as `systemctl show` describes it."""

    loaded: str
    active: str
    enabled: str
    status_text: str
    result: str
    exit_status: str
    restarts: str
    job: str


class RealTime(NamedTuple):
    """What the service has (None: it does not run), and what its unit or else this user may have."""

    running: bool | None  # scheduled with SCHED_FIFO
    locked: bool | None  # has locked memory
    may_run: bool
    may_lock: bool


def interface(bus: Bus, link: CanLink | None) -> list[Finding]:
    """Presence, state, bit rates, queue and errors of the interface of one bus."""
    channel, subject = bus.channel, f"CAN {bus.channel}"
    if link is None:
        cure = "plug the adapter in and load its driver (`dmesg | grep -i can`), or correct [[bus]] channel"
        return [Finding(subject, Grade.PROBLEM, "there is no such interface", cure)]
    if not link.up:
        rate = f" {_timing(bus)}" if link.kind == "can" else ""
        cure = f"install.sh sets it up for every boot; by hand: ip link set {channel} up{rate}"
        return [Finding(subject, Grade.PROBLEM, "the interface is down", cure)]
    findings = [*_bit_timing(subject, bus, link), *_controller(subject, channel, link)]
    if link.queue < MIN_QUEUE:
        text = f"transmit queue of {link.queue} frames: commands may be dropped in a burst"
        findings.append(Finding(subject, Grade.NOTE, text, f"ip link set {channel} txqueuelen 64"))
    if link.dropped:
        text = f"{link.dropped} received frames were lost since the interface exists"
        findings.append(Finding(subject, Grade.NOTE, text, "look for load: candump, top"))
    return findings or [Finding(subject, Grade.OK, _words(link))]


def real_time(found: RealTime) -> list[Finding]:
    """Scheduling and memory locking."""
    unit_cure = "run the service by its unit (deploy/install.sh), which grants both"
    if found.running is not None:
        findings = [("scheduling", found.running, "the service runs with SCHED_FIFO", "without real-time scheduling")]
        findings += [("memory", bool(found.locked), "the service has locked its memory", "without locked memory")]
    else:
        findings = [("scheduling", found.may_run, "real-time scheduling is permitted", "no real-time permission")]
        findings += [("memory", found.may_lock, "memory may be locked", "memory must not be locked")]
    return [
        Finding(subject, Grade.OK, good) if ok else Finding(subject, Grade.PROBLEM, bad, unit_cure)
        for subject, ok, good, bad in findings
    ]


def clock(*, wall_s: float, synchronised: bool, resolution_s: float, source: str, late_s: float) -> list[Finding]:
    """Wall clock for the names of sessions, monotonic clock for driving; `late_s`: median lateness of a sleep."""
    findings = []
    if wall_s < PLAUSIBLE_WALL_S:
        text = "the wall clock was never set: sessions will carry wrong dates"
        findings.append(
            Finding("clock", Grade.PROBLEM, text, "timedatectl set-ntp true, or fit a battery-backed clock")
        )
    elif not synchronised:
        text = "the wall clock is not synchronised: only the dates of sessions depend on it"
        findings.append(Finding("clock", Grade.NOTE, text, "timedatectl set-ntp true"))
    if resolution_s > COARSEST_CLOCK_S:
        text = f"the monotonic clock ({source}) is too coarse: {resolution_s:g} s"
        findings.append(Finding("clock", Grade.PROBLEM, text, "boot without a clocksource= parameter"))
    if late_s > LATE_S:
        text = f"sleeps end {late_s * 1e3:.1f} ms late (median)"
        findings.append(Finding("clock", Grade.NOTE, text, "look for load (top), or use a PREEMPT_RT kernel"))
    return findings or [Finding("clock", Grade.OK, f"synchronised, {source}, sleeps end {late_s * 1e3:.2f} ms late")]


def disk(directory: str, *, free: int | None, min_free: int, budget: int, obstacle: str | None = None) -> Finding:
    """Room for sessions; `free` None: the directory cannot be looked at; `obstacle`: why it is none to write into."""
    if obstacle is not None:
        cure = "correct recording.directory in the robot file, or give --out DIR"
        return Finding("disk", Grade.PROBLEM, f"{directory} cannot be used: {obstacle}", cure)
    if free is None:
        return Finding("disk", Grade.PROBLEM, f"{directory} cannot be looked at", f"ls -ld {directory}")
    text = f"{free / 1e9:.1f} GB free for {directory}"
    if free < min_free:
        cure = f"delete old sessions there, or lower recording.min_free ({min_free / 1e9:.2f} GB)"
        return Finding("disk", Grade.PROBLEM, f"{text}: nothing will be recorded", cure)
    if free < min_free + budget:
        cure = "lower recording.disk_budget, so that old sessions are deleted in time"
        return Finding("disk", Grade.NOTE, f"{text}, less than recording.disk_budget ({budget / 1e9:.1f} GB)", cure)
    return Finding("disk", Grade.OK, text)


def endpoint(text: str, *, robot: str, free: bool, answered: bool, active: bool) -> Finding:
    """Whoever listens on the Zenoh endpoint must be this robot."""
    subject = f"Zenoh {text}"
    if answered:
        return Finding(subject, Grade.OK, f"answered by {robot}")
    if free and not active:
        return Finding(subject, Grade.OK, "free")
    if free:
        return Finding(subject, Grade.PROBLEM, "the service is active, but nobody listens", "systemctl restart it")
    if active:
        return Finding(subject, Grade.NOTE, "in use; this client gets no answer (are keys or an access list in use?)")
    cure = f"`ss -ltnp` names the other program; give {robot} another port in zenoh.listen"
    return Finding(subject, Grade.PROBLEM, "another program listens there, or the address is not ours", cure)


def joint(motor: str, *, robot: str, absolute: bool, status: Status | None) -> Finding:
    """Whether the angle of a steered joint is known; `status`: of the running robot, None where it does not tell."""
    subject, reference = f"joint {motor}", f"drivegate reference {robot} --motor {motor}"
    told = () if status is None else status.faults
    unknown = next((fault for fault in told if fault.startswith(f"{motor}: {UNKNOWN}")), None)
    if unknown is not None:
        cure = f"bring it to a known angle, then {reference} --angle RAD"
        return Finding(subject, Grade.PROBLEM, unknown.partition(": ")[2].partition(": ")[0], cure)
    if status is not None and any(one.name == motor and one.measured is not None for one in status.motors):
        return Finding(subject, Grade.OK, "its angle is known")
    if absolute:
        return Finding(subject, Grade.OK, "its encoder is declared absolute")
    text = "its encoder is incremental: after every start the robot drives only once the joint was referenced"
    return Finding(subject, Grade.NOTE, text, f"{reference} after a start, or fit an absolute encoder and declare it")


def sensor(name: str, *, by: str, status: Status | None) -> Finding:
    """Whether a sensor is believed; `by`: what it comes over, `status`: of the running robot, None without one."""
    subject = f"sensor {name}"
    told = next((one for one in status.sensors if one.name == name), None) if status is not None else None
    if told is None:
        return Finding(subject, Grade.NOTE, f"by {by}: not looked at, the service does not run or tell")
    if told.values is not None:
        return Finding(subject, Grade.OK, f"by {by}: it tells {told.kind}")
    cure = "its power, its cable, its id and rate in the robot file (README, Sensors on CAN), or who publishes it"
    return Finding(subject, Grade.PROBLEM, f"by {by}: {told.reason or 'silent'}", f"look at {cure}")


def service(name: str, unit: Unit | None) -> Finding:
    """What the service manager says of the robot's unit; None: there is none."""
    if unit is None:
        return Finding(name, Grade.NOTE, "systemd does not run here", "start by hand: drivegate run FILE")
    if unit.loaded != "loaded":
        return Finding(name, Grade.NOTE, "not installed", "sh deploy/install.sh")
    judges = {"active": _active, "activating": _starting, "failed": _failed}
    return judges.get(unit.active, _stopped)(name, unit)


def _active(name: str, unit: Unit) -> Finding:
    restarts = f" after {unit.restarts} restarts" if unit.restarts != "0" else ""
    return Finding(name, Grade.OK, f"active{restarts}: {unit.status_text}")


def _starting(name: str, unit: Unit) -> Finding:
    return Finding(name, Grade.PROBLEM, f"starting: {unit.status_text or 'no status yet'}", f"journalctl -u {name}")


def _failed(name: str, unit: Unit) -> Finding:
    cure = "drivegate check the robot file" if unit.exit_status == "78" else f"journalctl -u {name}"
    return Finding(name, Grade.PROBLEM, f"failed ({unit.result}, exit {unit.exit_status})", cure)


def _stopped(name: str, unit: Unit) -> Finding:
    if unit.job not in ("", "0"):
        return Finding(name, Grade.PROBLEM, "its start waits for its CAN interface to appear", "see the lines on CAN")
    if unit.enabled != "enabled":
        return Finding(name, Grade.NOTE, "not enabled", f"systemctl enable --now {name}")
    return Finding(name, Grade.PROBLEM, "enabled but not running", f"systemctl start {name}")


def _timing(bus: Bus) -> str:
    """As `ip link set ... up` takes it."""
    fd = f" fd on dbitrate {bus.fd_bitrate}" if bus.fd else ""
    return f"type can bitrate {bus.bitrate}{fd} restart-ms 100"


def set_anew(bus: Bus) -> str:
    """What gives the link the bit rates of the robot file."""
    return f"ip link set {bus.channel} down; ip link set {bus.channel} up {_timing(bus)}"


def _bit_timing(subject: str, bus: Bus, link: CanLink) -> list[Finding]:
    if link.kind != "can":
        return _virtual(subject, bus, link)
    wrong = [
        text
        for differs, text in (
            (link.bitrate != bus.bitrate, f"bit rate {link.bitrate}, the robot file says {bus.bitrate}"),
            (bus.fd and not link.fd, "CAN FD is off, the robot file says fd = true"),
            (
                bus.fd and link.fd and link.data_bitrate != bus.fd_bitrate,
                f"data bit rate {link.data_bitrate}, the robot file says {bus.fd_bitrate}",
            ),
            (not link.restart_ms, "no automatic restart after bus-off (restart-ms 0)"),
        )
        if differs
    ]
    again = set_anew(bus)
    findings = [Finding(subject, Grade.PROBLEM, text, again) for text in wrong]
    if link.fd and not bus.fd:
        findings.append(Finding(subject, Grade.NOTE, "CAN FD is on, the robot file says fd = false", f"{again} fd off"))
    return findings


def _virtual(subject: str, bus: Bus, link: CanLink) -> list[Finding]:
    """One without a bit rate has its MTU: that of a classic frame does not let one of CAN FD pass."""
    if not bus.fd or link.mtu != CLASSIC_MTU:
        return []
    text = f"MTU {CLASSIC_MTU} is for classic CAN only, the robot file says fd = true"
    again = f"ip link set {bus.channel} down; ip link set {bus.channel} mtu {FD_MTU} up"
    return [Finding(subject, Grade.PROBLEM, text, again)]


def _controller(subject: str, channel: str, link: CanLink) -> list[Finding]:
    wiring = "check bit rate, termination (60 ohm between the wires) and that a powered motor listens"
    findings = []
    if link.state not in (None, "ERROR-ACTIVE"):
        counters = f", error counters tx {link.errors[0]} rx {link.errors[1]}" if link.errors else ""
        grade = Grade.NOTE if link.state == "ERROR-WARNING" else Grade.PROBLEM
        findings.append(Finding(subject, grade, f"the controller is {link.state}{counters}", wiring))
    if link.bus_offs:
        text = f"{link.bus_offs} times bus-off since {channel} exists"
        findings.append(Finding(subject, Grade.NOTE, text, wiring))
    return findings


def _words(link: CanLink) -> str:
    if link.kind != "can":
        return f"up ({link.kind or 'not a CAN device'})"
    fd = f" (CAN FD, data {link.data_bitrate} bit/s)" if link.fd else ""
    return f"up, {link.bitrate} bit/s{fd}, {link.state}, queue {link.queue}"


def exit_code(findings: Sequence[Finding]) -> int:
    """0: all well; 1: there are problems."""
    return 1 if any(finding.grade is Grade.PROBLEM for finding in findings) else 0

"""What the doctor makes of probe results; every problem and note comes with a cure."""

import json
import socket
from pathlib import Path
from typing import Any, Self

import pytest
from typer.testing import CliRunner

from gateway.cli import doctor as command
from gateway.cli.app import build
from gateway.config import Bus
from gateway.edges import host_checks as doctor
from gateway.edges.can_link import CanLink, parse_link
from gateway.edges.host_checks import Finding, Grade, RealTime, Unit
from gateway.edges.messages import StateMessage
from gateway.types import SensorStatus, Status
from tests.gateway.test_messages import STATUS
from tests.world import ROBOTS

# `ip -details -statistics -json link show`, iproute2 6.1: a CAN adapter (shortened), a vcan, nothing.
CAN = json.dumps(
    [
        {
            "ifname": "can0",
            "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"],
            "mtu": 16,
            "txqlen": 10,
            "linkinfo": {
                "info_kind": "can",
                "info_data": {
                    "state": "ERROR-PASSIVE",
                    "berr_counter": {"tx": 128, "rx": 3},
                    "restart_ms": 0,
                    "bittiming": {"bitrate": 500000, "sample_point": "0.875"},
                },
                "info_xstats": {"restarts": 0, "bus_off": 2},
            },
            "stats64": {"rx": {"bytes": 0, "dropped": 7}, "tx": {"bytes": 0, "dropped": 0}},
        }
    ]
)
FD = json.dumps(
    [
        {
            "ifname": "can0",
            "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"],
            "mtu": 72,
            "txqlen": 64,
            "linkinfo": {
                "info_kind": "can",
                "info_data": {
                    "ctrlmode": ["FD", "TDC-AUTO"],
                    "state": "ERROR-ACTIVE",
                    "restart_ms": 100,
                    "bittiming": {"bitrate": 1000000, "sample_point": "0.750"},
                    "data_bittiming": {"bitrate": 5000000, "sample_point": "0.750"},
                },
            },
        }
    ]
)
VCAN = '[{"ifname":"vcan0","flags":["NOARP","UP","LOWER_UP"],"mtu":16,"txqlen":1000,"linkinfo":{"info_kind":"vcan"}}]'
GOOD = CanLink("can", up=True, queue=64, mtu=16, bitrate=1_000_000, fd=False, data_bitrate=None, restart_ms=100,
               state="ERROR-ACTIVE", errors=(0, 0), bus_offs=0, dropped=0)  # fmt: skip
GOOD_FD = GOOD._replace(mtu=72, fd=True, data_bitrate=5_000_000)
CLASSIC_BUS = Bus(name="a", interface="socketcan", channel="can0", bitrate=1_000_000)
FD_BUS = CLASSIC_BUS.model_copy(update={"fd": True, "data_bitrate": 5_000_000})
FD_UP = "ip link set can0 up type can bitrate 1000000 fd on dbitrate 5000000 restart-ms 100"
ACTIVE = Unit("loaded", "active", "enabled", "idle, standing", "success", "0", "0", "0")


def texts(findings: list[Finding]) -> str:
    return "; ".join(finding.text for finding in findings)


def test_a_link_is_read_from_ip() -> None:
    assert parse_link(CAN) == CanLink(
        kind="can",
        up=True,
        queue=10,
        mtu=16,
        bitrate=500_000,
        fd=False,
        data_bitrate=None,
        restart_ms=0,
        state="ERROR-PASSIVE",
        errors=(128, 3),
        bus_offs=2,
        dropped=7,
    )
    fast = parse_link(FD)
    assert fast is not None
    assert (fast.mtu, fast.bitrate, fast.fd, fast.data_bitrate) == (72, 1_000_000, True, 5_000_000)
    virtual = parse_link(VCAN)
    assert virtual is not None
    assert (virtual.kind, virtual.up, virtual.queue, virtual.restart_ms) == ("vcan", True, 1000, None)


@pytest.mark.parametrize("text", ["", "[]", "{", "null", '[{"txqlen": "many"}]', '{"a": 1}'])
def test_anything_else_is_no_link(text: str) -> None:
    assert parse_link(text) is None


def test_a_good_interface_is_one_line() -> None:
    (finding,) = doctor.interface(CLASSIC_BUS, GOOD)
    assert finding.grade is Grade.OK
    assert finding.text == "up, 1000000 bit/s, ERROR-ACTIVE, queue 64"
    (finding,) = doctor.interface(FD_BUS, parse_link(FD))
    assert finding.grade is Grade.OK
    assert finding.text == "up, 1000000 bit/s (CAN FD, data 5000000 bit/s), ERROR-ACTIVE, queue 64"


@pytest.mark.parametrize(
    ("link", "text", "grade"),
    [
        (None, "no such interface", Grade.PROBLEM),
        (GOOD._replace(up=False), "down", Grade.PROBLEM),
        (GOOD._replace(bitrate=500_000), "bit rate 500000, the robot file says 1000000", Grade.PROBLEM),
        (GOOD._replace(restart_ms=0), "restart-ms 0", Grade.PROBLEM),
        (GOOD._replace(state="BUS-OFF", errors=(248, 0)), "BUS-OFF, error counters tx 248 rx 0", Grade.PROBLEM),
        (GOOD._replace(state="ERROR-WARNING"), "ERROR-WARNING", Grade.NOTE),
        (GOOD._replace(queue=10), "queue of 10", Grade.NOTE),
        (GOOD._replace(bus_offs=3), "3 times bus-off", Grade.NOTE),
        (GOOD._replace(dropped=9), "9 received frames were lost", Grade.NOTE),
    ],
)
def test_what_is_wrong_with_an_interface(link: CanLink | None, text: str, grade: Grade) -> None:
    (finding,) = doctor.interface(CLASSIC_BUS, link)
    assert text in finding.text
    assert finding.grade is grade
    assert finding.cure


@pytest.mark.parametrize(
    ("link", "text"),
    [
        (GOOD_FD._replace(up=False), "down"),
        (GOOD, "CAN FD is off, the robot file says fd = true"),
        (GOOD_FD._replace(data_bitrate=2_000_000), "data bit rate 2000000, the robot file says 5000000"),
        (GOOD_FD._replace(bitrate=500_000), "bit rate 500000, the robot file says 1000000"),
        (GOOD_FD._replace(restart_ms=0), "restart-ms 0"),
    ],
)
def test_what_is_wrong_with_an_interface_of_can_fd(link: CanLink, text: str) -> None:
    """Every cure sets up all of it: the kernel takes CAN FD with both bit rates only."""
    (finding,) = doctor.interface(FD_BUS, link)
    assert text in finding.text
    assert finding.grade is Grade.PROBLEM
    assert FD_UP in str(finding.cure)


def test_without_a_data_bit_rate_the_data_are_as_fast_as_the_rest() -> None:
    bus = CLASSIC_BUS.model_copy(update={"fd": True})
    (finding,) = doctor.interface(bus, GOOD_FD)
    assert finding.text == "data bit rate 5000000, the robot file says 1000000"
    assert "bitrate 1000000 fd on dbitrate 1000000" in str(finding.cure)
    assert doctor.interface(bus, GOOD_FD._replace(data_bitrate=1_000_000))[0].grade is Grade.OK


def test_can_fd_on_a_classic_bus_is_worth_a_note() -> None:
    (finding,) = doctor.interface(CLASSIC_BUS, GOOD_FD)
    assert finding.grade is Grade.NOTE
    assert finding.text == "CAN FD is on, the robot file says fd = false"
    assert str(finding.cure).endswith("type can bitrate 1000000 restart-ms 100 fd off")


def test_a_virtual_interface_has_no_bit_rate() -> None:
    link = parse_link(VCAN)
    assert link is not None
    (finding,) = doctor.interface(CLASSIC_BUS, link)
    assert finding.grade is Grade.OK
    (finding,) = doctor.interface(FD_BUS, link)
    assert finding.text == "MTU 16 is for classic CAN only, the robot file says fd = true"
    assert finding.cure == "ip link set can0 down; ip link set can0 mtu 72 up"
    assert doctor.interface(FD_BUS, link._replace(mtu=72))[0].grade is Grade.OK


def test_the_running_service_counts_more_than_permissions() -> None:
    assert doctor.exit_code(doctor.real_time(RealTime(True, True, may_run=False, may_lock=False))) == 0
    assert doctor.exit_code(doctor.real_time(RealTime(False, True, may_run=True, may_lock=True))) == 1
    assert doctor.exit_code(doctor.real_time(RealTime(None, None, may_run=True, may_lock=True))) == 0
    assert doctor.exit_code(doctor.real_time(RealTime(None, None, may_run=True, may_lock=False))) == 1


def test_clock() -> None:
    def findings(**changed: object) -> list[Finding]:
        good = {"wall_s": 1.8e9, "synchronised": True, "resolution_s": 1e-9, "source": "tsc", "late_s": 1e-4}
        return doctor.clock(**good | changed)  # type: ignore[arg-type]

    assert [finding.grade for finding in findings()] == [Grade.OK]
    assert [finding.grade for finding in findings(synchronised=False)] == [Grade.NOTE]
    assert "never set" in texts(findings(wall_s=86400.0, synchronised=False))
    assert "too coarse" in texts(findings(resolution_s=4e-3))
    assert "5.0 ms late" in texts(findings(late_s=5e-3))


def test_disk() -> None:
    def finding(free: int | None) -> Finding:
        return doctor.disk("/var/lib/x", free=free, min_free=10**9, budget=10**10)

    grades = [finding(free).grade for free in (None, 10**8, 5 * 10**9, 10**11)]
    assert grades == [Grade.PROBLEM, Grade.PROBLEM, Grade.NOTE, Grade.OK]


def test_a_directory_that_cannot_be() -> None:
    found = doctor.disk("/a/b", free=None, min_free=1, budget=1, obstacle="/a is no directory")
    assert found.grade is Grade.PROBLEM
    assert found.text == "/a/b cannot be used: /a is no directory"
    assert found.cure is not None
    assert "recording.directory" in found.cure


def test_where_sessions_cannot_go(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert command._room(tmp_path / "file" / "x", ours=False).obstacle == f"{tmp_path}/file is no directory"
    words = command._room(Path("/proc/no/such"), ours=False).obstacle
    assert words is not None
    assert words.startswith("/proc is no file system that keeps files")
    there = command._room(tmp_path / "new" / "one", ours=False)
    assert there.obstacle is None
    assert there.free is not None
    assert there.free > 0


@pytest.mark.parametrize(
    ("free", "answered", "active", "grade"),
    [
        (False, True, True, Grade.OK),
        (True, False, False, Grade.OK),
        (True, False, True, Grade.PROBLEM),
        (False, False, True, Grade.NOTE),
        (False, False, False, Grade.PROBLEM),
    ],
)
def test_endpoint(free: bool, answered: bool, active: bool, grade: Grade) -> None:
    finding = doctor.endpoint("tcp/x:1", robot="moby", free=free, answered=answered, active=active)
    assert finding.grade is grade
    assert (finding.cure is None) == (grade in (Grade.OK, Grade.NOTE))


@pytest.mark.parametrize(
    ("unit", "text", "grade"),
    [
        (None, "systemd does not run here", Grade.NOTE),
        (ACTIVE._replace(loaded="not-found"), "not installed", Grade.NOTE),
        (ACTIVE, "active: idle, standing", Grade.OK),
        (ACTIVE._replace(restarts="2"), "active after 2 restarts", Grade.OK),
        (ACTIVE._replace(active="activating", status_text="waiting: can0: down"), "waiting: can0", Grade.PROBLEM),
        (ACTIVE._replace(active="failed", result="exit-code", exit_status="78"), "exit 78", Grade.PROBLEM),
        (ACTIVE._replace(active="inactive", job="42"), "waits for its CAN interface", Grade.PROBLEM),
        (ACTIVE._replace(active="inactive", enabled="disabled"), "not enabled", Grade.NOTE),
        (ACTIVE._replace(active="inactive"), "enabled but not running", Grade.PROBLEM),
    ],
)
def test_service(unit: Unit | None, text: str, grade: Grade) -> None:
    finding = doctor.service("drivegate@moby.service", unit)
    assert text in finding.text
    assert finding.grade is grade
    assert (finding.cure is None) == (grade is Grade.OK)


MEASURED, SILENT = (STATUS.motors[0]._replace(name="platform", measured=speed) for speed in (0.0, None))
RUNNING = STATUS._replace(faults=(), motors=(MEASURED,))
UNREFERENCED = "platform: joint angle unknown (its encoder is not absolute): drivegate reference moby"


@pytest.mark.parametrize(
    ("absolute", "status", "grade", "text"),
    [
        (True, None, Grade.OK, "declared absolute"),
        (False, None, Grade.NOTE, "incremental: after every start"),
        (True, RUNNING, Grade.OK, "its angle is known"),
        (False, RUNNING, Grade.OK, "its angle is known"),
        (False, RUNNING._replace(motors=(SILENT,)), Grade.NOTE, "incremental: after every start"),
        (True, RUNNING._replace(motors=(SILENT,)), Grade.OK, "declared absolute"),
        (False, RUNNING._replace(faults=("left: silent", UNREFERENCED)), Grade.PROBLEM, "its encoder is not absolute"),
        (True, RUNNING._replace(faults=("platform: joint angle unknown (x)",)), Grade.PROBLEM, "angle unknown (x)"),
        (True, RUNNING._replace(faults=("other_platform: joint angle unknown (x)",)), Grade.OK, "is known"),
    ],
)
def test_a_steered_joint(absolute: bool, status: Status | None, grade: Grade, text: str) -> None:
    finding = doctor.joint("platform", robot="moby", absolute=absolute, status=status)
    assert finding.subject == "joint platform"
    assert finding.grade is grade
    assert text in finding.text
    assert (finding.cure is None) == (grade is Grade.OK)
    assert grade is Grade.OK or "drivegate reference moby --motor platform" in str(finding.cure)


def _report(path: Path) -> dict[str, Any]:
    done = CliRunner().invoke(build("doctor"), ["doctor", str(path), "--json"])
    return {finding["subject"]: finding for finding in json.loads(done.stdout)["findings"]}


def test_the_command_tells_of_the_joints_in_the_robot_file(tmp_path: Path) -> None:
    text = (ROBOTS / "moby.toml").read_text(encoding="utf-8")
    path = tmp_path / "moby.toml"
    path.write_text(text, encoding="utf-8")
    assert _report(path)["joint platform"]["grade"] == "ok"
    assert 'encoder = "absolute"' in text
    path.write_text(text.replace('encoder = "absolute"', ""), encoding="utf-8")
    joint = _report(path)["joint platform"]
    assert joint["grade"] == "note"
    assert "drivegate reference moby" in joint["cure"]
    assert not any(subject.startswith("joint") for subject in _report(ROBOTS / "omni4.toml"))


def test_the_command_asks_the_running_robot_about_its_joints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever listens on the robot's port is asked; here a client that answers as an unreferenced robot does."""

    class Answering:
        def __init__(self, robot: str, *, connect: list[str]) -> None:
            assert (robot, len(connect)) == ("moby", 1)

        def __enter__(self) -> Self:
            return self

        def __exit__(self, *_: object) -> None: ...

        def wait_alive(self, _timeout: float) -> bool:
            return True

        def status(self, _timeout: float) -> StateMessage:
            return StateMessage(0.0, RUNNING._replace(faults=(UNREFERENCED,)), {})

    monkeypatch.setattr(command, "Client", Answering)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        text = (ROBOTS / "moby.toml").read_text(encoding="utf-8").replace(":7447", f":{port}")
        path = tmp_path / "moby.toml"
        path.write_text(text, encoding="utf-8")
        assert _report(path)["joint platform"] == {
            "subject": "joint platform",
            "grade": "problem",
            "text": "joint angle unknown (its encoder is not absolute)",
            "cure": "bring it to a known angle, then drivegate reference moby --motor platform --angle RAD",
        }


def test_the_command_reports_a_missing_interface(tmp_path_factory: pytest.TempPathFactory) -> None:
    text = (ROBOTS / "moby.toml").read_text(encoding="utf-8").replace('channel = "can0"', 'channel = "absent0"')
    path = tmp_path_factory.mktemp("doctor") / "moby.toml"
    path.write_text(text, encoding="utf-8")
    done = CliRunner().invoke(build("doctor"), ["doctor", str(path), "--json"])
    assert done.exit_code == 1
    report = json.loads(done.stdout)
    assert report["well"] is False
    lines = {finding["subject"]: finding for finding in report["findings"]}
    assert lines["CAN absent0"]["text"] == "there is no such interface"
    assert lines["CAN absent0"]["cure"]
    assert lines["robot file"]["text"] == f"{path}: moby"
    assert {"versions", "clock", "disk", "scheduling", "memory", "drivegate@moby.service"} <= set(lines)
    words = CliRunner().invoke(build("doctor"), ["doctor", str(path)])
    assert words.exit_code == 1
    assert all(finding["text"] in words.stdout for finding in lines.values() if finding["subject"] != "clock")


HEARD = SensorStatus("wire", "range", (0.4,), 0.01, 0)
LOST = HEARD._replace(values=None, reason="its counter stands still")


@pytest.mark.parametrize(
    ("status", "grade", "text"),
    [
        (None, Grade.NOTE, "by can0: not looked at"),
        (RUNNING, Grade.NOTE, "by can0: not looked at"),
        (RUNNING._replace(sensors=(HEARD,)), Grade.OK, "by can0: it tells range"),
        (RUNNING._replace(sensors=(LOST,)), Grade.PROBLEM, "by can0: its counter stands still"),
    ],
)
def test_a_sensor(status: Status | None, grade: Grade, text: str) -> None:
    finding = doctor.sensor("wire", by="can0", status=status)
    assert (finding.subject, finding.grade) == ("sensor wire", grade)
    assert text in finding.text
    assert (finding.cure is not None) == (grade is Grade.PROBLEM)


def test_the_command_has_a_line_for_each_sensor() -> None:
    report = _report(ROBOTS / "odd.toml")
    assert [subject for subject in report if subject.startswith("sensor")] == [
        f"sensor {x}" for x in ("wire", "imu", "gyro")
    ]
    assert report["sensor wire"]["grade"] == "note"

"""What the doctor makes of probe results; every problem and note comes with a cure."""

import json

import pytest
from typer.testing import CliRunner

from gateway.cli.app import build
from gateway.edges import host_checks as doctor
from gateway.edges.can_link import CanLink, parse_link
from gateway.edges.host_checks import Finding, Grade, RealTime, Unit
from tests.world import ROBOTS

# `ip -details -statistics -json link show`, iproute2 6.1: a CAN adapter (shortened), a vcan, nothing.
CAN = json.dumps(
    [
        {
            "ifname": "can0",
            "flags": ["NOARP", "UP", "LOWER_UP", "ECHO"],
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
VCAN = '[{"ifname":"vcan0","flags":["NOARP","UP","LOWER_UP"],"txqlen":1000,"linkinfo":{"info_kind":"vcan"}}]'
GOOD = CanLink("can", up=True, queue=64, bitrate=1_000_000, restart_ms=100, state="ERROR-ACTIVE", errors=(0, 0),
               bus_offs=0, dropped=0)  # fmt: skip
ACTIVE = Unit("loaded", "active", "enabled", "idle, standing", "success", "0", "0", "0")


def texts(findings: list[Finding]) -> str:
    return "; ".join(finding.text for finding in findings)


def test_a_link_is_read_from_ip() -> None:
    assert parse_link(CAN) == CanLink(
        kind="can",
        up=True,
        queue=10,
        bitrate=500_000,
        restart_ms=0,
        state="ERROR-PASSIVE",
        errors=(128, 3),
        bus_offs=2,
        dropped=7,
    )
    virtual = parse_link(VCAN)
    assert virtual is not None
    assert (virtual.kind, virtual.up, virtual.queue, virtual.restart_ms) == ("vcan", True, 1000, None)


@pytest.mark.parametrize("text", ["", "[]", "{", "null", '[{"txqlen": "many"}]', '{"a": 1}'])
def test_anything_else_is_no_link(text: str) -> None:
    assert parse_link(text) is None


def test_a_good_interface_is_one_line() -> None:
    (finding,) = doctor.interface("can0", 1_000_000, GOOD)
    assert finding.grade is Grade.OK
    assert finding.text == "up, 1000000 bit/s, ERROR-ACTIVE, queue 64"


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
    (finding,) = doctor.interface("can0", 1_000_000, link)
    assert text in finding.text
    assert finding.grade is grade
    assert finding.cure


def test_a_virtual_interface_has_no_bit_rate() -> None:
    (finding,) = doctor.interface("vcan0", 1_000_000, parse_link(VCAN))
    assert finding.grade is Grade.OK


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
    assert {"versions", "clock", "disk", "scheduling", "memory", "drivegate@moby.service"} <= set(lines)
    words = CliRunner().invoke(build("doctor"), ["doctor", str(path)])
    assert words.exit_code == 1
    assert all(finding["text"] in words.stdout for finding in lines.values() if finding["subject"] != "clock")

"""install.sh and uninstall.sh on the machine of the other tests (this file comes last), and into an image."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.vm.installed_robot import (
    CONFIG,
    INSTALL,
    SESSIONS,
    Commander,
    install,
    main_pid,
    robot_text,
    run,
    show,
    systemctl,
    wait_active,
)
from tests.vm.launcher import CHECKOUT

pytestmark = [pytest.mark.systemd, pytest.mark.timeout(300)]

PREFIX = Path("/opt/drivegate")
UNINSTALL = CHECKOUT / "deploy" / "uninstall.sh"
DROP_IN = Path("/etc/systemd/system/drivegate@moby.service.d/can.conf")
WANTED = Path("/etc/systemd/system/sys-subsystem-net-devices-vcan0.device.wants/drivegate@moby.service")


def test_the_doctor_is_content_with_a_running_robot(running: Commander) -> None:
    assert running.client.alive
    done = run("/opt/drivegate/bin/python", "-m", "gateway", "doctor", "moby")
    assert done.code == 0, done.output
    for line in ("CAN vcan0: up", "the service runs with SCHED_FIFO", "the service has locked its memory"):
        assert line in done.output
    assert "answered by moby" in done.output
    assert "drivegate@moby.service: active" in done.output


def test_an_upgrade_keeps_the_edited_robot_file_and_the_robot_running(running: Commander) -> None:
    running.await_state(lambda state: state.status.standing is True)
    done = install()
    assert done.code == 0, done.output
    assert done.output.splitlines() == [
        "stopped moby for the upgrade",
        "starting moby: systemctl status drivegate@moby",
    ]
    assert (CONFIG / "moby.toml").read_text(encoding="utf-8") == robot_text()
    assert (CONFIG / "moby.toml.new").read_bytes() == (CHECKOUT / "deploy" / "robots" / "moby.toml").read_bytes()
    assert "BindsTo=sys-subsystem-net-devices-vcan0.device" in DROP_IN.read_text(encoding="utf-8")
    assert WANTED.is_symlink()


def test_a_robot_file_that_is_wrong_is_refused_and_the_robot_runs_on(running: Commander) -> None:
    running.await_state(lambda state: state.status.standing is True)
    pid, file = main_pid(), CONFIG / "moby.toml"
    text = file.read_text(encoding="utf-8")
    file.write_text(f"{text}\n[tomorrow]\n", encoding="utf-8")
    done = install()
    file.write_text(text, encoding="utf-8")
    assert done.code == 1
    assert "tomorrow" in done.output
    assert "Nothing was changed" in done.output
    assert main_pid() == pid


def test_an_upgrade_that_fails_in_the_middle_is_taken_back_and_the_robot_starts_again(
    running: Commander, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    running.await_state(lambda state: state.status.standing is True)
    (tmp_path / "install").write_text("#!/bin/sh\nexit 1\n", encoding="utf-8")
    (tmp_path / "install").chmod(0o755)
    unit = Path("/etc/systemd/system/drivegate@.service")
    before = unit.read_text(encoding="utf-8") + "# older\n"
    unit.write_text(before, encoding="utf-8")
    systemctl("daemon-reload")
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    done = install()
    assert done.code == 1
    assert "everything is as it was before" in done.output
    assert done.output.splitlines()[-1] == "starting moby: systemctl status drivegate@moby"
    assert unit.read_text(encoding="utf-8") == before
    assert WANTED.is_symlink()
    wait_active()


def test_another_environment_and_back(running: Commander, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot is stopped, gets another environment, and starts; with --rollback it starts in the one before."""
    running.await_state(lambda state: state.status.standing is True)
    _put_programs(tmp_path)
    (PREFIX / ".drivegate").write_text("for robot\n", encoding="utf-8")
    before = (PREFIX / "bin/python").stat().st_ino
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    done = run("sh", INSTALL, "--for", "desk")
    assert done.code == 0, done.output
    assert "starting moby" in done.output
    wait_active()
    other = _environment_of_the_service()
    assert (other / "made").exists()
    back = run("sh", INSTALL, "--rollback")
    assert back.code == 0, back.output
    assert "starting moby" in back.output
    wait_active()
    assert not (_environment_of_the_service() / "made").exists()
    assert (PREFIX / "bin/python").stat().st_ino == before
    assert WANTED.is_symlink()
    running.await_state(lambda state: state.status.standing is True)
    systemctl("stop", "drivegate@moby.service")
    shutil.rmtree(f"{PREFIX}.old")
    (PREFIX / ".drivegate").unlink()


def _environment_of_the_service() -> Path:
    """Where its interpreter was found; the directory may have another name now."""
    return Path(f"/proc/{main_pid()}/root{PREFIX}")


def _put_programs(folder: Path) -> None:
    """A python3 that makes an environment from the packages that are here, and a df that finds room for it."""
    packages, name = Path("/opt/packages"), f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages.mkdir()
    subprocess.run(["mount", "--bind", PREFIX / "lib" / name / "site-packages", packages], check=True)
    make = (
        f'mkdir -p "$3/bin" "$3/lib/{name}/site-packages"',
        f'ln -s /opt/python/bin/{name} "$3/bin/python"',
        'echo "home = /opt/python/bin" >"$3/pyvenv.cfg"',
        f'printf "%s\\n" {packages} /opt/checkout >"$3/lib/{name}/site-packages/all.pth"',
        'touch "$3/made"',
        'ln -s /bin/true "$3/bin/pip"',
    )
    python = '#!/bin/sh\n[ "$1 $2" = "-m venv" ] || exec /usr/bin/python3 "$@"\n' + "\n".join(make) + "\n"
    df = "#!/bin/sh\nprintf 'h\\n/dev/x 9999 0 9999 0%% /\\n'\n"
    for program, text in (("python3", python), ("df", df)):
        (folder / program).write_text(text, encoding="utf-8")
        (folder / program).chmod(0o755)


def test_uninstall_keeps_robot_files_and_recordings() -> None:
    sessions = sorted(SESSIONS.glob("moby-*/*.rrd"))
    assert sessions
    for _ in range(2):
        done = run("sh", UNINSTALL)
        assert done.code == 0, done.output
    assert done.output.startswith("kept "), "nothing was left to remove"
    assert show("LoadState", "drivegate@moby.service") == "not-found"
    assert not DROP_IN.exists()
    assert not WANTED.is_symlink()
    assert (CONFIG / "moby.toml").read_text(encoding="utf-8") == robot_text()
    assert sorted(SESSIONS.glob("moby-*/*.rrd")) == sessions
    assert Path("/opt/drivegate/bin/python").exists(), "an environment that install.sh did not build is not removed"


def test_an_image_gets_everything_under_its_root(tmp_path: Path) -> None:
    """With a CAN adapter of a real robot: its network files, its device; the other prefix is in the unit."""
    (tmp_path / "opt/other/bin").mkdir(parents=True)
    python = tmp_path / "opt/other/bin/python"
    python.write_text('#!/bin/sh\nexec /opt/drivegate/bin/python "$@"\n', encoding="utf-8")
    python.chmod(0o755)
    environment = os.environ | {"DESTDIR": str(tmp_path)}
    command = ["sh", str(INSTALL), "--no-venv", "--prefix", "/opt/other", "--enable", "omni4"]
    subprocess.run(command, env=environment, check=True)
    units = tmp_path / "etc/systemd/system"
    assert "ExecStart=/opt/other/bin/python" in (units / "drivegate@.service").read_text(encoding="utf-8")
    assert (units / "sys-subsystem-net-devices-can0.device.wants/drivegate@omni4.service").is_symlink()
    assert (units / "multi-user.target.wants/drivegate@omni4.service").is_symlink()
    network = (tmp_path / "etc/systemd/network/80-drivegate-can0.network").read_text(encoding="utf-8")
    assert "BitRate=1000000" in network
    subprocess.run([*command, "--can", "ip"], env=environment, check=True)
    assert (tmp_path / "etc/drivegate/can/can0.conf").read_text(encoding="utf-8") == "BITRATE=1000000\n"
    subprocess.run(["sh", str(UNINSTALL), "--prefix", "/opt/other"], env=environment, check=True)
    assert not list(units.rglob("*drivegate*"))
    assert not list((tmp_path / "etc/systemd/network").iterdir())
    assert (tmp_path / "etc/drivegate/omni4.toml").exists()

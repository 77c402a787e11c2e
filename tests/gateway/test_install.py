"""What install.sh does into a directory of its own: refuses, writes, takes away, takes back; nothing is brought up."""

import os
import runpy
import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import metadata
from itertools import permutations
from pathlib import Path
from typing import NamedTuple
from zipfile import ZipFile

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

import gateway
from tests.world import ROBOTS

DEPLOY = ROBOTS.parent
PACKAGES = Path(gateway.__file__).parents[1]
CLASSIC = 'channel = "can0"\nbitrate = 1_000_000\n'
FD = f"{CLASSIC}fd = true\n"
FAST = f"{FD}data_bitrate = 5_000_000\n"
OTHER_CHANNEL = CLASSIC.replace("can0", "can1")

# install.sh isolates Python (-I) from where it is called; here that is where DriveGate is. What would be taken out of
# the environment of the tests stays there.
PYTHON = """#!/bin/sh
[ "$1" != -I ] || shift
case $1 in
    *.whl/pip)
        cp {stubs}/environment-pip "$(dirname "$0")/pip"
        PIP_FAILS= exec {stubs}/environment-pip "$@"
        ;;
    *drop_viewer.py) touch "$(dirname "$0")/../without-viewer" && exit 0 ;;
esac
PYTHONPATH={packages} exec {python} "$@"
"""
# Its pip: fails with the words in $PIP_FAILS, if there are any, after those in $PIP_SAYS; has nothing but what is in
# $ONLY_FROM, if that is set.
PIP = """#!/bin/sh
[ -z "$PIP_FAILS" ] || {{ echo "$PIP_SAYS"; echo "$PIP_FAILS" >&2; exit 1; }}
case "$*" in *"--no-index --find-links $ONLY_FROM"*) ;; *) [ -z "$ONLY_FROM" ] ;; esac
"""
# A python3 that makes such an environment; one with pip, as packages, only where there is a network.
SYSTEM_PYTHON = """#!/bin/sh
case "$*" in
    "-m venv "*)
        [ "$3" = --without-pip ] || [ -z "$ONLY_FROM" ] || exit 1
        for last in "$@"; do :; done
        mkdir -p "$last/bin" "$last/lib"
        cp {stubs}/environment-python "$last/bin/python"
        [ "$3" = --without-pip ] || cp {stubs}/environment-pip "$last/bin/pip"
        ;;
    *base_prefix*) echo /usr ;;
    *) exec {python} "$@" ;;
esac
"""
# A program that fails when it is called for the $FAIL_AT-th time.
FAILING = """#!/bin/sh
echo . >>{calls}
[ "$(wc -l <{calls})" != "$FAIL_AT" ] || exit 1
exec {program} "$@"
"""
# A program that has put an environment in its place, or taken it back, or done what comes next, when whoever called it
# gets the signal $SIGNAL.
SIGNALLED = """#!/bin/sh
{program} "$@" || exit
case "$*" in *renameat2* | *"drivegate.new "* | *-sfn* | *-xf*) [ -z "$SIGNAL" ] || kill -"$SIGNAL" $PPID ;; esac
"""


class Done(NamedTuple):
    """A finished install.sh."""

    code: int
    said: str


class Machine:
    """A root directory with robot files, and a folder of programs that come before the machine's own."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "root"
        self.stubs = folder / "stubs"
        self.stubs.mkdir(parents=True)
        self._put_program("environment-python", PYTHON)
        self._put_program("environment-pip", PIP)
        self._put_program("python3", SYSTEM_PYTHON)
        self._put_program("apt-get", "#!/bin/sh\nexit 1\n")
        self.config = self.root / "etc/drivegate"
        self.config.mkdir(parents=True)
        self.networks = self.root / "etc/systemd/network"
        self.units = self.root / "etc/systemd/system"
        self.deploy = DEPLOY

    def robot(self, name: str, bus: str = CLASSIC, *, port: int = 7447) -> None:
        """A robot file of this name on this bus."""
        text = (ROBOTS / "moby.toml").read_text(encoding="utf-8")
        assert all(part in text for part in (CLASSIC, 'name = "moby"', ":7447"))
        text = text.replace(CLASSIC, bus).replace('name = "moby"', f'name = "{name}"').replace(":7447", f":{port}")
        (self.config / f"{name}.toml").write_text(text, encoding="utf-8")

    def fail_at(self, program: str, call: int) -> dict[str, str]:
        """The environment in which a call of a program fails."""
        calls = self.stubs / "calls"
        calls.unlink(missing_ok=True)
        found = shutil.which(program)
        assert found is not None
        self._put_program(program, FAILING.replace("{calls}", str(calls)).replace("{program}", found))
        return {"FAIL_AT": str(call)}

    def signal_after(self, program: str, signal: str) -> dict[str, str]:
        """The environment in which what a program does about a swap is followed by a signal."""
        own = self.stubs / program
        found = own.rename(self.stubs / f"own-{program}") if own.exists() else shutil.which(program)
        self._put_program(program, SIGNALLED.replace("{program}", str(found)))
        return {"SIGNAL": signal}

    def kinds(self) -> dict[str, str]:
        """What each environment that is there was set up for."""
        markers = self.root.glob("opt/*/.drivegate")
        return {path.parent.name: path.read_text(encoding="utf-8").split("for ")[1].split()[0] for path in markers}

    def install(self, *arguments: str, script: str = "install.sh", **environment: str) -> Done:
        """Calls it; with what it says on both outputs."""
        path = f"{self.stubs}{os.pathsep}{os.environ['PATH']}"
        done = subprocess.run(
            ["sh", self.deploy / script, *arguments],
            env=os.environ | {"DESTDIR": str(self.root), "PATH": path} | environment,
            check=False,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        return Done(done.returncode, done.stdout)

    def tree(self) -> dict[str, object]:
        """Everything under the root but the environments."""
        found: dict[str, object] = {}
        for path in sorted(self.root.rglob("*")):
            name = path.relative_to(self.root).as_posix()
            if name.startswith("opt/drivegate"):
                continue
            if path.is_symlink():
                found[name] = path.readlink()
            elif path.is_file():
                found[name] = path.stat().st_mode, path.read_bytes()
        return found

    def files(self, folder: Path) -> list[str]:
        """Names in a folder, which need not be there."""
        return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []

    def _put_program(self, name: str, text: str) -> None:
        path = self.stubs / name
        text = text.replace("{stubs}", str(self.stubs)).replace("{packages}", str(PACKAGES))
        path.write_text(
            text.replace("{python}", sys.executable).replace("{{", "{").replace("}}", "}"), encoding="utf-8"
        )
        path.chmod(0o755)


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    """With moby's file and the environment that is this very one."""
    found = Machine(tmp_path)
    found.robot("moby")
    place = found.root / "opt/drivegate/bin/python"
    place.parent.mkdir(parents=True)
    shutil.copy(found.stubs / "environment-python", place)
    return found


@pytest.fixture
def bare(tmp_path: Path) -> Machine:
    """With moby's file and no environment."""
    found = Machine(tmp_path)
    found.robot("moby")
    return found


def enabled(machine: Machine, bus: str = CLASSIC, kind: str = "networkd") -> Machine:
    """With moby on this bus, set up by `kind`."""
    machine.robot("moby", bus)
    done = machine.install("--no-venv", "--can", kind, "--enable", "moby")
    assert done.code == 0, done.said
    return machine


def can_section(machine: Machine) -> list[str]:
    """Of can0."""
    text = (machine.networks / "80-drivegate-can0.network").read_text(encoding="utf-8")
    return text.split("[CAN]\n")[1].splitlines()


@pytest.mark.parametrize(
    ("bus", "section"),
    [
        (CLASSIC, ["BitRate=1000000", "RestartSec=100ms"]),
        (FD, ["BitRate=1000000", "FDMode=yes", "DataBitRate=1000000", "RestartSec=100ms"]),
        (FAST, ["BitRate=1000000", "FDMode=yes", "DataBitRate=5000000", "RestartSec=100ms"]),
    ],
)
def test_networkd_gets_the_bit_rates_of_the_robot_file(machine: Machine, bus: str, section: list[str]) -> None:
    assert can_section(enabled(machine, bus)) == section


def test_a_bus_that_is_can_fd_no_more_is_set_up_as_a_classic_one(machine: Machine) -> None:
    enabled(machine, FAST)
    assert can_section(enabled(machine, CLASSIC)) == ["BitRate=1000000", "RestartSec=100ms"]


@pytest.mark.parametrize(
    ("bus", "lines"),
    [
        (CLASSIC, ["BITRATE=1000000"]),
        (FAST, ["BITRATE=1000000", "FD=fd on dbitrate 5000000"]),
    ],
)
def test_the_unit_for_plain_ip_gets_the_bit_rates_of_the_robot_file(
    machine: Machine, bus: str, lines: list[str]
) -> None:
    enabled(machine, bus, "ip")
    assert (machine.config / "can/can0.conf").read_text(encoding="utf-8").splitlines() == lines
    unit = (machine.units / "drivegate-can@.service").read_text(encoding="utf-8")
    # Without braces a variable is split into words, none where it is empty (systemd.service, "Command lines").
    assert "type can bitrate ${BITRATE} $FD restart-ms 100" in unit
    assert "\nEnvironment=FD=\nEnvironmentFile=" in unit


# --- Refused before anything is changed ---


@pytest.mark.parametrize(
    ("bus", "said"),
    [
        (CLASSIC.replace("1_000_000", "500_000"), "can0 cannot have a bitrate of 1000000 and of 500000"),
        (FD, "can0 cannot have a bitrate of 1000000 and of 1000000 and (data) 1000000"),
    ],
)
def test_two_robots_that_want_one_channel_differently(machine: Machine, bus: str, said: str) -> None:
    enabled(machine)
    machine.robot("two", bus, port=7448)
    before = machine.tree()
    done = machine.install("--no-venv", "--enable", "two")
    assert done.code == 1
    assert said in done.said
    assert f"{machine.config}/moby.toml and {machine.config}/two.toml" in done.said
    assert "Nothing was changed" in done.said
    assert machine.tree() == before


def test_two_robots_that_want_one_channel_alike_share_it(machine: Machine) -> None:
    enabled(machine)
    machine.robot("two", port=7448)
    assert machine.install("--no-venv", "--enable", "two").code == 0
    assert machine.files(machine.networks) == ["80-drivegate-can0.link", "80-drivegate-can0.network"]


def test_two_robots_on_one_endpoint(machine: Machine) -> None:
    enabled(machine)
    machine.robot("two", OTHER_CHANNEL)
    done = machine.install("--no-venv", "--enable", "two")
    assert done.code == 1
    assert "both have zenoh.listen = 'tcp/127.0.0.1:7447'" in done.said


def test_two_robots_of_one_name(machine: Machine) -> None:
    enabled(machine)
    machine.robot("two", OTHER_CHANNEL, port=7448)
    text = (machine.config / "two.toml").read_text(encoding="utf-8").replace('name = "two"', 'name = "moby"')
    (machine.config / "two.toml").write_text(text, encoding="utf-8")
    done = machine.install("--no-venv", "--enable", "two")
    assert done.code == 1
    assert "both have robot.name = 'moby'" in done.said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["--enable", "moby", "--enable", "nobody"],
            "--enable nobody: there is no robot file /etc/drivegate/nobody.toml",
        ),
        (["--enable", "moby", "--enable", "broken"], "broken.toml: robot.kind: missing"),
        (["--enable", "moby", "--disable", "omni4"], "--disable omni4: it is not set up here"),
        (["--enable", "moby", "--can", "wire"], "--can = wire: must be"),
        (["--for", "boat"], "--for = boat: must be"),
        (["--for", "client", "--enable", "moby"], "a client drives no robot"),
        (["--rollback"], "there is no environment before this one"),
        (["--prefix", "here"], "must be an absolute path"),
        (["--prefix", "//"], "must be an absolute path"),
        (["--prefix", "/opt/drive gate"], "must be of letters, digits"),
        (["--prefix", "/opt/a|b"], "must be of letters, digits"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_changed(
    machine: Machine, arguments: Sequence[str], said: str
) -> None:
    (machine.config / "broken.toml").write_text("[robot]\n", encoding="utf-8")
    before = machine.tree()
    done = machine.install("--no-venv", *arguments)
    assert done.code == 1, done.said
    assert said in done.said
    assert machine.tree() == before


def test_a_robot_whose_file_has_gone(machine: Machine) -> None:
    """An upgrade says so; with --disable it goes on without it."""
    machine.robot("two", OTHER_CHANNEL, port=7448)
    assert machine.install("--no-venv", "--enable", "two").code == 0
    (machine.config / "two.toml").unlink()
    before = machine.tree()
    done = machine.install("--no-venv")
    assert done.code == 1
    assert "put it back, or --disable two" in done.said
    assert machine.tree() == before
    assert machine.install("--no-venv", "--disable", "two").code == 0
    assert not [name for name in machine.tree() if "two" in name]
    assert machine.files(machine.networks) == []


# --- Who sets up the interfaces ---

WAYS = {
    "networkd": (["80-drivegate-can0.link", "80-drivegate-can0.network"], ["kind"], False),
    "ip": ([], ["can0.conf", "kind"], True),
    "none": ([], ["kind"], False),
}


@pytest.mark.parametrize(("before", "after"), list(permutations(WAYS, 2)))
def test_another_way_of_setting_up_leaves_nothing_of_the_one_before(machine: Machine, before: str, after: str) -> None:
    enabled(machine, kind=before)
    own = machine.networks / "80-drivegate-mine.network"
    own.parent.mkdir(exist_ok=True)
    own.write_text("[Match]\nName=eth0\n", encoding="utf-8")
    done = machine.install("--no-venv", "--can", after)
    assert done.code == 0, done.said
    networks, confs, unit = WAYS[after]
    assert machine.files(machine.networks) == sorted([*networks, own.name]), "somebody's own file stays"
    assert machine.files(machine.config / "can") == confs
    assert any("drivegate-can@can0" in name for name in machine.tree()) is unit
    told = f"CAN interfaces: {before} before, {after} now"
    assert told in done.said
    assert machine.install("--no-venv").said == "", "it stays so, and once more changes nothing"


@pytest.mark.parametrize("kind", WAYS)
def test_the_way_of_an_installation_that_has_not_written_it_down_stays(machine: Machine, kind: str) -> None:
    enabled(machine, kind=kind)
    (machine.config / "can/kind").unlink()
    before = {name for name in machine.tree() if "can0" in name}
    assert machine.install("--no-venv").code == 0
    assert {name for name in machine.tree() if "can0" in name} == before


def test_another_channel_leaves_nothing_of_the_one_before(machine: Machine) -> None:
    enabled(machine)
    machine.robot("moby", OTHER_CHANNEL)
    done = machine.install("--no-venv")
    assert machine.files(machine.networks) == ["80-drivegate-can1.link", "80-drivegate-can1.network"]
    assert f"removed {machine.networks}/80-drivegate-can0.network" in done.said
    wanted = [name for name in machine.tree() if ".wants/" in name]
    assert wanted == [
        "etc/systemd/system/multi-user.target.wants/drivegate@moby.service",
        "etc/systemd/system/sys-subsystem-net-devices-can1.device.wants/drivegate@moby.service",
    ]


def test_network_manager_leaves_the_interfaces_alone_where_there_is_one(machine: Machine) -> None:
    (machine.root / "etc/NetworkManager").mkdir()
    file = machine.root / "etc/NetworkManager/conf.d/80-drivegate.conf"
    enabled(machine)
    machine.robot("two", OTHER_CHANNEL, port=7448)
    machine.install("--no-venv", "--enable", "two")
    lines = file.read_text(encoding="utf-8").splitlines()
    assert lines[1:] == ["[keyfile]", "unmanaged-devices+=interface-name:can0;interface-name:can1"]
    machine.install("--no-venv", "--can", "none")
    assert not file.exists()


def test_uninstall_takes_away_what_is_ours(machine: Machine) -> None:
    (machine.root / "etc/NetworkManager").mkdir()
    enabled(machine, kind="ip")
    enabled(machine, kind="networkd")
    override = machine.units / "drivegate@moby.service.d/override.conf"
    override.write_text("[Service]\nNice=0\n", encoding="utf-8")
    for _ in range(2):
        done = machine.install(script="uninstall.sh")
        assert done.code == 0, done.said
    own = {f"etc/drivegate/{path.name}" for path in ROBOTS.glob("*.toml")}
    assert set(machine.tree()) == own | {override.relative_to(machine.root).as_posix()}


# --- The environment ---


def test_an_environment_is_built_only_for_something_new(bare: Machine) -> None:
    assert "building" in bare.install("--enable", "moby").said
    assert (bare.root / "opt/drivegate/without-viewer").exists()
    again = bare.install()
    assert "building" not in again.said
    assert "for a robot: without Rerun's viewer" in again.said
    desk = bare.install("--for", "desk")
    assert "building" in desk.said
    assert not (bare.root / "opt/drivegate/without-viewer").exists()
    assert "for a desk" in bare.install().said, "what it was set up for it stays for"


def test_a_client_gets_its_commands_and_nothing_of_a_robot(bare: Machine) -> None:
    done = bare.install("--for", "client")
    assert "for a client" in done.said
    assert set(bare.tree()) == {"etc/drivegate/moby.toml", "usr/local/bin/drivegate"}


def test_a_robot_is_not_made_a_client(bare: Machine) -> None:
    bare.install()
    done = bare.install("--for", "client")
    assert done.code == 1
    assert "first sh" in done.said


@pytest.mark.parametrize(
    ("words", "arguments", "said"),
    [
        ("OSError: [Errno 28] No space left on device", [], "the disk is full"),
        ("ERROR: No matching distribution found for numpy", [], "is there a network?"),
        ("ERROR: No matching distribution found for numpy", ["--wheelhouse", "."], "lacks a package"),
        ("Failed to establish a new connection: [Errno -3] NameResolutionError", [], "is there a network?"),
        ("error: something else", [], "pip failed"),
    ],
)
def test_what_pip_cannot_do_is_said_and_the_environment_stays(
    bare: Machine, words: str, arguments: Sequence[str], said: str
) -> None:
    assert bare.install("--enable", "moby").code == 0
    (bare.stubs / "pip-1.whl").write_text("", encoding="utf-8")
    before = bare.tree()
    place = bare.root / "opt/drivegate"
    marker = (place / ".drivegate").read_bytes()
    arguments = [str(bare.stubs) if one == "." else one for one in arguments]
    done = bare.install("--for", "desk", *arguments, PIP_FAILS=words)
    assert done.code == 1
    assert said in done.said
    assert words in done.said
    assert bare.tree() == before
    assert (place / ".drivegate").read_bytes() == marker
    assert bare.files(place.parent) == ["drivegate"]


def test_it_is_said_which_package_a_wheelhouse_lacks(bare: Machine) -> None:
    (bare.stubs / "pip-1.whl").touch()
    conflict = "The conflict is caused by:\n    drivegate[robot] depends on numpy>=2.0\n    numpy==2.4.6\n"
    done = bare.install(
        *("--wheelhouse", str(bare.stubs)),
        PIP_SAYS=f"Collecting\n\n{conflict}\nTo fix this you could try",
        PIP_FAILS="ERROR: ResolutionImpossible: for help",
    )
    assert done.code == 1
    assert conflict in done.said
    assert "lacks a package: make it again with deploy/wheelhouse.py --for robot, for this computer" in done.said
    assert "Collecting" not in done.said
    assert "To fix" not in done.said


def test_without_a_network_all_comes_from_the_wheelhouse(
    bare: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor is python3-venv needed, whose absence ends an installation without one."""
    wheels = tmp_path / "wheelhouse"
    wheels.mkdir()
    monkeypatch.chdir(tmp_path)
    for arguments, said in (([], "python3-venv is missing"), (["--wheelhouse", "wheelhouse"], "has no pip-*.whl")):
        done = bare.install(*arguments, ONLY_FROM=str(wheels))
        assert done.code == 1
        assert said in done.said
        assert "nothing was changed" in done.said
    (wheels / "pip-1.whl").touch()
    done = bare.install("--wheelhouse", "wheelhouse", ONLY_FROM=str(wheels))
    assert done.code == 0, done.said
    assert bare.kinds() == {"drivegate": "robot"}
    assert "MB in" in done.said


def test_a_python_that_is_too_old(bare: Machine) -> None:
    (bare.stubs / "python3").write_text('#!/bin/sh\n[ "$1" = -V ] && echo Python 3.9.2\nexit 1\n', encoding="utf-8")
    before = bare.tree()
    done = bare.install()
    assert done.code == 1
    assert "Python 3.11 or newer is needed (Debian 12 has it); python3 is Python 3.9.2" in done.said
    assert bare.tree() == before


def test_a_disk_that_is_too_full(bare: Machine) -> None:
    (bare.stubs / "df").write_text("#!/bin/sh\nprintf 'h\\n/dev/x 100 90 10 90%% /\\n'\n", encoding="utf-8")
    (bare.stubs / "df").chmod(0o755)
    done = bare.install()
    assert done.code == 1
    assert "has room for 10 MB, and building takes 1200 MB" in done.said
    assert not (bare.root / "opt/drivegate").exists()


def test_rollback_brings_the_environment_before_and_its_units_and_goes_forward_again(
    bare: Machine, tmp_path: Path
) -> None:
    """Another version of the software, with another unit and another template of networks."""
    assert bare.install("--enable", "moby").code == 0
    old = bare.tree()
    newer = tmp_path / "newer"
    shutil.copytree(DEPLOY, newer / "deploy")
    for name in ("gateway", "drivers", "replay"):
        (newer / name).mkdir()
    shutil.copy(DEPLOY.parent / "pyproject.toml", newer)
    for name in ("drivegate@.service", "80-can.network"):
        with (newer / "deploy" / name).open("a", encoding="utf-8") as file:
            file.write("# newer\n")
    bare.deploy = newer / "deploy"
    assert bare.install("--can", "networkd").code == 0
    new = bare.tree()
    assert new != old
    for expected in (old, new, old):
        done = bare.install("--rollback")
        assert done.code == 0, done.said
        assert "with its units" in done.said
        assert bare.tree() == expected
    assert bare.files(bare.root / "opt") == ["drivegate", "drivegate.old"]


def test_rollback_is_refused_where_the_old_software_does_not_take_the_robot_file(bare: Machine) -> None:
    assert bare.install("--enable", "moby").code == 0
    assert bare.install("--for", "desk").code == 0
    (bare.config / "moby.toml").write_text("[robot]\n", encoding="utf-8")
    before = bare.tree()
    done = bare.install("--rollback")
    assert done.code == 1
    assert f"{bare.config}/moby.toml" in done.said
    assert bare.tree() == before
    assert "for desk" in (bare.root / "opt/drivegate/.drivegate").read_text(encoding="utf-8")


@pytest.mark.parametrize(("program", "call"), [("install", 2), ("install", 15), ("systemctl", 1), ("mv", 1)])
@pytest.mark.parametrize("fresh", [True, False], ids=["first", "upgrade"])
def test_what_fails_in_the_middle_is_taken_back(bare: Machine, program: str, call: int, fresh: bool) -> None:
    if not fresh:
        assert bare.install("--enable", "moby").code == 0
        bare.robot("moby", OTHER_CHANNEL)
        for unit in ("drivegate@.service", "drivegate-can@.service"):
            (bare.units / unit).write_text("of an older version\n", encoding="utf-8")
        call = min(call, 4)
    before = bare.tree()
    done = bare.install("--for", "desk", "--enable", "moby", **bare.fail_at(program, call))
    assert done.code == 1, done.said
    assert "failed; everything is as it was before" in done.said
    assert bare.tree() == before
    assert bare.files(bare.root / "opt") == ([] if fresh else ["drivegate"])
    if not fresh:
        assert "for robot" in (bare.root / "opt/drivegate/.drivegate").read_text(encoding="utf-8")
    done = bare.install("--for", "desk", "--enable", "moby", FAIL_AT="0")
    assert done.code == 0, done.said


@pytest.mark.parametrize(
    ("program", "before", "signal"),
    [
        ("mv", [], "HUP"),
        ("mv", ["robot"], "INT"),
        ("python3", ["robot"], "TERM"),
        ("python3", ["desk", "robot"], "INT"),
    ],
)
def test_a_signal_in_the_middle_of_a_swap_loses_no_environment(
    bare: Machine, program: str, before: Sequence[str], signal: str
) -> None:
    """Whether it ends or goes on, what it then says is so."""
    for kind in before:
        assert bare.install("--for", kind).code == 0
    swap = bare.signal_after(program, signal)
    done = bare.install("--for", "desk", **swap)
    assert done.code == 0, done.said
    now = {"drivegate": "desk", "drivegate.old": "robot"} if before else {"drivegate": "desk"}
    assert bare.kinds() == now
    if before:
        done = bare.install("--rollback", **swap)
        assert done.code == 0, done.said
        assert bare.kinds() == {"drivegate": "robot", "drivegate.old": "desk"}


@pytest.mark.parametrize(("program", "arguments"), [("ln", ["--for", "desk"]), ("tar", ["--rollback"])])
def test_a_signal_after_a_swap_takes_it_back(bare: Machine, program: str, arguments: Sequence[str]) -> None:
    for kind in ("desk", "robot"):
        assert bare.install("--for", kind).code == 0
    before = bare.tree()
    done = bare.install(*arguments, **bare.signal_after(program, "INT"))
    assert done.code == 130, done.said
    assert "failed; everything is as it was before" in done.said
    assert bare.tree() == before
    assert bare.kinds() == {"drivegate": "robot", "drivegate.old": "desk"}


@pytest.mark.parametrize("signal", ["INT", "TERM"])
def test_a_signal_while_it_is_taken_back_leaves_nothing_half_done(bare: Machine, signal: str) -> None:
    """Such as a second Ctrl-C."""
    assert bare.install("--enable", "moby").code == 0
    (bare.units / "drivegate@.service").write_text("of an older version\n", encoding="utf-8")
    before = bare.tree()
    done = bare.install("--for", "desk", **bare.signal_after("python3", signal), **bare.fail_at("install", 1))
    assert done.code == 1, done.said
    assert "failed; everything is as it was before" in done.said
    assert bare.tree() == before
    assert bare.kinds() == {"drivegate": "robot"}


def test_what_one_that_was_killed_left_mixes_with_nothing(bare: Machine) -> None:
    """The environment for --rollback is the same after a failure, though an older one still lies beside it."""
    for kind in ("robot", "desk"):
        assert bare.install("--for", kind).code == 0
    left = bare.root / "opt/drivegate.older"
    left.mkdir()
    (left / "left").touch()
    done = bare.install("--for", "robot", **bare.fail_at("install", 1))
    assert done.code == 1, done.said
    assert bare.files(bare.root / "opt") == ["drivegate", "drivegate.old"]
    assert "for robot" in (bare.root / "opt/drivegate.old/.drivegate").read_text(encoding="utf-8")


def test_a_slash_at_the_end_of_the_prefix_changes_nothing(bare: Machine) -> None:
    for kind in ("robot", "desk"):
        done = bare.install("--prefix", "/opt/drivegate/", "--for", kind)
        assert done.code == 0, done.said
    assert bare.files(bare.root / "opt") == ["drivegate", "drivegate.old"]
    assert bare.install("--prefix", "/opt/drivegate//", script="uninstall.sh").code == 0
    assert not (bare.root / "opt/drivegate").exists()


def test_taking_the_viewer_out_leaves_a_package_that_knows_its_files(tmp_path: Path) -> None:
    (tmp_path / "rerun_cli").mkdir()
    (tmp_path / "rerun_cli/rerun").write_text("large", encoding="utf-8")
    (tmp_path / "rerun_cli/__main__.py").write_text("", encoding="utf-8")
    folder = tmp_path / "rerun_sdk-0.41.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: rerun-sdk\nVersion: 0.41.0\n", encoding="utf-8")
    kept = 'rerun_cli/__main__.py,sha256=x,0\n"a,b",,\nrerun_sdk-0.41.0.dist-info/RECORD,,\n'
    (folder / "RECORD").write_text(f"rerun_cli/rerun,sha256=y,5\n{kept}", encoding="utf-8")
    for _ in range(2):  # -S: of this folder alone, not of the environment of the tests
        command = [sys.executable, "-S", str(DEPLOY / "drop_viewer.py")]
        subprocess.run(command, env={"PYTHONPATH": str(tmp_path)}, check=True)
    assert not (tmp_path / "rerun_cli/rerun").exists()
    assert (folder / "RECORD").read_text(encoding="utf-8") == kept


def test_a_wheelhouse_has_what_is_run_and_what_builds_it() -> None:
    told = runpy.run_path(str(DEPLOY / "wheelhouse.py"))
    kinds = ("client", "robot", "desk")
    assert set(told["KINDS"]) == set(kinds)
    client, robot, desk = ({Requirement(one).name for one in told["packages"](kind)} for kind in kinds)
    assert client < robot < desk
    assert {"pip", "hatchling", "mypy", "eclipse-zenoh"} <= client
    assert {"rerun-sdk", "python-can"} <= robot - client
    assert {"scipy", "mcap"} <= desk - robot
    assert "manylinux_2_28_aarch64" in told["platforms"]("aarch64")


def test_every_version_that_we_pin_takes_the_python_of_debian_12() -> None:
    """Told by the installed packages themselves; a newer Python than that hides one that does not."""
    lines = (DEPLOY / "constraints.txt").read_text(encoding="utf-8").split()
    told = {name: metadata(name) for name in (line.partition("==")[0] for line in lines)}
    wanted = {name: one["Requires-Python"] for name, one in told.items() if "Requires-Python" in one}
    assert len(wanted) > len(told) // 2
    assert {name: python for name, python in wanted.items() if "3.11.2" not in SpecifierSet(python)} == {}


def put_wheel(folder: Path, name: str, tag: str = "py3-none-any", needs: str = "") -> None:
    """A package with nothing in it, of the version that we want."""
    lines = (DEPLOY / "constraints.txt").read_text(encoding="utf-8").split()
    pinned = {canonicalize_name(line.partition("==")[0]): line.partition("==")[2] for line in lines}
    version = pinned.get(canonicalize_name(name), "99")
    stem = f"{name.replace('-', '_')}-{version}"
    told = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
    with ZipFile(folder / f"{stem}-{tag}.whl", "w") as wheel:
        wheel.writestr(f"{stem}.dist-info/METADATA", told + (f"Requires-Dist: {needs}\n" if needs else ""))
        wheel.writestr(f"{stem}.dist-info/WHEEL", f"Wheel-Version: 1.0\nTag: {tag}\n")


def test_a_wheelhouse_for_another_computer_is_collected_whole(tmp_path: Path) -> None:
    """By pip itself, from a folder instead of an index."""
    told = runpy.run_path(str(DEPLOY / "wheelhouse.py"))
    names = {Requirement(one).name for one in told["packages"]("robot")}
    index = tmp_path / "index"
    index.mkdir()
    for name in names - {"numpy", "rich"}:
        put_wheel(index, name)
    put_wheel(index, "rich", needs="pygments")
    put_wheel(index, "pygments")
    ours = f"cp3{sys.version_info.minor}"
    for other in ("cp399-cp399-manylinux_2_28_x86_64", f"{ours}-{ours}-manylinux_2_28_aarch64"):
        put_wheel(index, "numpy", other)

    def collect() -> Done:
        script = [str(DEPLOY / "wheelhouse.py"), "wheelhouse", "--machine", "aarch64", "--python", "3.99"]
        done = subprocess.run(
            [sys.executable, *script],
            cwd=tmp_path,
            env=os.environ | {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(index)},
            check=False,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        return Done(done.returncode, done.stdout)

    done = collect()
    assert done.code == 1
    assert "(constraint) numpy==" in done.said
    assert "wheelhouse is not complete: see above" in done.said
    put_wheel(index, "numpy", "cp399-cp399-manylinux_2_28_aarch64")
    done = collect()
    assert done.code == 0, done.said
    assert f"{len(names) + 1} packages, 0 MB, for a robot with Python 3.99 on aarch64." in done.said
    assert "sudo sh deploy/install.sh --for robot --wheelhouse wheelhouse" in done.said
    found = {path.name.split("-")[0].replace("_", "-"): path.name for path in (tmp_path / "wheelhouse").iterdir()}
    assert set(found) == names | {"pygments"}
    assert found["numpy"].endswith("-cp399-cp399-manylinux_2_28_aarch64.whl")

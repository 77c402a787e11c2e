"""What is given to strangers: text and incidents in which nothing of what was planted is left."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway import robot_files
from gateway.config import parse
from gateway.recording.bundle import kept
from gateway.types import Request, RequestKind
from replay.compare.verify import verify
from replay.drive.pieces import cut
from replay.sessions.reader import SessionError, open_session
from replay.sharing.incident import share, texts
from replay.sharing.redaction import GONE, Redaction
from tests.incidents import MarkedWorld, orders, short, with_snapshots

PEM = """-----BEGIN PRIVATE KEY-----
MIIEvQIBADANBgkqhkiG9w0BAQEFAASCBKcwggSjAgEAAoIBAQC7VJTUt9Us8cKj
MzEfYyjiWA4R4/M2bS1GB4t7NXp98C3SC6dVMvDuictGeurT8jNbvJZHtCSuYEvu
-----END PRIVATE KEY-----"""
B64 = "Zm9vYmFyYmF6cXV4MTIzNDU2Nzg5MEFCQ0RFRkdISUpLTA=="
JWT = "eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiJhbGljZSJ9.c2lnbmF0dXJlMTIz"


def redaction() -> Redaction:
    return Redaction(people={"alice", "root", "pi", ""}, homes={"/srv/people/bob", "/", ""}, hosts={"alices-laptop"})


@pytest.mark.parametrize(
    ("text", "secret", "left"),
    [
        ("connect to tcp://joe:hunter2@10.0.0.1:7447", "hunter2", "connect to tcp://REDACTED@10.0.0.1:7447"),
        ("tls/joe:p@ss/word@host:7447 is up", "p@ss/word", "tls/REDACTED@host:7447 is up"),
        ("http://ghost@host/x", "ghost", "http://REDACTED@host/x"),
        ('password = "hunter2" # mine', "hunter2", 'password = "REDACTED" # mine'),
        ("ZENOH_PASSWORD=hunter2", "hunter2", "ZENOH_PASSWORD=REDACTED"),
        ('{"api_key": \'hunter2\', "rate": 5}', "hunter2", '{"api_key": \'REDACTED\', "rate": 5}'),
        ("wifi-passphrase: correct", "correct", "wifi-passphrase: REDACTED"),
        ("the password is hunter2, he said", "hunter2", "the password is REDACTED, he said"),
        ("# wifi password: correct horse battery, 5 GHz", "horse", "# wifi password: REDACTED, 5 GHz"),
        ("password: it's hunter2", "hunter2", "password: REDACTED"),
        ('password = "cut off, hunter2', "hunter2", 'password = "REDACTED"'),
        ("token=hunter2 user=joe", "hunter2", "token=REDACTED user=joe"),
        ("password => hunter2", "hunter2", "password => REDACTED"),
        ("Passwort: hunter2", "hunter2", "Passwort: REDACTED"),
        ("pw: hunter2", "hunter2", "pw: REDACTED"),
        ("wpa_passphrase hunter2", "hunter2", "wpa_passphrase REDACTED"),
        ("wss/joe:hunter2@host", "hunter2", "wss/REDACTED@host"),
        (r"tcp\/joe:hunter2@host", "hunter2", r"tcp\/REDACTED@host"),
        ("--api-key hunter2 --rate 5", "hunter2", "--api-key REDACTED --rate 5"),
        ("id AKIAIOSFODNN7EXAMPLE", "IOSFODNN7", "id REDACTED"),
        ("tokens = ['hunter2', 'b']", "hunter2", "tokens = REDACTED"),
        ("Authorization: Bearer hunter2x", "hunter2x", "Authorization: REDACTED REDACTED"),
        (f"a\n{PEM}\nb", "MIIEvQ", "a\nREDACTED\nb"),
        (PEM.partition("\n")[0] + "\nMIIEvQ", "MIIEvQ", "REDACTED"),  # cut off behind
        (PEM[60:] + "\nb", "uictGeurT8", "REDACTED\nb"),  # cut off in front
        (f"x {B64} y", B64, "x REDACTED y"),
        (f"cookie-less {JWT}", JWT, "cookie-less REDACTED"),
        ("key ghp_0123456789abcdefABCDEF", "0123456789abcdef", "key REDACTED"),
        ("mail joe@example.org now", "joe", "mail REDACTED now"),
        ("in /home/joe/robots/moby.toml", "joe", "in ~/robots/moby.toml"),
        ("in /root/robots, /Users/joe", "joe", "in ~/robots, ~"),
        ("in /srv/people/bob/x", "bob", "in ~/x"),
        ("alice started it on alices-laptop; malice", "alices", "somebody started it on somewhere; malice"),
    ],
)
def test_what_goes_and_what_stays(text: str, secret: str, left: str) -> None:
    found = redaction()
    shared = found.text(text)
    assert secret not in shared
    assert shared == left
    assert found.times > 0


@pytest.mark.parametrize(
    "text",
    [
        *(path.read_text(encoding="utf-8") for path in robot_files.bundled().values()),
        "drivegate@moby.service: active, drivegate-can@can0.service",
        "sha256 9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
        "/opt/drivegate/lib/python3.11/site-packages/gateway/recording/incidents.py",
        "user root on pi, robot moby",
        "pass --connect tcp/127.0.0.1:7447, or its robot file as NAME",
        "",
    ],
)
def test_what_is_no_secret_stays_as_it_is(text: str) -> None:
    assert redaction().text(text) == text


@pytest.mark.parametrize(
    "letters", ["a", "aA1", "-", "x.", "tcp/", "://", "secret", "aaaaaaaaaaaaaaaaaaaaaaaa ", " \n"]
)
def test_a_line_of_any_length_is_read_in_steps_that_grow_as_it_does(letters: str) -> None:
    """Tried again at each of its own letters, this one would take most of an hour."""
    redaction().text(letters * (200_000 // len(letters)))


def test_a_secret_of_one_text_is_one_in_another() -> None:
    found = redaction()
    found.text("tcp/joe:hunter2@host:7447")
    assert found.again("logged in with hunter2") == f"logged in with {GONE}"
    assert found.left_in(b"\x00hunter2\x00")
    assert not found.left_in(b"there is none")


def test_whose_home_directory_there_is_has_a_name() -> None:
    found = redaction()
    found.text("in /home/carol/x and /var/home/Carla, /home/pi/y")
    assert found.again("carol, carole, Carla, pi") == "somebody, carole, somebody, pi"


@given(st.text("abc/:@=\"' \n#-.xyzAB09", max_size=200))
def test_twice_is_as_good_as_once(text: str) -> None:
    once = redaction().text(text)
    assert redaction().text(once) == once


ZENOH: dict[str, Any] = {
    "mode": "peer",
    "listen": {"endpoints": ["tcp/joe:hunter2@0.0.0.0:7447"]},
    "transport": {
        "auth": {"usrpwd": {"user": "joe", "password": "hunter3", "dictionary_file": "/etc/people.txt"}},
        "link": {"tls": {"listen_private_key": "/etc/own.key", "root_ca_certificate_base64": B64, "verify": True}},
    },
    "access_control": {
        "rules": [{"id": "rule1", "key_exprs": ["moby/cmd/**"]}],
        "subjects": [{"id": "s", "usernames": ["alice"], "cert_common_names": ["bobs.example"]}],
    },
    "plugins": {"storage": {"credentials": "hunter4"}},
    "metadata": {"location": "alice's desk"},
}


def test_of_zenohs_configuration_the_sections_stay() -> None:
    shared: Any = redaction().document(ZENOH)
    text = json.dumps(shared)
    secrets = ("hunter", "joe", "people.txt", "own.key", B64, "alice", "bobs", "desk")
    assert not [secret for secret in secrets if secret in text]
    assert shared["mode"] == "peer"
    assert shared["listen"] == {"endpoints": ["tcp/REDACTED@0.0.0.0:7447"]}
    assert shared["transport"]["link"]["tls"]["verify"] is True
    assert shared["access_control"]["rules"] == ZENOH["access_control"]["rules"]


# incidents

PLANTED = """
# password: hunter2
# by alice, on alices-laptop, from /home/alice/robots
"""
SECRETS = ("hunter2", "hunter5", "hunter6", "alice", "/home/", B64)


@pytest.fixture(scope="module")
def incident(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With secrets in its robot file, in the words of a mark, in its origin."""
    folder = tmp_path_factory.mktemp("incidents")
    world = MarkedWorld("moby", [])
    world.drive(200)
    told = f"alice saw it, token=hunter6, {B64}"
    world.cycle(requests=[Request(RequestKind.MARK, 8, world.now_ns + world.period_ns, text=told)])
    world.drive(300)
    config = short(world.config, folder)
    text = world.text.replace("[zenoh]", '[zenoh]\nconnect = ["tcp/joe:hunter5@10.0.0.1:7447"]') + PLANTED
    (order,) = orders(world, config, with_snapshots(config, world.packets, (50, 150)))
    hello = order.hello._replace(config_text=text, config_origin="/home/alice/moby.toml")
    path = Path(str(kept(msgspec.structs.replace(order, hello=hello)).file))
    assert verify(open_session(path)).identical
    assert all(any(secret in one for one in texts(open_session(path))) for secret in SECRETS)
    return path


def test_a_shared_incident_has_no_secret_and_still_verifies(incident: Path, tmp_path: Path) -> None:
    found = redaction()
    original = open_session(incident)
    for text in texts(original):
        found.text(text)
    path = tmp_path / "shared.rrd"
    share(open_session(incident), path, found.again)
    shared = open_session(path)
    verdict = verify(shared)
    assert verdict.identical, verdict
    assert verdict.cycles == verify(open_session(incident)).cycles
    assert shared.complete, shared.problems
    assert not [secret for secret in SECRETS for one in texts(shared) if secret in one]
    assert not [secret for secret in SECRETS if secret.encode() in path.read_bytes()]
    assert not [secret for secret in SECRETS for state in shared.snapshots.values() if secret.encode() in state]
    cause = shared.header.incident
    assert cause is not None
    assert cause.causes[0].text == "somebody saw it, token=REDACTED, REDACTED"
    assert parse(shared.config_text, "shared").zenoh.connect == ["tcp/REDACTED@10.0.0.1:7447"]
    assert shared.header.config_origin == "~/moby.toml"
    assert path.stat().st_size < incident.stat().st_size
    assert [cycle for cycle, _ in shared.timings()] == [cycle for cycle, _ in original.timings()]


def test_a_shared_incident_can_be_drawn_again(incident: Path, tmp_path: Path) -> None:
    path = tmp_path / "shared.rrd"
    share(open_session(incident), path, redaction().text)
    piece = cut(open_session(path), tmp_path)
    assert verify(open_session(piece.session)).identical


@pytest.mark.parametrize("name", ["teleop", "left", "can0", "moby"])
def test_an_incident_with_a_person_called_as_something_in_its_robot_file_is_not_shared(
    name: str, incident: Path, tmp_path: Path
) -> None:
    """Its frames and commands have those names too: it would verify no more."""
    path = tmp_path / "shared.rrd"
    with pytest.raises(SessionError, match="a name in its robot file"):
        share(open_session(incident), path, Redaction(people={name}, homes=set(), hosts=set()).text)
    assert not path.exists()

"""A law that cannot fail guards nothing: each notices when a rule that keeps it is taken out of the core.

Every row takes one rule out and names the law that must notice, in a short drive that keeps all laws with the rule in.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import pytest

from drivers.contract import MotorFeedback
from gateway.config import parse
from gateway.control import posture, region_policy
from gateway.control.drive_law import Motion, SpeedLaw
from gateway.control.limits import TwistLimiter
from gateway.control.posture import Posture, Stance
from gateway.control.region_policy import RegionPolicy
from gateway.core import engine, health, supervisor
from gateway.core.arbiter import Arbiter
from gateway.core.engine import Engine
from gateway.core.health import Fault, HealthMonitor
from gateway.core.joint_trust import JointTrust
from gateway.core.standstill import Standstill
from gateway.types import ZERO_TWIST, Attitude, Mode, Rates, Region, Twist, TwistCommand
from replay.drive.scenario_file import Scenario
from replay.inject.laws import ALL_LAWS
from replay.inject.random_drives import Driven, judge
from tests.world import robot_text

pytestmark = pytest.mark.pure_python
GROWS, LET_GO, ZERO, STEPS, IDLE, UP, ROUND, REST = ALL_LAWS
Patch = pytest.MonkeyPatch
Entry = dict[str, Any]


def say(t: float, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0, *, by: str = "teleop", **more: object) -> Entry:
    return {"t": t, "command": {"source": by, "vx": vx, "vy": vy, "wz": wz, **more}}


def hush(t: float, source: str = "teleop") -> Entry:
    return {"t": t, "silence": source}


def ask(t: float, request: str) -> Entry:
    return {"t": t, "request": request}


def fault(t: float, kind: str, **more: object) -> Entry:
    return {"t": t, "fault": {"kind": kind, **more}}


# the setpoint grows in DRIVE and DEGRADED only


def brake_along_the_line(patch: Patch) -> None:
    """Braking walks to zero as driving would: with the rate it had, which may lead elsewhere."""
    patch.setattr(TwistLimiter, "brake", lambda self, dt, effort=1.0: self.step(ZERO_TWIST, dt, effort=effort)[0])


# what is let go stays so until IDLE


def lose_nothing(patch: Patch) -> None:
    """A motor that failed while energised is driven again as soon as it is well."""
    patch.setattr(health, "STILL_BRAKING", frozenset(health.FaultKind))
    patch.setattr(HealthMonitor, "lose", lambda self, indices: None)


def lose_no_released_one(patch: Patch) -> None:
    """A stalled motor is released in DEGRADED and driven again on the way to rest. Two rules each prevent that:
    what was released is lost, and so is a controller that is out of operation without a fault.
    """
    patch.setattr(HealthMonitor, "lose", lambda self, indices: None)
    reported = HealthMonitor._reported

    def report(self: HealthMonitor, index: int, motor: MotorFeedback, *, energised: bool) -> Fault | None:
        self._obeyed.discard(index)
        return reported(self, index, motor, energised=energised)

    patch.setattr(HealthMonitor, "_reported", report)


def command_everyone(patch: Patch) -> None:
    """A motor that fell silent is commanded all the same, and driven as soon as it is back."""
    patch.setattr(Engine, "_may_be_commanded", lambda self, health: (True,) * len(self._names))


# nothing moves without a zero of its own


def admit_without_zero(patch: Patch) -> None:
    """Whoever is fresh may drive."""
    receive = Arbiter.receive

    def receiving(self: Arbiter, command: TwistCommand) -> None:
        receive(self, command)
        self._admitted.add(command.source)

    patch.setattr(Arbiter, "receive", receiving)


def dismiss_nobody(patch: Patch) -> None:
    """A zero from before the last rest or stop still counts."""
    patch.setattr(Arbiter, "dismiss", lambda self, now_ns: None)


def start_over_never(patch: Patch) -> None:
    """What comes after a silence, and needs no stamp, goes on where the one before it stopped."""
    patch.setattr(Arbiter, "_starts_over", lambda self, command, before: before and command.sender != before.sender)


def any_sender(patch: Patch) -> None:
    """Another process inherits the zero of the one before it."""
    starts_over = Arbiter._starts_over
    patch.setattr(
        Arbiter,
        "_starts_over",
        lambda self, command, before: starts_over(self, command, before and before._replace(sender=command.sender)),
    )


# no steps but into an emergency stop


def believe_every_angle(patch: Patch) -> None:
    """An angle that jumped still turns the wheels."""
    patch.setattr(JointTrust, "trusted", lambda self, angles: list(angles))


def stop_at_once(patch: Patch) -> None:
    """Without limits the setpoint is zero at once."""

    def brake(self: TwistLimiter, dt: float, *, effort: float = 1.0) -> Twist:
        self.reset()
        return ZERO_TWIST

    patch.setattr(TwistLimiter, "brake", brake)


def release_the_proportion(patch: Patch) -> None:
    """Without the joint angle the wheels are stopped dead."""
    patch.setattr(SpeedLaw, "_in_proportion", lambda self, setpoint: [0.0] * len(self._top_speeds))


def see_again_at_once(patch: Patch) -> None:
    """An angle that comes back while braking is used at once."""
    motion = SpeedLaw.motion_at

    def seeing(self: SpeedLaw, setpoint: Twist, angles: Sequence[float | None], *, braking: bool) -> Motion:
        self._blind = False
        return motion(self, setpoint, angles, braking=braking)

    patch.setattr(SpeedLaw, "motion_at", seeing)


def fall_back_in_one_step(patch: Patch) -> None:
    """The setpoint falls to what is measured in one period."""
    patch.setattr(engine, "RETREAT", 1e9)


# everything is released in IDLE


def keep_energised_in_idle(patch: Patch) -> None:
    """IDLE waits for the rest that came before it."""
    enter = Engine._enter

    def entering(self: Engine, mode: Mode, now_ns: int) -> None:
        energised = self._energised
        enter(self, mode, now_ns)
        self._energised = energised if mode is Mode.IDLE else self._energised

    patch.setattr(Engine, "_enter", entering)


# turns its chassis round only as it was asked to


def go_on_whoever_asks(patch: Patch) -> None:
    """What has begun is driven to its end."""
    patch.setattr(RegionPolicy, "_why_end", lambda self, wish, seen: None)
    wishes: list[region_policy.Wish] = []

    def remembered(target: Rates, region: Region, path_rate: float | None) -> region_policy.Wish | None:
        wish = wish_of(target, region, path_rate)
        wishes.extend([] if wish is None else [wish])
        return wishes[-1] if wishes else None

    wish_of = region_policy._wish
    patch.setattr(region_policy, "_wish", remembered)


def begin_at_once(patch: Patch) -> None:
    """Nobody gets the time to take it back."""
    patch.setattr(region_policy, "NOTICE", 0.0)


def turn_the_platform_too(patch: Patch) -> None:
    """The turn that the command asks for is driven on top of it."""
    patch.setattr(SpeedLaw, "motion_at", turning_too(SpeedLaw.motion_at))


def turning_too(motion_at: Callable[..., Motion]) -> Callable[..., Motion]:
    def turning(self: SpeedLaw, setpoint: Rates, angles: Sequence[float | None], *, braking: bool) -> Motion:
        vx, vy, wz = setpoint
        return motion_at(self, (vx, vy, wz + 0.1 * (abs(vx) + abs(vy))), angles, braking=braking)

    return turning


# rests within the computed time


def fresh_for_ever(patch: Patch) -> None:
    """The last command goes on driving."""
    patch.setattr(Arbiter, "_fresh", lambda self, command, now_ns: True)


def never_quiet(patch: Patch) -> None:
    """No silence leads to rest."""
    rows = {
        mode: tuple(row for row in rows if row[0] is not supervisor.quiet)
        for mode, rows in supervisor.TRANSITIONS.items()
    }
    patch.setattr(supervisor, "TRANSITIONS", rows)


def brake_at_a_third(patch: Patch) -> None:
    """The way to rest takes three times as long."""
    brake = TwistLimiter.brake
    patch.setattr(TwistLimiter, "brake", lambda self, dt, effort=1.0: brake(self, dt / 3.0, effort=effort))


def never_rested(patch: Patch) -> None:
    """It stands, and stays energised."""
    patch.setattr(Standstill, "rested", lambda self, now_ns: False)


# stands up only as it was asked to


def stand_up_for_anybody(patch: Patch) -> None:
    """Whoever commands a zero is taken to hold it."""
    patch.setattr(Posture, "objection", lambda self: None)


def be_ready_for_ever(patch: Patch) -> None:
    """Whoever asked once is taken to hold it still."""
    patch.setattr(posture, "READY_NS", 10**18)


def get_up_from_a_fall(patch: Patch) -> None:
    """What has fallen goes on as soon as it is known again how it leans. Two rules each prevent that: it is let go,
    and it is down.
    """
    patch.setattr(Engine, "_let_go", lambda self: None)
    look = Posture.look

    def look_again(self: Posture, attitude: Attitude | None, now_ns: int) -> None:
        look(self, attitude, now_ns)
        if self.fallen is not None:
            self.stance = Stance.UP

    patch.setattr(Posture, "look", look_again)


class Removed(NamedTuple):
    """A rule taken out, and the drive in which the law notices."""

    law: str
    remove: Callable[[Patch], None]
    robot: str
    seconds: float
    at: list[Entry]
    can_brake: bool = False
    edit: Callable[[str], str] = str  # of the robot file


def with_manoeuvre(text: str) -> str:
    return text.replace("[robot.body]", '[robot.manoeuvre]\nform = "arc"\nmax_footprint = 0.6\n\n[robot.body]', 1)


BACK_AND_FORTH = [say(0.0), say(0.6, 1.5), say(1.6, 1.0, 1.4), hush(1.8)]
SILENCE = [say(0.0), say(0.6, 0.8), hush(1.6)]
TOP_SPEED = [say(0.0), say(0.6, 2.0), hush(2.0)]
A_MOTOR_OFF = [
    say(0.0),
    say(0.6, 0.8),
    fault(1.4, "power_off", motor="front_left", seconds=0.5),
    hush(2.1),
]
TOO_HEAVY = [fault(0.0, "mass", value=5000.0), say(0.0), say(0.6, 0.3, 1.2, 2.0)]
BOTH_SOURCES = [say(0.0), say(0.6, 0.8), say(0.6, 0.5, by="autonomy"), hush(1.6)]
STOPPED_BETWEEN = [
    say(0.0),
    say(0.0, by="autonomy", stamped=True),
    hush(0.7, "autonomy"),
    ask(0.8, "estop"),
    ask(1.3, "reset"),
    say(1.6, 0.5, by="autonomy", stamped=True),
    hush(1.7),
]
UNSTAMPED_DROPOUT = [say(0.0), say(0.6, 0.8), hush(1.6), say(2.2, 0.8)]
A_STRANGER = [say(0.0), say(0.6, 0.4), say(1.2, 0.8, sender="stranger")]
JOINT_JUMPS = [say(0.0), say(0.6, 0.5, 0.5), fault(2.0, "encoder_jump", motor="platform", value=1.0)]
SWINGING = [
    say(0.0),
    say(0.6, -0.8, 0.1, -0.5),
    fault(1.92, "bus_down", seconds=0.08),
]
HIT_WHILE_BRAKING = [say(0.0), say(0.6, 1.5), hush(2.4), fault(2.9, "push", value=-3000.0, seconds=0.02)]
RESET_AT_ONCE = [
    say(0.0),
    say(0.6, 0.8),
    hush(1.6),
    ask(2.0, "estop"),
    *(ask(2.1 + 0.05 * n, "reset") for n in range(10)),
]

TURNED_ROUND = [say(0.0), say(0.6, -0.5, region="push")]
TAKEN_BACK = [say(0.0), say(0.6, -0.5, region="push"), say(1.5, -0.5)]

NOT_ASKED = [say(0.0), say(0.8, 0.3)]
ASKED_LONG_AGO = [ask(0.5, "stand_up"), say(11.0), say(11.8, 0.3)]
HIT_HARD = [
    ask(0.5, "stand_up"),
    say(0.0),
    say(1.0, 0.3),
    fault(1.6, "push", value=300.0, seconds=0.5),
]

ROWS = (
    Removed(GROWS, brake_along_the_line, "omni4", 2.6, BACK_AND_FORTH),
    Removed(LET_GO, lose_nothing, "omni4", 2.8, A_MOTOR_OFF),
    Removed(LET_GO, command_everyone, "omni4", 2.8, A_MOTOR_OFF),
    Removed(LET_GO, lose_no_released_one, "omni4", 2.0, TOO_HEAVY),
    Removed(ZERO, admit_without_zero, "omni4", 2.4, BOTH_SOURCES),
    Removed(ZERO, dismiss_nobody, "omni4", 2.6, STOPPED_BETWEEN),
    Removed(ZERO, start_over_never, "omni4", 2.6, UNSTAMPED_DROPOUT),
    Removed(ZERO, any_sender, "omni4", 1.6, A_STRANGER),
    Removed(STEPS, believe_every_angle, "moby", 2.3, JOINT_JUMPS),
    Removed(STEPS, stop_at_once, "moby", 2.1, SILENCE),
    Removed(STEPS, release_the_proportion, "moby", 2.3, JOINT_JUMPS),
    Removed(STEPS, see_again_at_once, "moby", 2.2, SWINGING),
    Removed(STEPS, fall_back_in_one_step, "omni4", 3.7, HIT_WHILE_BRAKING),
    Removed(IDLE, keep_energised_in_idle, "omni4", 2.6, RESET_AT_ONCE),
    Removed(UP, stand_up_for_anybody, "odd_balancing", 1.5, NOT_ASKED),
    Removed(UP, be_ready_for_ever, "odd_balancing", 12.5, ASKED_LONG_AGO),
    Removed(UP, get_up_from_a_fall, "odd_balancing", 3.0, HIT_HARD),
    Removed(ROUND, go_on_whoever_asks, "moby", 2.5, TAKEN_BACK, edit=with_manoeuvre),
    Removed(ROUND, begin_at_once, "moby", 2.5, TURNED_ROUND, edit=with_manoeuvre),
    Removed(ROUND, turn_the_platform_too, "moby", 2.5, TURNED_ROUND, edit=with_manoeuvre),
    Removed(REST, fresh_for_ever, "omni4", 5.4, SILENCE, can_brake=True),
    Removed(REST, never_quiet, "omni4", 5.4, SILENCE, can_brake=True),
    Removed(REST, brake_at_a_third, "omni4", 5.6, TOP_SPEED, can_brake=True),
    Removed(REST, never_rested, "omni4", 5.4, SILENCE, can_brake=True),
)


def driven(row: Removed) -> Driven:
    script = Scenario.model_validate({"robot": row.robot, "seconds": row.seconds, "at": row.at})
    return judge(script, parse(row.edit(robot_text(row.robot)), row.robot), can_brake=row.can_brake)


@pytest.mark.parametrize("row", {id(row.at): row for row in ROWS}.values(), ids=lambda row: row.remove.__name__)
def test_with_every_rule_all_laws_hold_in_these_drives(row: Removed) -> None:
    assert {law: broken for law, broken in driven(row).violations.items() if broken} == {}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.remove.__name__)
def test_a_law_notices_when_its_rule_is_gone(row: Removed, monkeypatch: Patch) -> None:
    row.remove(monkeypatch)
    assert driven(row).violations[row.law] != []


def test_every_law_is_shown_to_fail() -> None:
    assert {row.law for row in ROWS} == set(ALL_LAWS)

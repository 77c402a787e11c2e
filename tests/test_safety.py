"""What must hold in every cycle of every drive, whatever commanders, motors and buses do."""

from hypothesis import given

from gateway.control.limits import excess
from gateway.types import ZERO_TWIST, Inputs, Mode, Outputs, RequestKind
from tests.scripts import Script, both, few, play, scripts
from tests.world import World

MOVING = {Mode.DRIVE, Mode.DEGRADED}


def released(outputs: Outputs) -> bool:
    return all(setpoint is None for setpoint in outputs.trace.wheel_setpoints)


def at_zero(outputs: Outputs) -> bool:
    return all(not setpoint for setpoint in outputs.trace.wheel_setpoints)


def invites_motion(inputs: Inputs) -> bool:
    """A fresh zero command, or an explicit reset."""
    zero = any(command.twist == ZERO_TWIST for command in inputs.commands)
    return zero or any(request.kind is RequestKind.RESET for request in inputs.requests)


@both
@few
@given(script=scripts)
def test_laws_of_every_cycle(name: str, script: Script) -> None:
    world = play(name, script)
    invited = False
    before = Mode.IDLE
    for inputs, outputs in world.records:
        if outputs.mode is Mode.IDLE:
            assert released(outputs), "motors are released in idle"
            invited = before is Mode.IDLE and (invited or invites_motion(inputs))
        if outputs.mode in {Mode.STARTING, Mode.ESTOP}:
            assert at_zero(outputs), "held or released, never driven"
        if outputs.mode is Mode.STARTING and before is not Mode.STARTING:
            assert before is Mode.IDLE
            assert invited or invites_motion(inputs), "nothing starts by itself"
        if outputs.mode in MOVING:
            assert before in MOVING | {Mode.STARTING, Mode.STOPPING}
        if any(request.kind is RequestKind.ESTOP for request in inputs.requests):
            assert outputs.mode is Mode.ESTOP, "a stop is obeyed in its cycle"
        before = outputs.mode
    limits_hold(world)


def limits_hold(world: World) -> None:
    velocity = world.config.limits.velocity.as_twist()
    top = [world.config.limits.motor_speed[motor] for motor in world.config.robot.motor_names()]
    for _, outputs in world.records:
        assert excess(outputs.trace.setpoint, velocity) <= 1 + 1e-9
        for setpoint, limit in zip(outputs.trace.wheel_setpoints, top, strict=True):
            assert setpoint is None or abs(setpoint) <= limit * (1 + 1e-9)


@both
@few
@given(script=scripts)
def test_silence_always_ends_at_rest(name: str, script: Script) -> None:
    """Six seconds after the last word, whatever happened before: every motor let go, and the robot stands."""
    world = play(name, script)
    world.run(6.0)
    assert world.last.mode in {Mode.IDLE, Mode.ESTOP, Mode.FAULT}
    assert released(world.last)
    guarded = all(motor.watchdog is not None for motor in world.config.motor)
    heard = [action[0] for action in script if action[0] in {"fail", "restore"}][-1:] != ["fail"]
    powered = all(device.acknowledges for device in world.bus.robot.devices.values())
    if powered and (heard or guarded):  # a controller without a watchdog holds its last current when it hears nothing
        assert max(map(abs, world.bus.robot.truth.twist)) < 0.05

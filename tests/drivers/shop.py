"""One motor with a flywheel, its simulated controller and its driver, for what only the shaft can tell."""

from drivers.contract import CanFrame, Driver, MotorSpec, MotorState
from drivers.setpoint import CommandKind, MotorCommand
from replay.sim.controllers.contract import STEP_NS, MotorSetup, Shaft, SimulatedDevice
from replay.sim.robot import CONTROLLERS
from tests.drivers.reply_only import SimulatedReplier
from tests.drivers.rig import BUS, DRIVER_TYPES, MS, spec

ON_THE_GROUND, LIFTED = 1.1e-4, 1.1e-5  # kg m^2 at the rotor: a quarter of omni4, and its wheel alone
FRICTION = 0.002  # N m at the rotor; omni4's joint drag behind its gear is 0.005
# Of those who drive without a gear: the same flywheel behind one, so that all numbers here are those of one rotor.
GEARED = {"gm6020 current": 20.0, "gm6020 voltage": 20.0}
# Nm, rad/s or V at which a motor gets going, at its own shaft.
GOING = {CommandKind.VELOCITY: 400.0, CommandKind.TORQUE: 0.02, CommandKind.VOLTAGE: 12.0}


class Shop:
    """One motor with a flywheel, its simulated controller and its driver; commands and shaft are behind its gear."""

    def __init__(self, driver: str, variant: str, *, inertia: float, speed: float, period_ms: int = 4) -> None:
        motor: MotorSpec = spec(variant, id=1)
        rate = None if motor.feedback_rate is None else 500.0
        self.gear = gear = GEARED.get(variant, 1.0)
        motor = motor._replace(max_speed=900.0, max_torque=0.23, max_current=20.0, feedback_rate=rate)
        if gear != 1.0:
            motor = motor._replace(max_speed=33.0, max_torque=0.23 * gear)
        motor = motor._replace(command_rate=1e3 / period_ms)
        setup = MotorSetup(
            *(
                motor.name,
                BUS,
                1,
                motor.variant,
                motor.max_speed,
                motor.max_torque,
                20.0,
                inertia * gear**2,
                rate,
                None,
            ),
            options=motor.options,
            supply=motor.supply,
        )
        self.device: SimulatedDevice = (CONTROLLERS | {"reply_only": SimulatedReplier})[driver](setup)
        self.driver: Driver = DRIVER_TYPES[driver](BUS, [motor])
        self.period_ms = period_ms
        self.inertia = inertia
        self.now_ns = 1_000 * MS
        self.shaft = Shaft(0.0, speed)
        self.torque = 0.0
        self.most = 0.0  # N m either way, of all steps so far
        self.work = 0.0  # J that the motor gave to the shaft, braking not subtracted
        self.device.start(self.shaft, self.now_ns)

    def run(self, ms: int) -> None:
        """Let the world go on and the driver hear."""
        for _ in range(ms):
            position, speed = self.shaft
            speed += self.torque / self.inertia * 1e-3
            drag = FRICTION / self.inertia * 1e-3
            speed = 0.0 if abs(speed) <= drag else speed - drag if speed > 0.0 else speed + drag
            self.shaft = Shaft(position + speed * 1e-3, speed)
            self.work += max(0.0, self.torque * speed) * 1e-3
            self.now_ns += STEP_NS
            turned = Shaft(self.shaft.position / self.gear, self.shaft.velocity / self.gear)
            self.torque = self.device.step(turned, self.now_ns) / self.gear
            self.most = max(self.most, abs(self.torque))
            for emission in self.device.poll(self.now_ns):
                self.driver.receive(emission.frame._replace(received_ns=emission.ready_ns))

    def say(self, frames: list[CanFrame]) -> None:
        for frame in frames:
            for emission in self.device.receive(frame, self.now_ns):
                self.driver.receive(emission.frame._replace(received_ns=emission.ready_ns))

    def stop(self, *, ms: int) -> None:
        for _ in range(0, ms, self.period_ms):
            self.say(self.driver.stop_frames(now_ns=self.now_ns))
            self.run(self.period_ms)

    def drive(self, command: MotorCommand, *, ms: int) -> None:
        """Driven as by the core."""
        if command.kind is CommandKind.TORQUE:
            command = MotorCommand(command.kind, command.value * self.gear)
        for _ in range(0, ms, self.period_ms):
            self.say(self.driver.command([command], now_ns=self.now_ns))
            self.run(self.period_ms)

    def arm(self, kind: CommandKind, value: float) -> None:
        """Brought up and driven for two seconds."""
        self.drive(MotorCommand(kind, value), ms=2_000)
        assert self.driver.feedback(now_ns=self.now_ns)[0].state is MotorState.OPERATIONAL


def kind_of(driver: Driver) -> CommandKind:
    """How it is driven: the best that it can do by itself."""
    able = driver.capabilities[0]
    kinds = {CommandKind.VELOCITY: able.velocity, CommandKind.TORQUE: able.torque, CommandKind.VOLTAGE: able.voltage}
    return next(kind for kind, given in kinds.items() if given)

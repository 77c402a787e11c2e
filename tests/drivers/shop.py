"""One motor with a flywheel, its simulated controller and its driver, for what only the shaft can tell."""

from drivers.contract import CanFrame, Driver, MotorSpec, MotorState
from drivers.setpoint import CommandKind, MotorCommand
from replay.sim.controllers.contract import STEP_NS, MotorSetup, Shaft, SimulatedDevice
from replay.sim.robot import CONTROLLERS
from tests.drivers.reply_only import SimulatedReplier
from tests.drivers.rig import BUS, DRIVER_TYPES, MS, spec

ON_THE_GROUND, LIFTED = 1.1e-4, 1.1e-5  # kg m^2 at the rotor: a quarter of omni4, and its wheel alone
FRICTION = 0.002  # N m at the rotor; omni4's joint drag behind its gear is 0.005


class Shop:
    """One motor with a flywheel, its simulated controller and its driver."""

    def __init__(self, driver: str, variant: str, *, inertia: float, speed: float, period_ms: int = 4) -> None:
        motor: MotorSpec = spec(variant, id=1)
        rate = None if motor.feedback_rate is None else 500.0
        motor = motor._replace(
            max_speed=900.0, max_torque=0.23, max_current=20.0, feedback_rate=rate, command_rate=1e3 / period_ms
        )
        setup = MotorSetup(
            *(motor.name, BUS, 1, variant, 900.0, 0.23, 20.0, inertia, rate, None), options=motor.options
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
            self.torque = self.device.step(self.shaft, self.now_ns)
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
        for _ in range(0, ms, self.period_ms):
            self.say(self.driver.command([command], now_ns=self.now_ns))
            self.run(self.period_ms)

    def arm(self, kind: CommandKind, value: float) -> None:
        """Brought up and driven for two seconds."""
        self.drive(MotorCommand(kind, value), ms=2_000)
        assert self.driver.feedback(now_ns=self.now_ns)[0].state is MotorState.OPERATIONAL


def kind_of(driver: Driver) -> CommandKind:
    return CommandKind.VELOCITY if driver.capabilities[0].velocity else CommandKind.TORQUE

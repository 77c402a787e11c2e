"""The simulated robot: motor controllers on a moving plant, advanced in fixed substeps. It knows no bus."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

from gateway.config import ConfigError, Motor, RobotConfig, Sensor
from gateway.types import Attitude, Pose, Twist
from replay.sim.controllers.contract import STEP_NS, BusDevice, MotorSetup, Shaft, SimulatedDevice
from replay.sim.controllers.dji import SimulatedDji
from replay.sim.controllers.odrive import SimulatedODrive
from replay.sim.controllers.vesc import SimulatedVesc
from replay.sim.plants import plant_of
from replay.sim.plants.contract import Plant, PlantName, Point, WithAttitude, WithCaster, WithSlides
from replay.sim.sensors import sender
from replay.sim.sensors.contract import Scene, SensorSetup
from replay.sim.sensors.sender import Sender

CONTROLLERS: dict[str, Callable[[MotorSetup], SimulatedDevice]] = {
    "odrive": SimulatedODrive,
    "dji": SimulatedDji,
    "vesc": SimulatedVesc,
}
SENSORS: dict[str, Callable[[SensorSetup], Sender]] = {"draw_wire": sender.draw_wire, "imu": sender.imu}


class Truth(NamedTuple):
    """What no sensor tells: the real motion."""

    time_ns: int
    pose: Pose
    twist: Twist
    joint_angles: tuple[float, ...]  # rad at the output as the robot file counts them, in config order
    joint_rates: tuple[float, ...]  # rad/s
    joint_torques: tuple[float, ...]  # N m that really act at the outputs
    chassis_angle: float  # rad in the world; differs from the heading where the platform turns on the chassis


class _Joint(NamedTuple):
    """Where a motor shaft meets its output: shaft angle = output angle * scale."""

    device: SimulatedDevice
    scale: float  # gear ratio with the sign of the mounting direction
    zero: float  # output angle where the chassis counts the joint as zero


@dataclass(slots=True)
class Drivetrain:
    """What becomes of a controller's torque on its way to the output; the controller does not see it."""

    gain: float = 1.0  # 0: none arrives (a sheared key), -1: it acts the wrong way round (swapped phases)
    braking: float = 1.0  # of torque against the motion

    def torque(self, torque: float, rate: float) -> float:
        """N m that act."""
        arriving = torque * self.gain
        return arriving * self.braking if arriving * rate < 0.0 else arriving


class SimulatedRobot:
    """Devices by motor name, sensors on a bus by theirs, what others would tell (`signals`), and the plant.

    `start` sets the time origin of the substeps.

    `joint_angles`: where motors stand before the start, rad at the output from the joint's zero. `plant`: instead of
    the one of this chassis kind. `commissioned`: kg m^2 felt at each joint of the robot that the controllers were tuned
    on, where that is another one than the plant.
    """

    def __init__(
        self,
        config: RobotConfig,
        joint_angles: Mapping[str, float] | None = None,
        *,
        plant: Plant | None = None,
        commissioned: Sequence[float] | None = None,
    ) -> None:
        self._plant = plant_of(config.robot) if plant is None else plant
        inertias = self._plant.reflected_inertia if commissioned is None else commissioned
        rates = {bus.name: bus.bitrate for bus in config.bus}
        self._joints = tuple(
            _Joint(_device(motor, inertia, rates[motor.bus]), motor.gear_ratio * motor.direction, motor.zero)
            for motor, inertia in zip(config.motors_in_order(), inertias, strict=True)
        )
        self.devices = {joint.device.setup.name: joint.device for joint in self._joints}
        self.sensors = _sensors(config.sensor)
        self._kinds = {sensor.name: sensor.kind.value for sensor in config.sensor}
        self._sensor_shifts: dict[str, float] = {}  # m or rad that they tell too much
        self.signals = {
            sensor.name: sender.signal(sensor.kind.value, seed=place)
            for place, sensor in enumerate(config.sensor)
            if sensor.bus is None
        }
        self._sensing = tuple({id(one): one for one in self.sensors.values()}.values())  # some have several names
        self._places = {name: place for place, name in enumerate(self.devices)}
        self._drivers = tuple(motor.driver for motor in config.motors_in_order())
        self._shifts: dict[str, float] = {}  # rad at the output that an encoder tells too much
        self._twins: dict[str, tuple[SimulatedDevice, Shaft]] = {}
        self._drivetrains: dict[int, Drivetrain] = {}  # only of those joints where something is wrong
        self._torques = [0.0] * len(self._joints)
        given = joint_angles or {}
        self._plant.place([given.get(name, 0.0) for name in self.devices])
        self._time_ns: int | None = None

    @property
    def next_step_ns(self) -> int:
        """The instant up to which the devices see no new shaft state."""
        return self._time() + STEP_NS

    @property
    def truth(self) -> Truth:
        plant = self._plant
        return Truth(
            time_ns=self._time(),
            pose=plant.pose,
            twist=plant.twist,
            joint_angles=tuple(a + joint.zero for a, joint in zip(plant.angles, self._joints, strict=True)),
            joint_rates=plant.rates,
            joint_torques=tuple(self._torques),
            chassis_angle=plant.chassis_angle,
        )

    @property
    def scene(self) -> Scene:
        """What there is to sense now; a plant that knows of no leaning does not lean."""
        plant = self._plant
        level = Attitude(0.0, 0.0, 0.0, 0.0, plant.twist.wz)
        attitude = plant.attitude if isinstance(plant, WithAttitude) else level
        return Scene(plant.width if isinstance(plant, WithSlides) else None, attitude, plant.pose.theta)

    def on_bus(self, bus: str | None = None) -> list[BusDevice]:
        """Everything that is connected to it; None: to any."""
        every: list[BusDevice] = [*self.devices.values(), *self._sensing]
        return [device for device in every if bus in (None, device.setup.bus)]

    def start(self, now_ns: int) -> None:
        """Power on everything at this instant."""
        self._time_ns = now_ns
        for joint, shaft in zip(self._joints, self._shafts(), strict=True):
            joint.device.start(shaft, now_ns)
        for sensor in self._sensing:
            sensor.start(self.scene, now_ns)
        self._sense(now_ns)

    def advance(self, now_ns: int) -> None:
        """Run every whole substep up to now."""
        time_ns = self._time() + STEP_NS
        while time_ns <= now_ns:
            self._time_ns = time_ns
            self._plant.step(self._torques)
            self._torques = [
                joint.device.step(shaft, time_ns) * joint.scale
                for joint, shaft in zip(self._joints, self._shafts(), strict=True)
            ]
            for place, drivetrain in self._drivetrains.items():
                self._torques[place] = drivetrain.torque(self._torques[place], self._plant.rates[place])
            for twin, shaft in self._twins.values():
                twin.step(shaft, time_ns)
            if self._sensing or self.signals:
                self._sense(time_ns)
            time_ns += STEP_NS

    def _sense(self, time_ns: int) -> None:
        scene = self.scene
        for sensor in self._sensing:
            sensor.step(scene, time_ns)
        for name, signal in self.signals.items():
            signal.look(scene.of(self._kinds[name]), time_ns)

    def drivetrain(self, motor: str) -> Drivetrain:
        """To weaken what this motor does."""
        return self._drivetrains.setdefault(self._places[motor], Drivetrain())

    def shift_encoder(self, motor: str, angle: float) -> None:
        """The encoder of this motor tells so many radians more than before, at the output."""
        self._shifts[motor] = self._shifts.get(motor, 0.0) + angle
        self.devices[motor].shift_encoder(angle * self._joints[self._places[motor]].scale)

    def set_push(self, force: float) -> None:
        """So many N along world x, at the centre of mass."""
        self._plant.push = force

    def set_impact(self, force: float) -> None:
        """So many N across the chassis, to its left, at the joint of its caster. Raises ValueError without one."""
        self._with_caster().set_force(Point.CASTER_JOINT, 0.0, force)

    def set_swivel(self, angle: float) -> None:
        """Where the caster's fork stands before the start, rad. Raises ValueError without one."""
        self._with_caster().swivel = angle

    def set_slope(self, angle: float) -> None:
        """The ground rises along world x, rad."""
        self._plant.slope = angle

    def set_mass(self, mass: float | None) -> None:
        """So many kg in all, the change over the centre; None: as in the robot file."""
        self._plant.set_mass(mass)

    @property
    def has_caster(self) -> bool:
        """Whether impact and swivel can be set."""
        return isinstance(self._plant, WithCaster)

    def set_friction(self, motor: str, friction: float) -> None:
        """Coefficient of friction under the wheel of this motor; infinite: it does not slip."""
        self._plant.set_friction(self._places[motor], friction)

    def set_floor(self, friction: float) -> None:
        """The same under all wheels that can slip."""
        for place in self._places.values():
            if self._plant.can_slip(place):
                self._plant.set_friction(place, friction)

    def add_twin(self, motor: str, angle: float) -> SimulatedDevice:
        """A second controller that was given the same id; its shaft stands still, so many rad away at the output."""
        place = self._places[motor]
        shaft = Shaft(self._shafts()[place].position + angle * self._joints[place].scale, 0.0)
        # It has been on for long: its reading is not that of a moment ago, whatever its encoder.
        twin = CONTROLLERS[self._drivers[place]](self.devices[motor].setup._replace(absolute=True))
        twin.start(shaft, self._time())
        self._twins[motor] = (twin, shaft)
        return twin

    def remove_twin(self, motor: str) -> SimulatedDevice | None:
        """The second controller, which is no longer there; None if there was none."""
        twin = self._twins.pop(motor, None)
        return None if twin is None else twin[0]

    def mend(self, motor: str) -> None:
        """Encoder, drivetrain and ground of this motor are sound again."""
        self.devices[motor].freeze_encoder(False)
        self.shift_encoder(motor, -self._shifts.pop(motor, 0.0))
        place = self._places[motor]
        self._drivetrains.pop(place, None)
        if self._plant.can_slip(place):
            self._plant.set_friction(place, inf)

    def shift_sensor(self, sensor: str, amount: float) -> None:
        """The sensor of this name tells so much more than before, m or rad."""
        kind = self._kinds[sensor]
        self._sensor_shifts[sensor] = self._sensor_shifts.get(sensor, 0.0) + amount
        self.sensors[sensor].shift(kind, amount)

    def mend_sensors(self) -> None:
        """Every sensor on a bus is sound again."""
        for name, sensor in self.sensors.items():
            sensor.plug()
            sensor.hang(False)
            sensor.stick(False)
            self.shift_sensor(name, -self._sensor_shifts.get(name, 0.0))

    def _with_caster(self) -> WithCaster:
        if isinstance(self._plant, WithCaster):
            return self._plant
        raise ValueError("this plant has no caster")

    def _time(self) -> int:
        if self._time_ns is None:
            raise RuntimeError("the simulated robot has not been started")
        return self._time_ns

    def _shafts(self) -> list[Shaft]:
        plant = self._plant
        return [
            Shaft((angle + joint.zero) * joint.scale, rate * joint.scale)
            for joint, angle, rate in zip(self._joints, plant.angles, plant.rates, strict=True)
        ]


def chosen_plant(config: RobotConfig, name: PlantName, origin: str) -> Plant:
    """The plant of this name for this robot. Raises ConfigError, told of `origin`, where there is none."""
    try:
        return plant_of(config.robot, name)
    except ValueError as error:
        raise ConfigError(origin, [str(error)]) from None


def _sensors(sensors: Sequence[Sensor]) -> dict[str, Sender]:
    """Those on a bus by name; one that tells several kinds is one."""
    made: dict[tuple[str, str, int], Sender] = {}
    found = {}
    for sensor in sensors:
        if sensor.bus is not None and sensor.driver is not None and sensor.id is not None:
            key = (sensor.driver, sensor.bus, sensor.id)
            if key not in made:
                setup = SensorSetup(sensor.name, sensor.bus, sensor.id, sensor.rate or 0.0)
                made[key] = SENSORS[sensor.driver](setup)
            found[sensor.name] = made[key]
    return found


def _device(motor: Motor, inertia: float, bitrate: int) -> SimulatedDevice:
    """The controller as commissioned on this robot; limits and inertia moved from the output to the shaft."""
    make = CONTROLLERS.get(motor.driver)
    if make is None:
        raise ValueError(
            f"motor {motor.name}: driver {motor.driver!r} has no simulated controller: {list(CONTROLLERS)}"
        )
    return make(
        MotorSetup(
            name=motor.name,
            bus=motor.bus,
            id=motor.id,
            variant=motor.variant,
            max_speed=motor.max_speed * motor.gear_ratio,
            max_torque=motor.max_torque / motor.gear_ratio,
            max_current=motor.max_current,
            inertia=inertia / motor.gear_ratio**2,
            feedback_rate=motor.feedback_rate,
            watchdog_s=None if motor.watchdog is None else motor.watchdog.timeout,
            absolute=motor.encoder == "absolute",
            options=motor.options,
            supply=None if motor.winding is None else motor.winding.voltage,
            bitrate=bitrate,
        )
    )

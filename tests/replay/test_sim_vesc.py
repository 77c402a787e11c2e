"""The simulated VESC against the firmware's tables: bytes, the electrical motor, timeout, faults, speed loop."""

from math import pi
from struct import pack, unpack

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.contract import CanFrame
from replay.sim.controllers.contract import STEP_NS, MotorSetup, Shaft
from replay.sim.controllers.vesc import SimulatedVesc

MS = 1_000_000
SETUP = MotorSetup(
    name="motor",
    bus="can0",
    id=10,
    variant="vesc",
    max_speed=600.0,
    max_torque=0.375,
    max_current=20.0,
    inertia=3e-4,
    feedback_rate=250.0,
    watchdog_s=0.1,
    options={"pole_pairs": 7, "min_erpm": 900},
)
TORQUE_CONSTANT = 0.01875  # N m/A and V s/rad
RESISTANCE = 0.05
DUTY, CURRENT, BRAKE, RPM = 0, 1, 2, 3
STILL = Shaft(0.0, 0.0)


class Motor:
    """The device with a shaft that turns as it is told, or by its torque."""

    def __init__(self, setup: MotorSetup = SETUP, shaft: Shaft = STILL) -> None:
        self.device = SimulatedVesc(setup)
        self.shaft = shaft
        self.now_ns = 0
        self.torque = 0.0
        self.device.start(shaft, 0)

    def say(self, command: int, value: int, *, at: int = 10) -> None:
        frame = CanFrame("can0", command << 8 | at, pack(">i", value), extended=True)
        assert self.device.receive(frame, self.now_ns) == ()

    def ask(self, mask: int, *, host: int = 1) -> list[str]:
        """The answer, as id and data."""
        question = CanFrame("can0", 0x80A, pack(">BBBI", host, 0, 50, mask), extended=True)
        return [text(one.frame) for one in self.device.receive(question, self.now_ns)]

    def step(self, ms: int = 1, *, shaft: Shaft | None = None, inertia: float | None = None) -> float:
        for _ in range(ms):
            if shaft is not None:
                self.shaft = shaft
            elif inertia is not None:
                speed = self.shaft.velocity + self.torque / inertia * 1e-3
                self.shaft = Shaft(self.shaft.position + speed * 1e-3, speed)
            self.now_ns += STEP_NS
            self.torque = self.device.step(self.shaft, self.now_ns)
        return self.torque

    def amperes(self, velocity: float = 0.0) -> float:
        return self.step(shaft=Shaft(0.0, velocity)) / TORQUE_CONSTANT

    def status(self) -> dict[int, CanFrame]:
        """The latest of each command, of all the time until now."""
        return {one.frame.id >> 8: one.frame for one in self.device.poll(self.now_ns)}


def text(frame: CanFrame) -> str:
    assert frame.extended
    return f"{frame.id:08X}#{frame.data.hex().upper()}"


# -- the golden frames ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("frame", "velocity", "current"),
    [
        ("0000000A#FFFFD8F0", -120.0, -3.0),  # 24 V backwards by a tenth against -2.25 V, over 0.05 ohm
        ("0000010A#00001F40", 0.0, 8.0),
        ("0000010A#00000000", 100.0, 0.0),
        ("0000020A#00001F40", 100.0, -8.0),
        ("0000020A#00001F40", -100.0, 8.0),
        ("00000A0A#0000C350", 0.0, 10.0),  # half of 20 A
        ("0000030A#FFFFF254", 0.0, -20.0),
        ("000001FF#00001F40", 0.0, 8.0),  # to all
    ],
)
def test_commands(frame: str, velocity: float, current: float) -> None:
    motor = Motor()
    identifier, data = frame.split("#")
    motor.device.receive(CanFrame("can0", int(identifier, 16), bytes.fromhex(data), extended=True), 0)
    assert motor.amperes(velocity) == pytest.approx(current)


def test_the_example_of_51_amperes() -> None:
    motor = Motor(SETUP._replace(id=23, max_current=60.0, max_torque=60.0 * TORQUE_CONSTANT))
    motor.device.receive(CanFrame("can0", 0x117, bytes.fromhex("0000C738"), extended=True), 0)
    assert motor.amperes() == pytest.approx(51.0)


def test_status_of_the_example() -> None:
    """-3500 ERPM and -12.3 A; the duty is what that takes: -0.9817 V of back-EMF and -0.615 V of 24 V."""
    motor = Motor()
    motor.say(CURRENT, -12300)
    motor.step(shaft=Shaft(0.0, -3500.0001 / 7 * 2 * pi / 60))
    motor.now_ns = 8 * MS
    assert text(motor.status()[9]) == "0000090A#FFFFF254FF85FFBE"


def test_status_4_and_5_of_the_examples() -> None:
    motor = Motor(shaft=Shaft(1.0, 0.0))
    motor.device.temperature_c = 41.7
    motor.device.input_voltage = 24.1
    motor.step(shaft=Shaft(1.0 + 123456.5 / 42 * 2 * pi, 0.0))
    motor.now_ns = 1_000 * MS
    told = motor.status()
    assert text(told[27]) == "00001B0A#0001E24000F10000"
    assert text(told[16]) == "0000100A#01A101A100000000"


def test_the_fault_of_the_example() -> None:
    motor = Motor()
    assert motor.ask(1 << 15) == ["00000801#0A01320000800000"]
    motor.device.raise_fault(5)
    assert motor.ask(1 << 15) == ["00000801#0A01320000800005"]
    assert motor.ask(1 << 15, host=0x8A) == ["0000088A#0A01320000800005"]
    assert motor.ask(1 << 7) == []


def test_foreign_frames_are_ignored() -> None:
    motor = Motor()
    data = pack(">i", 8000)
    for frame in (
        CanFrame("can0", 0x10A, data),
        CanFrame("can0", 0x10A, data, extended=True, remote=True),
        CanFrame("can0", 0x10A, data, extended=True, fd=True),
        CanFrame("can0", 0x10B, data, extended=True),
        CanFrame("can0", 0x1010A, data, extended=True),
        CanFrame("can0", 0x10A, data[:3], extended=True),
    ):
        assert motor.device.receive(frame, 0) == ()
        assert motor.step() == 0.0


@given(
    identifier=st.builds(lambda command, at: command << 8 | at, st.integers(0, 70), st.sampled_from([10, 255])),
    data=st.binary(max_size=8),
)
def test_any_bytes_never_raise(identifier: int, data: bytes) -> None:
    motor = Motor()
    motor.device.receive(CanFrame("can0", identifier, data, extended=True), 0)
    assert abs(motor.step()) <= SETUP.max_torque * (1 + 1e-12)


# -- status rates -----------------------------------------------------------------------------------------------------


def test_status_and_status_5_come_together_and_status_4_at_its_own_rate() -> None:
    motor = Motor()
    said = motor.device.poll(2_000 * MS)
    counts = {command: sum(one.frame.id >> 8 == command for one in said) for command in (9, 27, 16)}
    assert counts == pytest.approx({9: 500, 27: 500, 16: 10}, abs=1)
    pairs = [one for one in said if one.frame.id >> 8 != 16]
    assert [one.frame.id for one in pairs[:4]] == [0x90A, 0x1B0A] * 2
    assert pairs[0].ready_ns == pairs[1].ready_ns
    assert [one.ready_ns for one in said] == sorted(one.ready_ns for one in said)


# -- the motor --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("duty", [0.1, 0.3, -0.3])
def test_a_duty_turns_the_motor_until_its_back_emf_takes_the_voltage(duty: float) -> None:
    """Time constant J R / k^2: 43 ms; the current limit is left when (V - k w) is below 1 V."""
    motor = Motor()
    motor.device.timeout_s = 0.0
    motor.say(DUTY, round(duty * 1e5))
    motor.step(2_000, inertia=SETUP.inertia)
    assert motor.shaft.velocity == pytest.approx(duty * 24.0 / TORQUE_CONSTANT, rel=1e-3)
    assert motor.torque == pytest.approx(0.0, abs=1e-4)


def test_a_duty_gives_the_current_of_the_voltage_that_is_left() -> None:
    motor = Motor()
    motor.say(DUTY, 4000)  # 0.96 V
    for velocity in (0.0, 10.0, 51.2, 60.0):
        assert motor.amperes(velocity) == pytest.approx((0.96 - TORQUE_CONSTANT * velocity) / RESISTANCE)


def test_no_duty_is_a_brake_and_no_current_a_release() -> None:
    motor = Motor()
    motor.say(DUTY, 0)
    assert motor.amperes(20.0) == pytest.approx(-TORQUE_CONSTANT * 20.0 / RESISTANCE)
    motor.say(CURRENT, 49)
    assert motor.amperes(20.0) == 0.0
    motor.say(CURRENT, -50)
    assert motor.amperes(20.0) == pytest.approx(-0.05)
    motor.say(BRAKE, 49)
    assert motor.amperes(20.0) == 0.0


def test_a_current_brake_fades_with_the_motion_and_never_drives() -> None:
    motor = Motor()
    motor.say(BRAKE, 8000)
    assert motor.amperes(0.0) == 0.0
    assert motor.amperes(5.0) == pytest.approx(-TORQUE_CONSTANT * 5.0 / RESISTANCE)
    assert motor.amperes(300.0) == pytest.approx(-8.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_values_beyond_the_range_are_clamped(sign: int) -> None:
    motor = Motor()
    for command, value in ((CURRENT, 2**31 - 1), (DUTY, 2**31 - 1), (10, 2**31 - 1)):
        motor.say(command, sign * value)
        assert motor.amperes() == pytest.approx(sign * 20.0)


def test_the_input_voltage_ends_what_a_current_command_gets() -> None:
    """0.95 of 24 V are 22.8 V: at 1200 rad/s 0.3 V are left for the current."""
    motor = Motor()
    motor.say(CURRENT, 20000)
    assert motor.amperes(1200.0) == pytest.approx(0.3 / RESISTANCE)
    assert motor.amperes(-1200.0) == pytest.approx(20.0)
    assert motor.amperes(1250.0) == pytest.approx((22.8 - TORQUE_CONSTANT * 1250.0) / RESISTANCE)


def test_a_hot_bridge_gets_less_current_and_then_a_fault() -> None:
    motor = Motor()
    for heat, current in ((85.0, 20.0), (92.5, 10.0), (99.0, 20.0 / 15), (100.0, 0.0)):
        motor.device.temperature_c = heat
        motor.say(CURRENT, 20000)
        assert motor.amperes() == pytest.approx(current)
    assert motor.ask(1 << 15) == ["00000801#0A01320000800005"]


# -- the speed loop ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("erpm", [3500, -3500, 900])
def test_a_speed_is_reached(erpm: int) -> None:
    motor = Motor()
    motor.device.timeout_s = 0.0
    motor.say(RPM, erpm)
    motor.step(2_000, inertia=SETUP.inertia)
    assert motor.shaft.velocity == pytest.approx(erpm / 7 * 2 * pi / 60, rel=1e-3)


def test_below_its_minimum_a_released_motor_is_not_started_and_a_running_one_braked() -> None:
    motor = Motor()
    motor.say(RPM, 899)
    assert motor.amperes(0.0) == motor.amperes(20.0) == 0.0
    motor.say(RPM, 900)
    assert motor.amperes(0.0) > 0.0
    motor.say(RPM, -899)
    assert motor.amperes(0.0) == 0.0
    assert motor.amperes(20.0) == pytest.approx(-TORQUE_CONSTANT * 20.0 / RESISTANCE)


# -- timeout, faults, supply ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("brake", "current"), [(0.0, 0.0), (5.0, -5.0)])
def test_without_commands_the_motor_is_released_or_braked_and_obeys_the_next_one(brake: float, current: float) -> None:
    motor = Motor()
    motor.device.timeout_brake_current = brake
    motor.say(CURRENT, 8000)
    for _ in range(10):
        motor.ask(1 << 15)  # does not feed it
        motor.step(10, shaft=Shaft(0.0, 100.0))
    assert motor.torque == pytest.approx(8.0 * TORQUE_CONSTANT)
    assert motor.ask(1 << 21) == ["00000801#0A01320020000000"]
    motor.step(12, shaft=Shaft(0.0, 100.0))
    assert motor.torque == pytest.approx(current * TORQUE_CONSTANT)
    assert motor.ask(1 << 21) == ["00000801#0A01320020000001"]
    motor.say(CURRENT, 8000)
    assert motor.amperes(100.0) == pytest.approx(8.0)
    motor.step(10)
    assert motor.ask(1 << 21) == ["00000801#0A01320020000000"]


@pytest.mark.parametrize(("watchdog", "released_ms"), [(None, 1012), (0.1, 112)])
def test_the_timeout_is_the_one_of_the_robot_file_or_the_default(watchdog: float | None, released_ms: int) -> None:
    motor = Motor(SETUP._replace(watchdog_s=watchdog))
    motor.say(CURRENT, 8000)
    motor.step(released_ms - 13)
    assert motor.torque > 0.0
    motor.step(13)
    assert motor.torque == 0.0


def test_a_timeout_of_0_is_none() -> None:
    motor = Motor()
    motor.device.timeout_s = 0.0
    motor.say(CURRENT, 8000)
    motor.step(20_000)
    assert motor.torque > 0.0
    assert motor.ask(1 << 21) == ["00000801#0A01320020000000"]


def test_a_fault_releases_for_half_a_second_and_then_it_obeys_again() -> None:
    motor = Motor()
    motor.say(CURRENT, 8000)
    motor.step()
    motor.device.raise_fault(4)
    assert motor.step() == 0.0
    for _ in range(49):
        motor.say(CURRENT, 8000)
        assert motor.step(10) == 0.0
    assert motor.ask(1 << 15) == ["00000801#0A01320000800004"]
    motor.step(20)
    assert motor.ask(1 << 15) == ["00000801#0A01320000800000"]
    motor.say(CURRENT, 8000)
    assert motor.step() > 0.0


def test_too_little_voltage_is_a_fault_as_long_as_it_lasts() -> None:
    motor = Motor()
    motor.device.input_voltage = 7.9
    motor.step(2_000)
    assert motor.ask(1 << 15) == ["00000801#0A01320000800002"]
    motor.device.input_voltage = 24.0
    motor.step(502)
    assert motor.ask(1 << 15) == ["00000801#0A01320000800000"]


def test_a_kill_switch_releases_and_is_told() -> None:
    motor = Motor()
    motor.say(CURRENT, 8000)
    motor.device.kill_switch = True
    assert motor.step() == 0.0
    assert motor.ask(1 << 21) == ["00000801#0A01320020000002"]


def test_a_cut_cable_leaves_the_timeout_running() -> None:
    motor = Motor()
    motor.say(CURRENT, 8000)
    motor.device.unplug()
    assert not motor.device.acknowledges
    motor.step(90)
    assert motor.torque > 0.0
    assert motor.ask(1 << 15) == []
    assert motor.status() == {}
    motor.step(25)
    assert motor.torque == 0.0
    motor.device.plug()
    motor.step(10)
    assert set(motor.status()) >= {9, 27}


def test_a_power_cycle_forgets_the_command_and_the_position() -> None:
    motor = Motor(shaft=Shaft(5.0, 0.0))
    motor.say(CURRENT, 8000)
    motor.step(4, shaft=Shaft(25.0, 0.0))
    motor.device.power_off()
    assert motor.step() == 0.0
    assert not motor.device.acknowledges
    motor.device.power_on()
    assert motor.step() == 0.0
    motor.now_ns += 10 * MS
    assert unpack(">i", motor.status()[27].data[:4]) == (0,)


def test_a_frozen_encoder_tells_the_same_count_and_no_speed() -> None:
    motor = Motor()
    motor.say(RPM, 3500)
    motor.step(4, shaft=Shaft(10.0, 50.0))
    motor.device.freeze_encoder(True)
    motor.step(4, shaft=Shaft(20.0, 50.0))
    told = motor.status()
    assert unpack(">i", told[9].data[:4]) == (0,)
    assert unpack(">i", told[27].data[:4]) == (66,)  # 10 rad of 42 counts per turn
    assert motor.torque == pytest.approx(SETUP.max_torque), "it believes to stand and pushes"


def test_a_shifted_encoder_counts_from_elsewhere() -> None:
    motor = Motor()
    motor.device.shift_encoder(2.0 * pi / 42 * 10.5)
    motor.step(8)
    assert unpack(">i", motor.status()[27].data[:4]) == (10,)


@pytest.mark.parametrize(("at", "variant"), [(-1, "vesc"), (255, "vesc"), (1, "c620")])
def test_wrong_setup_names_the_motor(at: int, variant: str) -> None:
    with pytest.raises(ValueError, match="motor motor"):
        SimulatedVesc(SETUP._replace(id=at, variant=variant))

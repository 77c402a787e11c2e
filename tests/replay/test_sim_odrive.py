"""The simulated ODrive against the protocol tables, and the bench of the other ODrive tests."""

from math import pi
from struct import pack, unpack

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.contract import CanFrame, OptionValue
from replay.sim.controllers.contract import STEP_NS, STEP_S, MotorSetup, Shaft
from replay.sim.controllers.odrive import SimulatedODrive
from replay.sim.controllers.odrive_parameters import CALIBRATED
from replay.sim.controllers.odrive_tables import AxisState

MILLISECOND = 1_000_000
INERTIA = 4e-4
ENABLE, TIMEOUT = 188, 189
WATCHDOG_S = 0.05
OPTIONS: dict[str, OptionValue] = {
    "firmware": "0.6.10",
    "watchdog_enable_endpoint": ENABLE,
    "watchdog_timeout_endpoint": TIMEOUT,
}
SETUP = MotorSetup(
    name="motor",
    bus="can0",
    id=3,
    variant="0.6",
    max_speed=200.0,
    max_torque=1.5,
    max_current=40.0,
    inertia=INERTIA,
    feedback_rate=250.0,
    watchdog_s=WATCHDOG_S,
    options=OPTIONS,
)


class Bench:
    """One ODrive with a free flywheel on its shaft, stepped by hand."""

    def __init__(self, variant: str = "0.6", *, watchdog_s: float | None = None, turns: float = 0.0) -> None:
        setup = SETUP._replace(variant=variant, watchdog_s=watchdog_s, absolute=turns != 0.0)
        self.device = SimulatedODrive(setup)
        self.shaft = Shaft(turns * 2.0 * pi, 0.0)
        self.torque = 0.0
        self.now_ns = 7_000_000_000
        self.frames: list[CanFrame] = []
        self.device.start(self.shaft, self.now_ns)

    def send(self, command: int, data: bytes = b"", *, remote: bool = False) -> list[CanFrame]:
        frame = CanFrame("can0", 3 << 5 | command, data, remote=remote)
        return [reply.frame for reply in self.device.receive(frame, self.now_ns)]

    def send_text(self, text: str) -> None:
        identifier, payload = text.split("#")
        self.device.receive(CanFrame("can0", int(identifier, 16), bytes.fromhex(payload)), self.now_ns)

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            velocity = self.shaft.velocity + self.torque / INERTIA * STEP_S
            self.shaft = Shaft(self.shaft.position + velocity * STEP_S, velocity)
            self.now_ns += STEP_NS
            self.frames += [emission.frame for emission in self.device.poll(self.now_ns)]
            self.torque = self.device.step(self.shaft, self.now_ns)

    def arm(self, control: int = 2, mode: int = 1) -> None:
        self.send(0x18)
        self.send(0x0B, pack("<II", control, mode))
        self.send(0x0F, pack("<ff", 30.0, 40.0))
        self.send(0x0D, pack("<ff", 0.0, 0.0))
        self.send(0x07, pack("<I", 8))
        self.run(1)

    def enable_watchdog(self) -> None:
        self.send(0x04, pack("<BHBf", 1, TIMEOUT, 0, 0.05))
        self.send(0x04, pack("<BHB?", 1, ENABLE, 0, True))

    def last(self, command: int) -> str:
        data = [frame.data for frame in self.frames if frame.id == 3 << 5 | command][-1]
        return data.hex().upper()

    def state(self) -> AxisState:
        return self.device.axis.state

    @property
    def speed(self) -> float:
        return self.shaft.velocity / (2.0 * pi)


# -- golden bytes -----------------------------------------------------------------------------------------------------


def test_golden_host_frames_are_understood() -> None:
    bench = Bench()
    control = bench.device.axis.control
    bench.send_text("06B#0200000002000000")
    assert (control.control_mode, control.input_mode) == (2, 2)
    bench.send_text("06D#00002040CDCCCC3D")
    assert control.input_velocity == 2.5
    assert control.input_torque == pytest.approx(0.1)
    bench.send_text("06E#3333B3BE00000000")
    assert control.input_torque == pytest.approx(-0.35)
    bench.send_text("06C#0000A03F0CFE1400")
    inputs = (control.input_position, control.input_velocity, control.input_torque)
    assert inputs == pytest.approx((1.25, -0.5, 0.02))
    bench.send_text("06F#000040410000C841")
    assert (control.velocity_limit, control.current_limit) == (12.0, 25.0)
    bench.send_text("067#0800000000000000")
    bench.run(1)
    assert bench.state() is AxisState.CLOSED_LOOP


def test_golden_encoder_estimate() -> None:
    bench = Bench(turns=-10.5)
    bench.shaft = Shaft(-10.5 * 2.0 * pi, 2.48 * 2.0 * pi)
    bench.device.step(bench.shaft, bench.now_ns)
    assert bench.send(0x09, remote=True)[0].data.hex().upper() == "000028C152B81E40"


def test_golden_heartbeat_06_after_watchdog() -> None:
    bench = Bench(watchdog_s=WATCHDOG_S)
    bench.enable_watchdog()
    bench.arm()
    bench.run(250)
    assert bench.last(0x01) == "0000000101030000"


def test_golden_heartbeat_05_with_motor_error() -> None:
    bench = Bench("0.5")
    bench.device.raise_error(0x40, motor=0x1_0000_0000)
    bench.run(150)
    assert bench.last(0x01) == "4000000001010080"
    assert bench.send(0x03, remote=True)[0].data == pack("<Q", 0x1_0000_0000)


def test_golden_get_error_06_under_voltage() -> None:
    bench = Bench()
    bench.arm()
    bench.device.raise_error(0x200)
    assert bench.send(0x03, remote=True)[0].data.hex().upper() == "0002000000020000"


@pytest.mark.parametrize(
    ("variant", "expected"),
    [("0.6", {0x01: 10, 0x09: 250, 0x1C: 10, 0x15: 2, 0x17: 2}), ("0.5", {0x01: 10, 0x09: 250, 0x14: 10, 0x17: 2})],
)
def test_cyclic_frames_of_one_second(variant: str, expected: dict[int, int]) -> None:
    bench = Bench(variant)
    bench.run(1000)
    counts = {command: sum(frame.id & 0x1F == command for frame in bench.frames) for command in range(32)}
    assert {command: count for command, count in counts.items() if count} == {
        command: pytest.approx(count, abs=1) for command, count in expected.items()
    }


def test_version_is_answered_by_06_only() -> None:
    assert Bench(watchdog_s=WATCHDOG_S).send(0x00, remote=True)[0].data[4:] == bytes((0, 6, 10, 0))
    assert Bench("0.5").send(0x00, remote=True) == []


def test_empty_frame_is_a_request_in_05_only() -> None:
    assert len(Bench("0.5").send(0x09)) == 1
    assert Bench("0.6").send(0x09) == []


# -- anything else -----------------------------------------------------------------------------------------------------


@given(
    command=st.integers(0, 31),
    data=st.binary(max_size=8),
    remote=st.booleans(),
    variant=st.sampled_from(["0.5", "0.6"]),
)
def test_any_frame_is_survived(*, command: int, data: bytes, remote: bool, variant: str) -> None:
    bench = Bench(variant, watchdog_s=WATCHDOG_S)
    bench.arm()
    bench.send(command, data, remote=remote)
    bench.run(3)
    assert abs(bench.torque) <= 1.5


def test_foreign_frames_are_ignored() -> None:
    bench = Bench("0.5", watchdog_s=WATCHDOG_S)
    for frame in (CanFrame("can0", 4 << 5 | 0x02, b""), CanFrame("can0", 3 << 5 | 0x02, b"", extended=True)):
        assert bench.device.receive(frame, bench.now_ns) == ()
    assert bench.device.axis.errors == 0


def test_wrong_setup_names_the_motor_and_the_range() -> None:
    with pytest.raises(ValueError, match=r"motor motor: variant '0.7' id 3: want \['0.5', '0.6'\], 0..62"):
        SimulatedODrive(SETUP._replace(variant="0.7"))


def test_05_tells_zero_until_its_first_closed_loop_and_then_what_it_knew_all_along() -> None:
    bench = Bench("0.5")
    bench.shaft = Shaft(3.0 * 2.0 * pi, 1.0)
    bench.run(5)
    assert bench.send(0x09, remote=True)[0].data == bytes(8)
    bench.arm()
    bench.run(5)
    turns = unpack("<ff", bench.send(0x09, remote=True)[0].data)[0]
    assert turns == pytest.approx(3.0, abs=0.05)
    bench.device.power_cycle()
    bench.run(5)
    assert bench.send(0x09, remote=True)[0].data == bytes(8)


def test_other_rates_are_those_of_the_parameters() -> None:
    bench = Bench()
    numbers = bench.device.axis.parameters.numbers
    for name, ms in (("encoder", 20), ("heartbeat", 0), ("torques", 50)):
        bench.send(0x04, pack("<BHBI", 1, numbers[f"axis0.config.can.{name}_msg_rate_ms"], 0, ms))
    bench.frames.clear()
    bench.run(1000)
    told = [frame.id & 0x1F for frame in bench.frames]
    assert [told.count(command) for command in (0x09, 0x01, 0x1C)] == [50, 0, 20]


def test_another_bit_rate_acts_from_the_next_start_on() -> None:
    bench = Bench()
    bench.device.setup = bench.device.setup._replace(bitrate=250_000)
    number = bench.device.axis.parameters.numbers["can.config.baud_rate"]
    bench.send(0x04, pack("<BHBI", 1, number, 0, 1_000_000))
    assert bench.send(0x04, pack("<BHB", 0, number, 0))[0].data[4:] == pack("<I", 1_000_000)
    bench.send(0x16, b"\x01")
    bench.run(600)
    assert bench.send(0x04, pack("<BHB", 0, number, 0)) == []


def test_what_is_not_calibrated_is_not_armed_until_it_is() -> None:
    bench = Bench()
    bench.device.axis.parameters.put(dict.fromkeys(CALIBRATED, 0.0))
    bench.arm()
    assert (bench.state(), bench.device.axis.result) == (1, 14)
    bench.send(0x07, pack("<I", 3))
    bench.run(250)
    assert (bench.state(), bench.shaft.velocity > 0.0) == (3, True)
    bench.run(1000)
    assert (bench.state(), bench.device.axis.result) == (1, 0)
    bench.arm()
    assert bench.state() == 8


def test_the_vendors_file_of_it() -> None:
    found = Bench().device.flat_endpoints()
    assert (found["fw_version"], found["hw_version"]) == ("0.6.10", "5.2.0")
    endpoints = found["endpoints"]
    assert isinstance(endpoints, dict)
    assert endpoints["axis0.config.enable_watchdog"]["type"] == "bool"
    assert len({one["id"] for one in endpoints.values()}) == len(endpoints)

"""What if, in closed loop: a recorded drive again on the simulated robot, as it was set up and as it might have been.

How this works
--------------
The recorded commands drive the robot with the identified parameters twice. Once with what was set then: that is the
prediction of what is known already, and how well it meets the recorded drive says how far to trust the other one, with
what is to be changed. Both differ from the recording in what the simulated robot does not have; from each other only in
the change. So the answer is the difference between those two, and not that to the recording.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from gateway.config import RobotConfig
from gateway.types import Inputs, Outputs
from replay.compare.likeness import Comparison, Moment, compare
from replay.compare.replay import Replay
from replay.compare.what_if import Change as Changed
from replay.compare.what_if import Step, Sums, WhatIfError, settings_of
from replay.identify.driven import Change, Drive, driven, plant_with, recorded, values_for
from replay.identify.identify import begin_angles
from replay.identify.measured import measured
from replay.identify.parameters import TORQUE_SCALE, ParameterFile
from replay.sessions.reader import Session
from replay.sim.plants.contract import PlantName

CLOSED_LOOP = "closed loop: the simulated robot answered, with the parameters of this drive; what it lacks is not in it"
SENSED = "what sensors told over Zenoh is not given again: its heading is that of the wheels"
_LOOKED_AT = 500  # first cycles that tell where the joints stood at the beginning

Cycle = tuple[Inputs, Outputs]


class Sides(NamedTuple):
    """One cycle. `t`: s since the first one."""

    t: float
    cycle: int
    recorded: Outputs
    predicted: Outputs
    changed: Outputs


class ClosedLoopWhatIf:
    """Iterate over `steps`, then look at the rest. Raises WhatIfError, SessionError, ConfigError at construction.

    `reproduced`: predicted against recorded; its reasons say why the answer is not to be trusted. `effect`: changed
    against predicted. `changes`: of every channel and field of a command.
    """

    def __init__(
        self,
        session: Session,
        parameters: ParameterFile,
        asked: Mapping[str, float],
        robot_file: RobotConfig | None = None,
        begin: float = 0.0,
    ) -> None:
        settings = settings_of(asked, robot_file, begin)
        self.drive: Drive = recorded(session)
        self.new_config = robot_file or self.drive.config
        _check_same(self.drive.config, self.new_config)
        self.change = Change(settings, begin, robot_file)
        self.cycles = 0
        self._session = session
        self._parameters = parameters
        self._sums = Sums(self.drive.config, self.new_config)
        self._moments: tuple[list[Moment], list[Moment], list[Moment]] = ([], [], [])

    @property
    def changes(self) -> list[Changed]:
        """In the order in which they first differ."""
        return self._sums.changes()

    @property
    def reproduced(self) -> Comparison:
        """How well the recorded settings reproduce the recorded drive. Raises WhatIfError."""
        return self._compared(self._moments[0], self._moments[1])

    @property
    def effect(self) -> Comparison:
        """What the change does. Raises WhatIfError."""
        return self._compared(self._moments[1], self._moments[2])

    def steps(self) -> Iterator[Sides]:
        """Every cycle of the grid. Raises WhatIfError, ConfigError."""
        before = _Newest(self._recorded())
        after = _Newest(self._driven(self.change))
        for inputs, predicted in self._driven(None):
            then, changed = before.at(inputs.now_ns), after.at(inputs.now_ns)
            if then is None or changed is None:
                continue
            t = (inputs.now_ns - self.drive.first_ns) * 1e-9
            step = Sides(t, inputs.cycle, then, predicted, changed)
            for moments, outputs in zip(self._moments, step[2:], strict=True):
                trace = outputs.trace
                moments.append(
                    Moment(inputs.now_ns - self.drive.first_ns, trace.pose, trace.wheel_speeds, outputs.mode)
                )
            self._sums.add(Step(t, inputs.cycle, predicted, changed))
            self.cycles += 1
            yield step
        if not self.cycles:
            raise WhatIfError(f"{self._session.path}: there is no cycle whose state of the core is known")

    def _recorded(self) -> Iterator[Cycle]:
        replay = Replay(self.drive.config, self._session.snapshot)
        for inputs, _ in self._session.cycles():
            engine = replay.engine(inputs)
            if engine is not None:
                yield inputs, engine.step(inputs)

    def _driven(self, change: Change | None) -> Iterator[Cycle]:
        config = self.drive.config if change is None else self.new_config
        values = values_for(self._parameters.values, self.drive, None if change is None else change.config)
        try:
            plant = plant_with(config.robot, PlantName(self._parameters.plant), values)
        except ValueError as error:
            raise WhatIfError(str(error)) from None
        scale = values.get(TORQUE_SCALE, 1.0)
        return driven(self.drive, plant, torque_scale=scale, angles=self._angles(), change=change)

    def _angles(self) -> dict[str, float]:
        """Of the joints at the start, as the motors told them first."""
        first: list[Inputs] = []
        for inputs, _ in self._session.cycles():
            first.append(inputs)
            if len(first) >= _LOOKED_AT:
                break
        return begin_angles(measured(first, self.drive.config))

    def _compared(self, one: Sequence[Moment], other: Sequence[Moment]) -> Comparison:
        try:
            return compare(one, other, self.drive.config, self.drive.name)
        except ValueError as error:
            raise WhatIfError(str(error)) from None


class _Newest:
    """Outputs of cycles in order, asked by time."""

    def __init__(self, cycles: Iterable[Cycle]) -> None:
        self._cycles = iter(cycles)
        self._next = next(self._cycles, None)
        self._newest: Outputs | None = None

    def at(self, now_ns: int) -> Outputs | None:
        """The last one until then; None: there was none yet."""
        while self._next is not None and self._next[0].now_ns <= now_ns:
            self._newest = self._next[1]
            self._next = next(self._cycles, None)
        return self._newest


def _check_same(config: RobotConfig, new: RobotConfig) -> None:
    """Raises WhatIfError where the commands and parameters of one robot say nothing of the other."""
    one, other = config.robot, new.robot
    if (one.kind, one.motor_names()) != (other.kind, other.motor_names()):
        raise WhatIfError(
            f"the other robot file is of a robot of kind {other.kind} with {', '.join(other.motor_names())}: "
            f"must be of kind {one.kind} with {', '.join(one.motor_names())}"
        )

"""The mode table, cell by cell and by its laws."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.core.supervisor import TRANSITIONS, Situation, next_mode
from gateway.types import Mode

FACTS = (
    *("estop", "reset", "shutdown", "blocked", "latched", "faulty", "reduced", "commanded"),
    *("start", "armed", "overdue", "rested"),
)
situations = st.fixed_dictionaries({name: st.booleans() for name in FACTS})
MOVING = {Mode.DRIVE, Mode.DEGRADED}

CELLS = [
    (Mode.IDLE, Situation(), Mode.IDLE),
    (Mode.IDLE, Situation(commanded=True, armed=True), Mode.IDLE),
    (Mode.IDLE, Situation(start=True), Mode.STARTING),
    (Mode.IDLE, Situation(start=True, blocked=True), Mode.IDLE),
    (Mode.IDLE, Situation(start=True, shutdown=True), Mode.IDLE),
    (Mode.IDLE, Situation(latched=True), Mode.FAULT),
    (Mode.IDLE, Situation(estop=True, start=True), Mode.ESTOP),
    (Mode.STARTING, Situation(commanded=True), Mode.STARTING),
    (Mode.STARTING, Situation(commanded=True, armed=True), Mode.DRIVE),
    (Mode.STARTING, Situation(commanded=True, armed=True, reduced=True), Mode.DEGRADED),
    (Mode.STARTING, Situation(commanded=True, reduced=True), Mode.STARTING),
    (Mode.STARTING, Situation(commanded=True, overdue=True), Mode.FAULT),
    (Mode.STARTING, Situation(armed=True), Mode.STOPPING),
    (Mode.STARTING, Situation(commanded=True, blocked=True), Mode.FAULT),
    (Mode.STARTING, Situation(commanded=True, armed=True, estop=True), Mode.ESTOP),
    (Mode.DRIVE, Situation(commanded=True, armed=True), Mode.DRIVE),
    (Mode.DRIVE, Situation(armed=True), Mode.STOPPING),
    (Mode.DRIVE, Situation(commanded=True, shutdown=True), Mode.STOPPING),
    (Mode.DRIVE, Situation(commanded=True, reduced=True), Mode.DEGRADED),
    (Mode.DRIVE, Situation(commanded=True, blocked=True), Mode.FAULT),
    (Mode.DRIVE, Situation(commanded=True, estop=True, blocked=True), Mode.ESTOP),
    (Mode.DEGRADED, Situation(commanded=True, armed=True), Mode.DEGRADED),
    (Mode.DEGRADED, Situation(), Mode.STOPPING),
    (Mode.DEGRADED, Situation(commanded=True, blocked=True), Mode.FAULT),
    (Mode.DEGRADED, Situation(estop=True), Mode.ESTOP),
    (Mode.STOPPING, Situation(), Mode.STOPPING),
    (Mode.STOPPING, Situation(rested=True), Mode.IDLE),
    (Mode.STOPPING, Situation(commanded=True, armed=True), Mode.DRIVE),
    (Mode.STOPPING, Situation(commanded=True, armed=True, reduced=True), Mode.DEGRADED),
    (Mode.STOPPING, Situation(commanded=True, armed=True, shutdown=True), Mode.STOPPING),
    (Mode.STOPPING, Situation(commanded=True), Mode.STOPPING),
    (Mode.STOPPING, Situation(commanded=True, reduced=True), Mode.STOPPING),
    (Mode.STOPPING, Situation(armed=True, reduced=True), Mode.STOPPING),
    (Mode.STOPPING, Situation(blocked=True), Mode.FAULT),
    (Mode.STOPPING, Situation(estop=True, rested=True), Mode.ESTOP),
    (Mode.ESTOP, Situation(commanded=True, start=True, rested=True, armed=True), Mode.ESTOP),
    (Mode.ESTOP, Situation(reset=True), Mode.IDLE),
    (Mode.ESTOP, Situation(reset=True, estop=True), Mode.ESTOP),
    (Mode.FAULT, Situation(faulty=True, rested=True), Mode.FAULT),
    (Mode.FAULT, Situation(rested=False), Mode.FAULT),
    (Mode.FAULT, Situation(rested=True), Mode.IDLE),
    (Mode.FAULT, Situation(rested=True, estop=True), Mode.ESTOP),
]


@pytest.mark.parametrize(("mode", "situation", "expected"), CELLS)
def test_cell(mode: Mode, situation: Situation, expected: Mode) -> None:
    assert next_mode(mode, situation) is expected


def test_every_cell_of_the_table_is_exercised() -> None:
    reached = {(mode, next_mode(mode, situation)) for mode, situation, _ in CELLS}
    table = {(mode, successor) for mode, row in TRANSITIONS.items() for _, successor in row}
    assert table <= reached
    assert set(TRANSITIONS) == set(Mode)


@given(st.sampled_from(Mode), situations)
def test_the_emergency_stop_wins_from_everywhere(mode: Mode, facts: dict[str, bool]) -> None:
    assert next_mode(mode, Situation(**facts | {"estop": True})) is Mode.ESTOP


@given(situations)
def test_only_a_reset_leaves_the_emergency_stop(facts: dict[str, bool]) -> None:
    assert next_mode(Mode.ESTOP, Situation(**facts | {"reset": False})) is Mode.ESTOP
    assert next_mode(Mode.ESTOP, Situation(**facts)) in {Mode.ESTOP, Mode.IDLE}


@given(situations)
def test_nothing_leads_from_rest_straight_into_motion(facts: dict[str, bool]) -> None:
    for mode in (Mode.IDLE, Mode.ESTOP, Mode.FAULT):
        assert next_mode(mode, Situation(**facts)) not in MOVING
    assert next_mode(Mode.IDLE, Situation(**facts | {"start": False})) is not Mode.STARTING


@given(st.sampled_from(sorted(MOVING, key=str)), situations)
def test_silence_and_shutdown_never_stay_in_motion(mode: Mode, facts: dict[str, bool]) -> None:
    for quiet in (Situation(**facts | {"commanded": False}), Situation(**facts | {"shutdown": True})):
        assert next_mode(mode, quiet) not in MOVING | {Mode.STARTING}


def test_silence_ends_in_idle_from_every_mode() -> None:
    rest = Situation(rested=True)
    for mode in set(Mode) - {Mode.ESTOP}:
        for _ in itertools.repeat(None, 3):
            mode = next_mode(mode, rest)  # noqa: PLW2901
        assert mode is Mode.IDLE

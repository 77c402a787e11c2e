"""What is drawn of a drive, against the same said once more in the plainest way."""

from collections.abc import Sequence
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from drivers.contract import CanFrame
from gateway.core.samples import CAN_PERIOD_NS, PICTURE_PERIOD_NS, PLOT_PERIOD_NS, Sampler
from gateway.recording.packets import Record
from gateway.types import CycleTiming, Event, Level, Mode, Sample
from tests.drives import drive

BLANK = next(drive(1))
SAID = Event(Level.INFO, "said", "something")


def record(cycle: int, now_ns: int, *, mode: Mode, said: bool, ids: Sequence[int], spent: int) -> Record:
    frames = tuple(CanFrame("can0", identifier, bytes([place])) for place, identifier in enumerate(ids))
    return Record(
        BLANK.inputs._replace(cycle=cycle, now_ns=now_ns, frames=frames),
        BLANK.outputs._replace(mode=mode, events=(SAID,) * said, frames=frames[:1], status=None),
        CycleTiming(spent, 2 * spent, now_ns + 1),
    )


@st.composite
def drives(draw: st.DrawFn) -> list[Record]:
    """Uneven cycles, some of them missing."""
    cycle, now_ns, found = 0, draw(st.integers(0, 10**10)), []
    for _ in range(draw(st.integers(1, 60))):
        cycle += draw(st.sampled_from([1, 1, 1, 1, 7]))
        now_ns += draw(st.sampled_from([1_000_000, 4_000_000, 30_000_000, 400_000_000]))
        mode = draw(st.sampled_from([Mode.IDLE, Mode.IDLE, Mode.DRIVE]))
        ids = draw(st.lists(st.integers(0, 3), max_size=3))
        said, spent = draw(st.integers(0, 9)) == 0, draw(st.integers(0, 100))
        found.append(record(cycle, now_ns, mode=mode, said=said, ids=ids, spent=spent))
    return found


def sampled(records: Sequence[Record]) -> list[Sample]:
    sampler = Sampler()
    found = [sampler.step(one.inputs, one.outputs, one.timing) for one in records]
    return [sample for sample in found if sample is not None]


def firsts(records: Sequence[Record], period_ns: int) -> list[int]:
    """The first cycle of each period."""
    slots: dict[int, int] = {}
    for one in records:
        slots.setdefault(one.inputs.now_ns // period_ns, one.inputs.cycle)
    return list(slots.values())


@given(drives())
def test_plots_and_pictures_are_of_the_first_cycle_of_each_period(records: list[Record]) -> None:
    samples = sampled(records)
    assert [sample.cycle for sample in samples if sample.plotted] == firsts(records, PLOT_PERIOD_NS)
    assert [sample.cycle for sample in samples if sample.pictured] == firsts(records, PICTURE_PERIOD_NS)
    assert all((sample.trace is not None) is (sample.plotted or sample.pictured) for sample in samples)


@given(drives())
def test_no_late_cycle_hides_between_two_points(records: list[Record]) -> None:
    plotted = [sample for sample in sampled(records) if sample.plotted]
    before = -1
    for sample in plotted:
        between = [one.timing for one in records if before < one.inputs.cycle <= sample.cycle]
        assert sample.late_ns == max(timing.late_ns for timing in between)
        assert sample.work_ns == max(timing.work_ns for timing in between)
        before = sample.cycle


@given(drives())
def test_each_message_is_shown_first_in_each_half_second(records: list[Record]) -> None:
    first: dict[tuple[int, bool, int], tuple[int, CanFrame]] = {}
    for one in records:
        slot = one.inputs.now_ns // CAN_PERIOD_NS
        for received, frames in ((True, one.inputs.frames), (False, one.outputs.frames)):
            for frame in frames:
                first.setdefault((slot, received, frame.id), (one.inputs.cycle, frame))
    samples = sampled(records)
    shown = [(sample.cycle, True, frame) for sample in samples for frame in sample.frames_in]
    shown += [(sample.cycle, False, frame) for sample in samples for frame in sample.frames_out]
    expected = [(cycle, received, frame) for (_, received, _), (cycle, frame) in first.items()]
    assert sorted(shown, key=repr) == sorted(expected, key=repr)


@given(drives())
def test_every_event_and_change_of_mode_is_there_with_its_cycle(records: list[Record]) -> None:
    samples = {sample.cycle: sample for sample in sampled(records)}
    for one in records:
        assert not one.outputs.events or samples[one.inputs.cycle].events == one.outputs.events
    for before, one in pairwise(records):
        if one.outputs.mode is not before.outputs.mode:
            assert samples[one.inputs.cycle].mode is one.outputs.mode


@given(drives())
def test_samples_stand_for_every_cycle_that_there_was(records: list[Record]) -> None:
    """A hole between two samples is a hole between two cycles, and the other way round."""
    samples = sampled(records)
    holes = {
        (before.cycle + 1, sample.since) for before, sample in pairwise(samples) if sample.since > before.cycle + 1
    }
    missing = [one.inputs.cycle for before, one in pairwise(records) if one.inputs.cycle != before.inputs.cycle + 1]
    assert [since for _, since in sorted(holes)] == missing
    assert all(sample.since == before.cycle + 1 or sample.since in missing for before, sample in pairwise(samples))
    assert samples[0].since == records[0].inputs.cycle


@given(drives(), st.integers(0, 59))
def test_who_begins_later_is_shown_the_same(records: list[Record], start: int) -> None:
    """But for what is counted from the beginning: the first point and picture, and the half second that runs."""
    late = records[min(start, len(records) - 1) :]
    begun = late[0].inputs.now_ns
    times = {one.inputs.cycle: one.inputs.now_ns for one in records}

    def settled(samples: Sequence[Sample]) -> list[Sample]:
        later = [sample for sample in samples if times[sample.cycle] // CAN_PERIOD_NS > begun // CAN_PERIOD_NS]
        return later[1:]  # its timing and `since` reach back

    assert settled(sampled(late)) == settled(sampled(records))

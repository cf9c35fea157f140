"""Recordings of one run or several: pressure smoothed and brought to the tester's time stamps, runs pooled."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from torcharm.characterise.misfit import smoothed, usually_smoothed, warn_of_slipped_clocks
from torcharm.characterise.recordings import Array, Floats, PressureRecord, TesterRecord
from torcharm.characterise.signs import settled
from torcharm.inputs import check_count, check_number

MOST_LEVELS = 40
"""Distinct strains, or pressures, of what counts as a table; a recording has thousands."""

PAUSE, MISSED = 20.0, 0.01
"""In usual steps of a log, its pauses; and of the tester's stamps, how many in them count."""
STEADY = 1e-4
"""From one sample to the next, a strain that is held may move by so much."""
APART = 0.01
"""Strains further apart than this are different holds."""
TOO_SHORT = 0.01
"""Of a run, a log that lasts no longer is in another unit of time, or of another run."""

Settings = tuple[tuple[str, str | float], ...]


@dataclass(frozen=True, eq=False)
class Recording:
    """One run on the test bench, or several, for one actuator, on the tester's time stamps.

    Example:
        >>> _ = (path := folder / "data.csv").write_text("strain,p [kPa],F [N]\\n0,0,0\\n0,50,44\\n0.1,50,39\\n")
        >>> ta.read_table(path).force.tolist(), ta.read_table(path).sources
        ([0.0, 44.0, 39.0], ('data.csv',))

    Attributes:
        strain: (n).
        pressure: (n) [kPa].
        force: (n) of one actuator [N], in torcharm's sign: positive pushes outward.
        run: (n) which run each sample comes from, counted from 0; within a run samples are in order of time.
        sources: each run's files.
        settings: how they were read, for the record: names and values.
    """

    strain: Float[Floats, " n"]
    pressure: Float[Floats, " n"]
    force: Float[Floats, " n"]
    run: NDArray[np.int64]
    sources: tuple[str, ...]
    settings: Settings = ()

    def only(self, kept: NDArray[np.bool_]) -> "Recording":
        """Some of its samples, as if of one run."""
        columns = {name: getattr(self, name)[kept] for name in ("strain", "pressure", "force")}
        return replace(self, **columns, run=np.zeros(int(kept.sum()), np.int64))


def align(
    tester: TesterRecord,
    log: PressureRecord,
    *,
    actuators: int = 1,
    smoothing: float | None = None,
    offset: float | None = None,
    max_gap: float | None = None,
) -> Recording:
    """One run: the pressure smoothed and interpolated to the tester's time stamps, the force of one actuator.

    Stamps before the log's start or after its end are dropped. Positive forces of a file that nobody and no name tells
    the sense of are those that the samples tell, if they do (see `signs.positive_forces`).

    Args:
        tester, log: of the same run.
        actuators: how many were pulled in parallel and shared the pressure.
        smoothing: σ of the Gaussian [ms]; 0 for none. None: the paper's, 440 ms, where forces fit better with it.
        offset: what is added to the log's time to give the tester's [ms]; see `offset.estimate_offset`. None: 0, with
            a warning where another would fit notably better.
        max_gap: drop stamps within pauses of the log longer than this [ms]; None bridges all of them, as the
            paper does.

    Raises:
        ValueError: the two do not overlap in time, or a setting is out of range.

    Example:
        >>> _ = (path := folder / "run.csv").write_text("t [s],ε [1],F [N],p [kPa],log [s]\\n1,0,1,0,0\\n2,0,5,80,4\\n")
        >>> ta.align(ta.read_tester(path), ta.read_pressure(path, columns="time=5:s"), smoothing=0).pressure.tolist()
        [20.0, 40.0]
    """
    count = check_count("actuators", actuators, 1)
    if max_gap is not None:
        check_number("max_gap", max_gap, 0.0)
    shift = 0.0 if offset is None else offset
    check_number("offset", shift)
    clock = log.time + shift
    kept = _kept(tester, log, clock, shift, max_gap)
    smoothing, logged = (
        usually_smoothed(tester, log, shift) if smoothing is None else (smoothing, smoothed(log, smoothing))
    )
    pressure = np.interp(tester.time[kept], clock, logged)
    if offset is None and log.source != tester.source:
        warn_of_slipped_clocks(tester, log, logged)
    tension = 1.0 if tester.signs.positive == "pull" else -1.0
    strain = tester.strain[kept]
    strain, force, words = settled(tester.signs, strain, pressure, tension * tester.force[kept], tester.source)
    settings: Settings = (
        ("actuators in parallel", float(count)),
        ("smoothing of pressure, ms", float(smoothing)),
        ("offset of the log, ms", float(shift)),
        *(() if max_gap is None else (("longest pause of the log, ms", float(max_gap)),)),
        *words,
        *noted(tester.source, tester.notes),
        *(noted(log.source, log.notes) if log.source != tester.source else ()),
    )
    sources = ", ".join(dict.fromkeys((Path(tester.source).name, Path(log.source).name)))
    return Recording(strain, pressure, force / count, np.zeros(len(force), np.int64), (sources,), settings)


def _kept(
    tester: TesterRecord, log: PressureRecord, clock: Array, offset: float, max_gap: float | None
) -> NDArray[np.bool_]:
    """Which of the tester's stamps the log has, too, on the tester's clock."""
    logged, ran = clock[-1] - clock[0], tester.time[-1] - tester.time[0]
    if logged < TOO_SHORT * ran:
        raise ValueError(
            f"{log.source}: lasts {logged:g} ms, and {tester.source} {ran:g} ms, must be of the same run: is the unit "
            'of time right? --pressure-columns says it, as in "time=1:s"'
        )
    kept = (tester.time >= clock[0]) & (tester.time <= clock[-1])
    if not kept.any():
        raise ValueError(
            f"{tester.source} and {log.source}: do not overlap in time: the tester ran from "
            f"{tester.time[0]:.10g} to {tester.time[-1]:.10g} ms, the log from {clock[0]:.15g} to {clock[-1]:.15g} ms; "
            f"an offset of {offset + tester.time[0] - clock[0]:.15g} ms (--offset) would start both at once"
        )
    steps = np.diff(clock)
    gap = steps[np.searchsorted(clock, tester.time).clip(1, len(clock) - 1) - 1]
    paused = kept & (gap > PAUSE * float(np.median(steps)))
    if max_gap is not None:
        kept &= gap <= max_gap
        if not kept.any():
            raise ValueError(f"max_gap: leaves no sample of {tester.source} and {log.source}, got {max_gap:g} ms")
    elif paused.sum() > MISSED * len(paused):
        warnings.warn(
            f"{log.source}: has no pressures for {gap[paused].max() / 1e3:.3g} s, usually one each "
            f"{np.median(steps) / 1e3:.3g} s: in such pauses {paused.sum()} samples of {tester.source} have what lies "
            f"between the ends: --max-gap {gap[paused].min() / 2:.0f} leaves them out",
            stacklevel=3,
        )
    return kept


def noted(source: str, notes: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """What was left out, averaged or assumed of a file, as settings have it; nothing if nothing was."""
    return ((f"notes on {Path(source).name}", "; ".join(notes)),) if notes else ()


def pool(recordings: Sequence[Recording]) -> Recording:
    """Several runs as one; settings that differ are kept run by run.

    Example:
        >>> _ = (path := folder / "data.csv").write_text("strain,p [kPa],F [N]\\n0,0,0\\n0,50,44\\n0.1,50,39\\n")
        >>> ta.pool([ta.read_table(path), ta.read_table(path)]).run.tolist()
        [0, 0, 0, 1, 1, 1]

    Raises:
        ValueError: there is none, or positive forces pull in one and push in another by samples or by assumption.
    """
    if not recordings:
        raise ValueError("recordings: must hold at least one run, got none")
    known = [(str(dict(one.settings).get("positive forces", "")), one.sources[0]) for one in recordings]
    ways = {words.partition(",")[0]: source for words, source in known if "--positive" in words}  # that nobody said
    if len(ways) > 1:
        got = " and ".join(f"{source} where they seem to {way}" for way, source in ways.items())
        raise ValueError(f"positive: must be said (--positive), as all runs' forces act one way, got {got}")
    counts = [int(one.run.max()) + 1 for one in recordings]
    starts = np.cumsum([0, *counts[:-1]])
    shared = [pair for pair in recordings[0].settings if all(pair in one.settings for one in recordings)]
    own = [
        (f"{name}, run {index + 1}", value)
        for index, one in enumerate(recordings)
        for name, value in one.settings
        if (name, value) not in shared
    ]
    return Recording(
        np.concatenate([one.strain for one in recordings]),
        np.concatenate([one.pressure for one in recordings]),
        np.concatenate([one.force for one in recordings]),
        np.concatenate([one.run + start for one, start in zip(recordings, starts, strict=True)]),
        tuple(source for one in recordings for source in one.sources),
        (*shared, *own),
    )


def by_depth(recording: Recording) -> Recording:
    """The same with pressures below zero as depths of vacuum, which are positive: what limits and results then are.

    Raises:
        ValueError: most of their range is above zero.
    """
    low, high = float(recording.pressure.min()), float(recording.pressure.max())
    if high > -low:
        raise ValueError(
            f"--vacuum: must stand with pressures below 0, got {low:.4g} to {high:.4g} kPa: depths do without it, "
            'and absolute pressures are said beside it, by --columns or --pressure-columns: "pressure=2:kPa abs"'
        )
    settings = (*recording.settings, ("pressures", "depths of vacuum"))
    return replace(recording, pressure=-recording.pressure, settings=settings)


def is_table(recording: Recording) -> bool:
    """Whether samples stand at a few strains and pressures, as those of a data sheet do."""
    return all(len(np.unique(values)) <= MOST_LEVELS for values in (recording.strain, recording.pressure))


def held_strains(recording: Recording) -> list[NDArray[np.int64]]:
    """Samples of the strains at which the tester held still, one array of indices for each, from least to most.

    Args:
        recording: one run, or several pooled: holds at equal strains go together. A table holds each of its strains.
    """
    if is_table(recording):
        levels, place = np.unique(recording.strain, return_inverse=True)
        return [np.flatnonzero(place == level) for level in range(len(levels))]
    still = np.zeros(len(recording.strain), bool)
    still[1:] = (np.abs(np.diff(recording.strain)) <= STEADY) & (np.diff(recording.run) == 0)
    # A ramp is a chain of small steps: what holds stays put over the samples around it, too.
    reach = 25
    ahead, behind = np.roll(recording.strain, -reach), np.roll(recording.strain, reach)
    still &= (np.abs(ahead - recording.strain) <= STEADY) & (np.abs(behind - recording.strain) <= STEADY)
    index = np.flatnonzero(still)
    index = index[np.argsort(recording.strain[index], kind="stable")]
    cuts = np.flatnonzero(np.diff(recording.strain[index]) > APART) + 1
    return [np.sort(part) for part in np.split(index, cuts) if len(part) > 2 * reach]

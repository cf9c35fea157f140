"""Recordings of one run or several: pressure smoothed and brought to the tester's time stamps, runs pooled."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from torcharm.characterise.recordings import Array, Floats, PressureRecord, TesterRecord
from torcharm.inputs import check_count, check_number

PAPER_SMOOTHING = 40.0
"""σ of the paper's Gaussian smoothing of pressure, in samples of the log."""
MOST_LEVELS = 40
"""Distinct strains, or pressures, of what counts as a table; a recording has thousands."""
SMOOTHING_REACH = 2.5
"""The Gaussian ends at so many σ: with the paper's σ it spans 201 samples."""


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
    settings: tuple[tuple[str, str | float], ...] = ()


def smooth(values: Float[Floats, " n"], deviation: float) -> Float[Floats, " n"]:
    """A Gaussian-weighted mean over the samples within 2.5 deviations, and at the ends over those there are.

    Args:
        values: evenly spaced.
        deviation: σ in samples; 0 leaves the values as they are.
    """
    if deviation == 0:
        return values
    from scipy.ndimage import gaussian_filter1d

    options = {"sigma": deviation, "mode": "constant", "truncate": SMOOTHING_REACH}
    return gaussian_filter1d(values, **options) / gaussian_filter1d(np.ones_like(values), **options)


def align(
    tester: TesterRecord,
    log: PressureRecord,
    *,
    actuators: int = 1,
    smoothing: float = PAPER_SMOOTHING,
    offset: float = 0.0,
    max_gap: float | None = None,
) -> Recording:
    """One run: the pressure smoothed and interpolated to the tester's time stamps, the force of one actuator.

    Stamps before the log's start or after its end are dropped.

    Args:
        tester, log: of the same run.
        actuators: how many were pulled in parallel and shared the pressure.
        smoothing: σ of the Gaussian in samples of the log; 0 for none.
        offset: what is added to the log's time to give the tester's [ms]; see `offset.estimate_offset`.
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
    for name, value in (("smoothing", smoothing), ("max_gap", max_gap)):
        if value is not None:
            check_number(name, value, 0.0)
    check_number("offset", offset)
    return _aligned(tester, log, smooth(log.pressure, smoothing), count, smoothing, offset, max_gap)


def _aligned(
    tester: TesterRecord,
    log: PressureRecord,
    smoothed: Array,
    actuators: int,
    smoothing: float,
    offset: float,
    max_gap: float | None,
) -> Recording:
    clock = log.time + offset
    kept = (tester.time >= clock[0]) & (tester.time <= clock[-1])
    if not kept.any():
        raise ValueError(
            f"{tester.source} and {log.source}: do not overlap in time: the tester ran from "
            f"{tester.time[0]:.10g} to {tester.time[-1]:.10g} ms, the log from {clock[0]:.15g} to {clock[-1]:.15g} ms; "
            f"an offset of {offset + tester.time[0] - clock[0]:.15g} ms would start both at once"
        )
    if max_gap is not None:
        after = np.searchsorted(clock, tester.time).clip(1, len(clock) - 1)
        kept &= clock[after] - clock[after - 1] <= max_gap
        if not kept.any():
            raise ValueError(f"max_gap: leaves no sample of {tester.source} and {log.source}, got {max_gap:g} ms")
    settings: tuple[tuple[str, str | float], ...] = (
        ("actuators in parallel", float(actuators)),
        ("smoothing of pressure, samples", float(smoothing)),
        ("offset of the log, ms", float(offset)),
        *(() if max_gap is None else (("longest pause of the log, ms", float(max_gap)),)),
        *noted(tester.source, tester.notes),
        *(noted(log.source, log.notes) if log.source != tester.source else ()),
    )
    return Recording(
        tester.strain[kept],
        np.interp(tester.time[kept], clock, smoothed),
        -tester.force[kept] / actuators,
        np.zeros(int(kept.sum()), np.int64),
        (", ".join(dict.fromkeys((Path(tester.source).name, Path(log.source).name))),),
        settings,
    )


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
        ValueError: there is none.
    """
    if not recordings:
        raise ValueError("recordings: must hold at least one run, got none")
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
    """The same with pressures below zero as depths of vacuum, which are positive: what limits and results then are."""
    settings = (*recording.settings, ("pressures", "depths of vacuum"))
    return replace(recording, pressure=-recording.pressure, settings=settings)


def is_table(recording: Recording) -> bool:
    """Whether samples stand at a few strains and pressures, as those of a data sheet do."""
    return all(len(np.unique(values)) <= MOST_LEVELS for values in (recording.strain, recording.pressure))


def held_strains(recording: Recording, *, steady: float = 1e-4, apart: float = 0.01) -> list[NDArray[np.int64]]:
    """Samples of the strains at which the tester held still, one array of indices for each, from least to most.

    Args:
        recording: one run, or several pooled: holds at equal strains go together. A table holds each of its strains.
        steady: from one sample to the next, strain may move by so much.
        apart: strains further apart than this are different holds.
    """
    if is_table(recording):
        levels, place = np.unique(recording.strain, return_inverse=True)
        return [np.flatnonzero(place == level) for level in range(len(levels))]
    still = np.zeros(len(recording.strain), bool)
    still[1:] = (np.abs(np.diff(recording.strain)) <= steady) & (np.diff(recording.run) == 0)
    # A ramp is a chain of small steps: what holds stays put over the samples around it, too.
    reach = 25
    ahead, behind = np.roll(recording.strain, -reach), np.roll(recording.strain, reach)
    still &= (np.abs(ahead - recording.strain) <= steady) & (np.abs(behind - recording.strain) <= steady)
    index = np.flatnonzero(still)
    index = index[np.argsort(recording.strain[index], kind="stable")]
    cuts = np.flatnonzero(np.diff(recording.strain[index]) > apart) + 1
    return [np.sort(part) for part in np.split(index, cuts) if len(part) > 2 * reach]

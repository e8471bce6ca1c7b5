"""From measurements to times at given errors, ratios, and where percept does not win."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from percept.provenance import Made
from reports.benchmark.measure import Machine
from reports.benchmark.peers.engines import ENGINES, STUDIES, engine
from reports.benchmark.peers.processes import Comparison, Measured, Whole, comparisons
from reports.benchmark.peers.reference import Reference

_SCHEMA = "percept-benchmark-3"
#: Errors over half-width at which times are compared.
_LEVELS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_OURS = "percept"
_PLAIN = "nutpie"
_USUAL_DRAWS = 1000  # Per chain: samplers of this kind take so many where nothing else is asked for
_RATIO = 2.0  # Time goes with the error to this power, once a sampler has converged
_AIM_LEVEL = 0.01  # Error at which sampling times are compared with what percept aims at
_AIM_DRAWS = 1000.0  # Times nutpie's effective draws per second
_AIM_TIME = 5000.0  # Times faster than nutpie to that error


@dataclass(frozen=True)
class Reached:
    """Time of one engine to one error, and how much longer that is than percept's."""

    study: str
    engine: str
    level: float  # Error over half-width
    warm: float  # s
    cold: float  # s
    processor: float  # s
    extrapolated: bool  # Whether the most accurate run's time over error squared stands here
    warm_ratio: float  # Over percept's times to the same error, as the next two; NaN without them
    cold_ratio: float
    processor_ratio: float


@dataclass(frozen=True)
class Aim:
    """A ratio of percept to nutpie, and what percept aims at."""

    what: str
    value: float  # By wall time
    processor: float
    aim: float


@dataclass(frozen=True)
class StudyFacts:
    """A study and the limits that errors are measured against."""

    name: str
    about: str
    limits: int
    runs: int
    effective: float
    scatter: float
    relative_error: float


@dataclass(frozen=True)
class _Title:
    """An engine as the page names it."""

    name: str
    title: str
    unit: str


@dataclass(frozen=True)
class Benchmark:
    """A run, as benchmark.json holds it."""

    schema: str
    made: Made
    machine: Machine
    studies: list[StudyFacts]
    engines: list[_Title]
    left_out: Mapping[str, Sequence[str]]  # Packages that each misses
    measured: Sequence[Measured]
    reached: list[Reached]
    whole: Sequence[Whole]
    comparisons: list[Comparison]
    aims: list[Aim]
    losses: list[str]


@dataclass(frozen=True)
class _Times:
    """Of one engine to one error, s."""

    warm: float
    cold: float
    processor: float
    extrapolated: bool


def reached(measured: Sequence[Measured], levels: Sequence[float] = _LEVELS) -> list[Reached]:
    """Work out times to given errors, and their ratios to percept's."""
    groups: dict[tuple[str, str], list[Measured]] = {}
    for row in measured:
        groups.setdefault((row.study, row.engine), []).append(row)
    rows = []
    for (study, name), group in groups.items():
        own_group = groups.get((study, _OURS))
        for level in levels:
            times = _time_to(level, group)
            own = _time_to(level, own_group) if own_group else _NOT_MEASURED
            rows.append(
                Reached(
                    study,
                    name,
                    level,
                    times.warm,
                    times.cold,
                    times.processor,
                    times.extrapolated,
                    times.warm / own.warm,
                    times.cold / own.cold,
                    times.processor / own.processor,
                )
            )
    return rows


_NOT_MEASURED = _Times(math.nan, math.nan, math.nan, extrapolated=False)


def _time_to(level: float, group: Sequence[Measured]) -> _Times:
    """Return the times to an error: of the fastest run that is as accurate, or extrapolated."""
    enough = [row for row in group if row.error <= level]
    if enough:
        best = min(enough, key=lambda row: row.warm)
        more = 1.0
    else:
        best = min(group, key=lambda row: row.error)
        more = (best.error / level) ** _RATIO
    start = best.cold - best.warm
    warm = best.warm * more
    return _Times(warm, start + warm, best.processor * more, extrapolated=not enough)


def build_document(
    measured: Sequence[Measured],
    whole: Sequence[Whole],
    references: Mapping[str, Reference],
    *,
    made: Made,
    at: Machine,
    left_out: Mapping[str, Sequence[str]] | None = None,
) -> Benchmark:
    """Collect a run.

    Parameters
    ----------
    measured : sequence of Measured
        Engines on studies.
    whole : sequence of Whole
        Whole commands.
    references : mapping
        By study, in the page's order.
    made : Made
        What the page was made by.
    at : Machine
        Where.
    left_out : mapping, optional
        What was left out, with the packages it misses.

    Returns
    -------
    Benchmark
        With times to given errors, ratios, and where percept does not win.
    """
    times = reached(measured)
    compared = comparisons(whole)
    aims = _aims(measured, times)
    present = {row.engine for row in measured}
    studies = []
    for name, reference in references.items():
        error = reference.relative_error(reference.value + reference.error)
        about = STUDIES.get(name, name)
        studies.append(
            StudyFacts(
                name,
                about,
                reference.value.size,
                reference.runs,
                reference.effective,
                reference.scatter,
                error,
            )
        )
    titles = []
    for engine_ in ENGINES:
        if engine_.name in present:
            titles.append(_Title(engine_.name, engine_.title, engine_.unit))
    return Benchmark(
        schema=_SCHEMA,
        made=made,
        machine=at,
        studies=studies,
        engines=titles,
        left_out=left_out or {},
        measured=measured,
        reached=times,
        whole=whole,
        comparisons=compared,
        aims=aims,
        losses=[*_slower(times), *_missed(aims), *_broken(compared)],
    )


def _aims(measured: Sequence[Measured], times: Sequence[Reached]) -> list[Aim]:
    """Compare percept with nutpie on the first study's plain model, and with what it aims at."""
    study = measured[0].study
    theirs = [row for row in measured if (row.study, row.engine) == (study, _PLAIN)]
    ours = [row for row in measured if (row.study, row.engine) == (study, _OURS)]
    if not theirs or not ours:
        return []
    best = max(ours, key=lambda row: row.effective_per_second)
    # With divergences its effective draws vary many times from run to run: what users take.
    usual = min(theirs, key=lambda row: abs(row.size - _USUAL_DRAWS))
    plain_at_aim = (study, _PLAIN, _AIM_LEVEL)
    to_aim = next(row for row in times if (row.study, row.engine, row.level) == plain_at_aim)
    of_draws = Aim(
        f"effective draws per second over nutpie’s, 4 × {usual.size:.0f} draws",
        best.effective_per_second / usual.effective_per_second,
        best.effective_per_processor_second / usual.effective_per_processor_second,
        _AIM_DRAWS,
    )
    of_time = Aim(
        f"nutpie’s sampling time to an error of {100 * _AIM_LEVEL:g} %, over percept’s",
        to_aim.warm_ratio,
        to_aim.processor_ratio,
        _AIM_TIME,
    )
    return [of_draws, of_time]


def _slower(times: Sequence[Reached]) -> list[str]:
    """Say where another engine is faster than percept."""
    lines = []
    for row in times:
        if row.engine == _OURS:
            continue
        extrapolated = ", extrapolated" if row.extrapolated else ""
        for state, ratio in (("warm", row.warm_ratio), ("cold", row.cold_ratio)):
            if ratio < 1.0:
                lines.append(
                    f"{row.study}: {engine(row.engine).title} reaches {row.level:.1%} {state} in"
                    f" {ratio:.2f} times percept’s time{extrapolated}."
                )
    return lines


def _missed(aims: Sequence[Aim]) -> list[str]:
    """Say which aims are not reached."""
    lines = []
    for aim in aims:
        if aim.value < aim.aim:
            what = aim.what[0].upper() + aim.what[1:]
            lines.append(f"{what}: {aim.value:.3g}; {aim.aim:g} is the aim.")
    return lines


def _broken(compared: Sequence[Comparison]) -> list[str]:
    """Say which promised ratios of whole commands are not kept."""
    lines = []
    for comparison in compared:
        if not comparison.kept:
            lines.append(
                f"{comparison.command} takes {comparison.ratio:.2f} times the wall time and"
                f" {comparison.processor_ratio:.2f} times the processor time of"
                f" {comparison.against}; {comparison.promised:g} is promised."
            )
    return lines

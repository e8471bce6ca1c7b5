"""The sections of the page on what its results rest on, and the works that they cite."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from collections.abc import Iterable, Sequence
from functools import cache
from importlib import resources
from typing import Any

from percept import __version__
from percept.report.cautions import misfits
from percept.report.contrast import Design, design_words
from percept.report.numbers import bare, percentage, rounded
from percept.report.select import (
    KINDS,
    Section,
    Words,
    compared_by_difference,
    distinct,
    family_of,
    listed,
    makes_impedance,
    matching,
    ordered,
    words_of,
)
from percept.results import BandPair, Boundary, MethodPair, Results

__all__ = [
    "bands_sentences",
    "bibtex",
    "checks",
    "cited",
    "comparison",
    "data",
    "diagnostics",
    "methods",
]


@dataclasses.dataclass(frozen=True)
class Comparison:
    """The section on how the methods differ."""

    sentence: str
    bands: str  # How the methods' boundaries differ; empty without boundaries


def comparison(results: Results) -> Section | None:
    """Say how classical and Bayesian intervals differ, and why."""
    pairs = results.comparison
    if not pairs:
        return None
    view = Comparison(
        sentence=_differences(pairs, results),
        bands=" ".join(bands_sentences(results.band_pairs or ())),
    )
    return Section("comparison", "Classical against Bayesian", view)


def _differences(pairs: Sequence[MethodPair], results: Results) -> str:
    """Say in two sentences how far the methods lie apart."""
    ratios = [pair.width_ratio for pair in pairs if pair.width_ratio is not None]
    farthest: dict[str | None, float] = {}  # By quantity; None for all whose shift is a fraction
    for pair in pairs:
        if pair.shift is not None:
            name = None if pair.relative else pair.parameter
            farthest[name] = max(farthest.get(name, 0.0), abs(pair.shift))
    if not ratios or not farthest:
        return ""
    shifts = []
    for name, size in farthest.items():
        if name is None:
            shifts.append(percentage(size, 2))
        else:
            unit = results.data.quantities[name].unit
            shifts.append(f"{bare(rounded(size, 2))} {unit}".strip())
    least = bare(rounded(min(ratios), 2))
    most = bare(rounded(max(ratios), 2))
    widths = f"{least} times" if least == most else f"{least} to {most} times"
    return (
        f"Of the same family and kind, Bayesian intervals are {widths} as wide as classical ones. "
        f"Their estimates lie at most {listed(shifts)} apart."
    )


def bands_sentences(pairs: Sequence[BandPair]) -> list[str]:
    """Say where the methods' boundaries lie farthest apart in place, and in width."""
    if not pairs:
        return []
    place = max(pairs, key=lambda pair: abs(pair.place.largest))
    width = max(pairs, key=lambda pair: abs(pair.width.largest))
    sign = "higher" if place.place.largest > 0 else "lower"
    apart = percentage(abs(place.place.largest), 2)
    ratio = bare(rounded(math.exp(width.width.largest), 2))
    return [
        f"The Bayesian band of abs(Z_h) lies farthest from the classical one in {_where(place)}:"
        f" {apart} {sign} at {bare(rounded(place.place.omega, 2))} rad/s.",
        f"Its width differs most in {_where(width)}: {ratio} times at"
        f" {bare(rounded(width.width.omega, 2))} rad/s.",
    ]


def _where(pair: BandPair) -> str:
    return f"{pair.environment} (kind {pair.kind})"


@dataclasses.dataclass(frozen=True)
class Measure:
    """A measure of the gate, and what the gate asks of it."""

    name: str  # Of its field in `GateVerdict`
    label: str
    digits: int
    limit: str = ""


def diagnostics(results: Results) -> Section | None:
    """Return the measures behind the gate's verdict on the sampler."""
    if results.diagnostics is None:
        return None
    gate = results.diagnostics.gate
    times = "Length of a kept run in autocorrelation times"
    errors = "Monte Carlo error of the Bayesian intervals’ limits, largest (half-widths)"
    measures = (
        Measure("rhat", "Rank R̂ across ensembles, largest", 5, f"below {gate.rhat_limit}"),
        Measure("autocorrelation_time", "Autocorrelation time, longest (steps)", 4, "finite"),
        Measure("times_run", times, 4, f"{gate.times_needed:g} or more"),
        Measure("effective_draws", "Effective draws, fewest", 5),
        Measure("acceptance", "Fraction of proposals accepted", 3),
        Measure("worst_error", errors, 3, "within the tolerance"),
    )
    view = [measure for measure in measures if getattr(gate, measure.name) is not None]
    return Section("diagnostics", "Sampling and its checks", view)


@dataclasses.dataclass(frozen=True)
class CheckColumn:
    """A column of a table of the checks."""

    name: str  # Of its field
    head: str
    text: bool = False


@dataclasses.dataclass(frozen=True)
class CheckTable:
    """A table of the checks."""

    caption: str
    columns: list[CheckColumn]
    rows: Sequence[Any]


@dataclasses.dataclass(frozen=True)
class ModelChecks:
    """The section of the checks."""

    messages: list[str]
    tables: list[CheckTable]


_HEADS = {
    "p_value": "p",
    "above": "probability of more",
}
#: What the messages above the tables say.
_UNSHOWN = {"unusual"}


def checks(results: Results) -> Section | None:
    """Return the checks of the model as messages and tables, where they were asked for."""
    record = results.checks
    if record is None:
        return None
    words = words_of(results)
    tables = [
        _check_table(
            "Shapiro–Wilk tests of the values of the {subjects} (normal) and of their logarithms"
            " (lognormal): what the classical intervals of each family assume. With ten {subjects}"
            " only gross misfit shows.",
            record.normality,
            words,
        ),
        _check_table(
            "Mean and SD over {subjects} (response scale) and the farthest {subject} (in SDs),"
            " against new studies drawn from the posterior.",
            record.statistics,
            words,
        ),
    ]
    messages = list(misfits(record, family_of(results), words)) if record.loo else []
    view = ModelChecks(messages, [table for table in tables if table.rows])
    return Section("checks", "Checks of the model", view)


def _check_table(caption: str, rows: Sequence[Any], words: Words) -> CheckTable:
    """Return a table with a column per field of its rows."""
    columns = []
    for name, value in vars(rows[0]).items() if rows else ():
        if name not in _UNSHOWN:
            columns.append(CheckColumn(name, _HEADS.get(name, name), isinstance(value, str)))
    return CheckTable(caption.format(**vars(words)), columns, rows)


def data(results: Results) -> Section:
    """Return what is counted of the rows read, in the study's words."""
    words = words_of(results)
    labels = {
        "subjects": words.subjects,
        "environments": words.environments,
        "empty cells (subject × environment)": (
            f"empty cells ({words.subject} × {words.environment})"
        ),
    }
    return Section("data", "Data", labels)


_CLASSICAL = {
    "mean": "t-intervals of the mean",
    "user": "prediction intervals of the next {0}",
    "share": "exact two-sided tolerance intervals",
}


@dataclasses.dataclass(frozen=True)
class Reference:
    """A work to cite."""

    key: str
    entry: str  # Its type in BibTeX
    text: str  # For a list
    fields: dict[str, str]  # Of BibTeX


@dataclasses.dataclass(frozen=True, kw_only=True)
class Methods:
    """What the methods paragraph depends on, and what it cites."""

    family: str
    kinds: list[str]
    classical: str  # The classical intervals, in words; empty without any
    classical_families: list[str]
    bayesian: bool
    subjects: int
    design: Design
    deviation: str
    model: str
    priors: str  # What the scene changed of them; empty without a fit
    worst: Boundary | None
    references: list[Reference]
    numbers: dict[str, int]  # Of the references, by key
    bibtex: str


def methods(results: Results) -> Section:
    """Return what the methods paragraph depends on, and what it cites."""
    used = distinct(results.intervals, "method")
    kinds = ordered(KINDS, results.intervals, "kind")
    classical = [_CLASSICAL[kind].format(words_of(results).user) for kind in kinds]
    references = cited(results)
    rows = matching(results.intervals, method="classical")
    # Lognormal limits of what has references of zero are in the tables alone.
    differences = compared_by_difference(rows)
    families = {row.family for row in rows if row.parameter not in differences} | {"normal"}
    view = Methods(
        family=family_of(results),
        kinds=kinds,
        classical=listed(classical) if "classical" in used else "",
        classical_families=sorted(families, reverse=True),
        bayesian="bayesian" in used,
        subjects=max((row.n for row in results.intervals), default=0),
        design=design_words(results),
        deviation=_deviation(results),
        model=_model(results),
        priors=_priors(results) if "bayesian" in used else "",
        worst=worst_curve(results.boundaries),
        references=references,
        numbers={reference.key: rank for rank, reference in enumerate(references, start=1)},
        bibtex=bibtex(results),
    )
    return Section("methods", "Results and methods, ready to paste", view)


def _priors(results: Results) -> str:
    """Say which priors the scene changed, each with its value."""
    changed = results.provenance.scene["model"].get("priors", {})
    in_force = results.diagnostics.priors if results.diagnostics else ()
    said = [
        f"the {prior.meaning} was {bare(rounded(prior.value, 4))}"
        for prior in in_force
        if prior.prior in changed
    ]
    if not said:
        return "All priors are percept’s defaults." if in_force else ""
    return f"Of the priors, {listed(said)}; all others are percept’s defaults."


def _deviation(results: Results) -> str:
    """Say what the responses of the normal family are."""
    quantities = results.data.quantities
    differences = compared_by_difference(results.intervals)
    scales = results.provenance.scene["model"]["scale"]
    labels = {name: quantity.label for name, quantity in quantities.items()}
    parts = []
    if relative := [label for name, label in labels.items() if name not in differences]:
        of = "" if not differences else f" ({' and '.join(relative)})"
        parts.append(f"relative deviation of the adjustment from the reference{of}")
    for name in (name for name in quantities if name in differences and name in scales):
        of = f" of {labels[name]}" if relative or len(differences) > 1 else ""
        size = quantities[name].amount(scales[name])
        if quantities[name].is_matched:
            parts.append(f"difference{of} between adjustment and reference in steps of {size}")
        else:
            parts.append(f"value{of} over {size}")
    return " and ".join(parts)


def worst_curve(boundaries: Iterable[Boundary]) -> Boundary | None:
    """Return the curve with the largest typical Monte Carlo error; None where no curve has one."""
    drawn = [boundary for boundary in boundaries if boundary.error is not None]
    return max(drawn, key=lambda boundary: boundary.error or 0.0, default=None)


def _model(results: Results) -> str:
    """Say what the hierarchical model is made of; data and scene leave parts of it out."""
    model = results.provenance.scene["model"]
    words = words_of(results)
    parameters = distinct(results.intervals, "parameter")
    names = [results.data.quantities[parameter].label for parameter in parameters]
    pair = len(names) == 2
    sessions = results.data.form == "trials"
    several = len(results.data.environments) > 1
    parts = ["a bias"]
    if several:
        parts = [f"{_trend(results)} with a deviation for each {words.environment}"]
    if sessions and several and model["subject_effect"]:
        both = f" and correlated between {' and '.join(names)}" if pair else ""
        parts.append(f"{words.subject} effects shared by all {words.environments}{both}")
    scatter = f"between-{words.subject} scatter"
    if several:
        common = model["common_spread"]
        scatter += (
            f" equal in all {words.environments}" if common else f" within each {words.environment}"
        )
    if several and model["weber"]:
        scatter += (
            f", in proportion to the reference but for each {words.environment}’s own deviation"
        )
    in_force = results.diagnostics.priors if results.diagnostics else ()
    if any(prior.prior == "omega_s_scale" for prior in in_force):
        scatter += f", with trial SDs that differ between {words.subjects}"
    by_itself = f" ({' and '.join(names)} each by itself)" if pair and not sessions else ""
    return f"{', '.join(parts)}, and {scatter}{by_itself}"


def _trend(results: Results) -> str:
    """Say what joins the biases: no reference of zero or below has a logarithm."""
    differences = compared_by_difference(results.intervals)
    trend = "a regression of bias on the logarithm of the reference"
    if not differences:
        return trend
    common = "a common bias"
    relative = [name for name in results.data.quantities if name not in differences]
    if not relative:
        return common
    labels = [results.data.quantities[name].label for name in relative]
    return f"{trend} ({' and '.join(labels)}) or {common}"


@cache
def _references() -> tuple[Reference, ...]:
    """Return works to cite, in order."""
    text = resources.files("percept.report").joinpath("references.toml").read_text(encoding="utf-8")
    tables = tomllib.loads(text.replace("{version}", __version__))
    return tuple(Reference(key, **table) for key, table in tables.items())


def cited(results: Results) -> list[Reference]:
    """Return what the methods paragraph of results cites, in order."""
    methods = distinct(results.intervals, "method")
    needed = {"percept"}
    if makes_impedance(results):
        needed.add("boundaries")
    if "classical" in methods:
        needed.add("meeker2017")
    if "bayesian" in methods:
        needed |= {"emcee", "cotter2013", "vehtari2021"}
    if results.anova:
        needed.add("greenhouse1959")
    if results.provenance.scene.get("coupling") and makes_impedance(results):
        needed |= {"adams1999", "colgate1997"}
    return [reference for reference in _references() if reference.key in needed]


def bibtex(results: Results) -> str:
    """Return the BibTeX entries of what results cite."""
    entries = []
    for reference in cited(results):
        fields = ",\n".join(f"  {name} = {{{value}}}" for name, value in reference.fields.items())
        entries.append(f"@{reference.entry}{{{reference.key},\n{fields}\n}}\n")
    return "\n".join(entries)

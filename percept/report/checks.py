"""Whether numbers may be relied on: the sampler, the model, each subject, and what was read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.basics import (
    NOTHING,
    Cell,
    Columns,
    Estimated,
    Section,
    Table,
    bracketed,
    column,
    distinct,
    estimate,
    grouped,
    listed,
    matching,
    of,
    possessive,
    short,
    side_by_side,
    table_of,
    value,
)
from percept.report.decisions import RENDERED, judged_verdicts
from percept.report.overview import misfits
from percept.results import (
    MOST_SHOWN,
    IntervalWithout,
    LeftOut,
    Note,
    Results,
    Verdict,
)
from percept.scene import Scene
from percept.sessions.records import Exclusion


def checks(results: Results) -> Section:
    """Return the section of checks."""
    return Section(
        "checks",
        "Checks",
        parts=[_sampling(results), _model(results), _people(results)],
        is_folded=True,
    )


def _sampling(results: Results) -> Section:
    """Return the measures behind the gate's verdict on the sampler, and the priors."""
    diagnostics = results.diagnostics
    if diagnostics is None:
        return Section("diagnostics")
    gate = diagnostics.gate
    sentences = ["The sampler’s checks passed: every Bayesian limit is as accurate as asked."]
    if not gate.passed:
        sentences = ["The sampler’s checks failed, and the Bayesian numbers are withheld."]
        sentences += gate.reasons
    elif not gate.tolerance_met:
        said = "The sampler’s checks passed, but it missed the tolerance."
        sentences = [f"{said} {gate.error_reached}"]
    measures = (
        ("Rank R̂ across ensembles, largest", gate.rhat, f"below {gate.rhat_limit}"),
        ("Autocorrelation time, longest (steps)", gate.autocorrelation_time, "finite"),
        ("Length of a kept run, in these times", gate.times_run, f"{gate.times_needed:g} or more"),
        ("Effective draws, fewest", gate.effective_draws, ""),
        ("Fraction of proposals accepted", gate.acceptance, ""),
        (
            "Monte Carlo error of limits, largest (half-widths)",
            gate.worst_error,
            f"{diagnostics.tolerance:g} or less",
        ),
    )
    columns: Columns = {"Measure": of("0"), "Value": of("1", 4), "Asked": of("2")}
    caption = (
        f"Diagnostics of the sampler: {diagnostics.ensembles} ensembles, {diagnostics.walkers}"
        f" walkers, {diagnostics.steps} steps."
    )
    priors = table_of(
        "Priors in force; the scene’s [model.priors] changes them.",
        diagnostics.priors,
        {"Prior": of("prior"), "Value": of("value", 4), "Meaning (unit)": of("meaning")},
    )
    measured = table_of(caption, measures, columns)
    return Section("diagnostics", "Sampling", sentences, [measured, priors])


def _model(results: Results) -> Section:
    """Return the checks of the model against data and priors."""
    record = results.checks
    if record is None:
        return Section("model")
    words = results.data.words
    sentences = []
    if record.loo:
        none = f"No {words.subject} lies far from what the others predict."
        sentences += list(misfits(results)) or [none]
    name: Columns = {capitalised(words.environment): str}
    normality = name | side_by_side(
        record.normality, "environment", ("parameter", "family"), of("p_value", 3)
    )
    normality_caption = (
        f"p of Shapiro–Wilk tests of the {possessive(words.subjects)} values (normal) and of their"
        " logarithms (lognormal), which classical intervals assume."
    )
    statistics = name | side_by_side(
        record.statistics, "environment", ("parameter", "statistic"), of("above", 3)
    )
    statistics_caption = (
        "Probability that a new study drawn from the posterior has a larger mean, SD or farthest"
        f" {words.subject}."
    )
    return Section(
        "model",
        "The model",
        sentences,
        [
            table_of(normality_caption, distinct(record.normality, "environment"), normality),
            table_of(statistics_caption, distinct(record.statistics, "environment"), statistics),
        ],
    )


def _people(results: Results) -> Section:
    """Return a row per subject, and what the average user's intervals are without some subject."""
    rows = results.data.people
    if not rows:
        return Section("people")
    words = results.data.words
    loo = results.checks.loo if results.checks else None
    columns: Columns = {capitalised(words.subject): str}
    for parameter, chosen in grouped(rows, "parameter").items():
        relative = chosen[0].relative
        unit = "" if relative else bracketed(chosen[0].unit)
        cells = {
            f"mean{unit}": of("mean", 2, "bias" if relative else "difference"),
            "SD": of("sd", 2, "percent" if relative else "plain"),
            "distance": of("distance", 2),
        }
        for head, cell in cells.items():
            columns[f"{parameter}, {head}"] = column(chosen, "subject", cell)
    logarithms = " (of logarithms)" if rows[0].log else ""
    caption = (
        f"What each {words.subject} {words.verb} over the {words.environments}: mean deviation from"
        f" the reference, SD{logarithms}, and distance from the others’ mean in their SDs."
    )
    if loo:
        columns["probability"] = column(loo.subjects, "subject", of("farther", 2))
        columns["Pareto k"] = column(loo.subjects, "subject", of("pareto_k", 2))
        caption += (
            " Probability: of lying as far off or farther, by the model. A Pareto k above"
            f" {short(loo.good_k, 2)} is too high for reweighting."
        )
    names = distinct(rows, "subject")
    if len(names) > MOST_SHOWN:
        caption += f" The {MOST_SHOWN} farthest of {len(names)}; the CSV has all."
        by_distance = sorted(rows, key=lambda row: -abs(row.distance or 0.0))
        names = distinct(by_distance, "subject")[:MOST_SHOWN]
    table = table_of(caption, names, columns, name="subjects")
    tables = [table, _without(results, loo)] if loo else [table]
    return Section("people", f"The {words.subjects}, one by one", tables=tables)


def _without(results: Results, loo: LeftOut) -> Table:
    """Return the average user's intervals without those who move the estimates most."""
    assert results.checks is not None
    words = results.data.words
    names = [check.subject for check in loo.subjects]

    def moved_most(row: IntervalWithout) -> Cell:
        whole = matching(
            results.intervals,
            environment=row.environment,
            parameter=row.parameter,
            kind="mean",
            method="bayesian",
            joint="marginal",
        )
        # A scene may ask for other kinds alone.
        index = _farthest(row.estimate, whole[0].estimate) if whole else None
        if index is None:
            return NOTHING
        without: list[Any] = [row.estimate[index], row.lower[index], row.upper[index]]
        return (*estimate(Estimated(*without)), f", {names[index]}")

    def judged(verdict: Verdict) -> Cell:
        index = _farthest(verdict.without, verdict.probability)
        if index is None:
            return NOTHING
        return (*value(verdict.without[index], 3, "percent"), f", {names[index]}")

    rows = results.checks.without
    columns: Columns = {capitalised(words.environment): str}
    for name, chosen in grouped(rows, "parameter").items():
        quantity = results.data.quantities[name]
        columns[quantity.head + bracketed(quantity.unit)] = column(
            chosen, "environment", moved_most
        )
    verdicts = judged_verdicts(results)
    if any(one.without for one in verdicts):
        columns[f"real, {RENDERED[verdicts[0].coupled]}"] = column(verdicts, "environment", judged)
    level = percent(results.provenance.scene["inference"]["level"])
    caption = (
        f"The average {words.user} (Bayesian, {level} limits), and the probability that the display"
        f" feels real, each without the {words.subject} named, who moves it most: by the weights of"
        " leave-one-out cross-validation."
    )
    untold = [one.subject for one in loo.subjects if one.pareto_k > loo.good_k]
    if untold:
        caption += f" Too few draws show what it is without {listed(untold, MOST_SHOWN)}."
    return table_of(caption, distinct(rows, "environment"), columns)


def _farthest(values: Sequence[float | None], whole: float) -> int | None:
    """Return the index of the known value that lies farthest from the whole."""
    known = {index: abs(one - whole) for index, one in enumerate(values) if one is not None}
    return max(known, key=known.__getitem__, default=None)


def data(results: Results) -> Section:
    """Return the section of the data and their provenance."""
    words = results.data.words
    read = results.data
    labels = {
        "subjects": words.subjects,
        "environments": words.environments,
        "empty cells (subject × environment)": (
            f"empty cells ({words.subject} × {words.environment})"
        ),
    }
    counts = [f"{labels.get(what, what)} {count}" for what, count in read.counts.items() if count]
    cells: Columns = {capitalised(words.environment): str}
    for name, chosen in grouped(read.cells, "parameter").items():
        unit = bracketed(chosen[0].unit)
        cells[f"{name}, {words.subjects}"] = column(chosen, "environment", of("n", style="count"))
        cells[f"{name}, mean{unit}"] = column(chosen, "environment", of("mean"))
        cells[f"{name}, SD{unit}"] = column(chosen, "environment", of("sd"))
    left_out: Columns = {
        "Who": of("who"),
        "What": of("what"),
        "Why": of("why"),
        "Where": _place,
    }
    caption = f"Values: {possessive(words.subjects)} means over their trials."
    sentences = [f"Read: {', '.join(counts)}."] if counts else []
    if not read.exclusions:
        sentences.append("No row was left out.")
    return Section(
        "data",
        "Data",
        [" ".join(sentences)],
        [
            table_of(caption, distinct(read.cells, "environment"), cells, csv="data"),
            table_of("What was left out, and why.", read.exclusions, left_out),
            _settings(results),
        ],
        parts=[
            Section("doubts", "To check; nothing is left out", _notes(read.doubts), form="list"),
            Section("notices", "How files were read", _notes(read.notices), form="list"),
            Section("provenance", "Provenance", [" ".join(_provenance(results))]),
            Section("skipped", "Not computed", _skipped(results), form="list"),
        ],
        is_folded=True,
    )


def _place(row: Exclusion | Note) -> str:
    """Name the file and line of a note."""
    if not row.file:
        return ""
    return row.file if row.row is None else f"{row.file}:{row.row}"


def _notes(notes: Sequence[Note]) -> list[str]:
    return [": ".join(filter(None, (_place(note), note.text))) for note in notes]


def _provenance(results: Results) -> Iterator[str]:
    """Say which versions, seed and files these results are of."""
    made = results.provenance
    versions = ", ".join(f"{name} {version}" for name, version in made.versions.items())
    yield f"Made with {versions}; seed {made.seed}."
    for file in made.files:
        yield f"{file.name}: {file.rows} rows, SHA-256 {file.sha256}."


def _settings(results: Results) -> Table:
    """Return every setting that is not the default."""
    scene = Scene(**results.provenance.scene)
    changed = scene.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
    lines: list[tuple[str, str]] = []
    for table, entries in changed.items():
        lines += [(f"{table}.{key}", str(setting)) for key, setting in entries.items()]
    columns: Columns = {"Key": of("0"), "Value": of("1")}
    return table_of("The scene, where it differs from the defaults.", lines, columns)


def _skipped(results: Results) -> list[str]:
    """Say what was asked for and not computed."""
    scene = results.provenance.scene
    unasked = [f"[{table}]" for table in ("device", "coupling") if not scene.get(table)]
    has_jnd = bool((scene.get("study") or {}).get("jnd"))
    sentences = []
    for row in results.skipped:
        is_asked = has_jnd or not row.what.startswith("JND")
        if is_asked and not any(table in row.why for table in unasked):
            sentences.append(f"{row.what}: {row.why}.")
    return sentences

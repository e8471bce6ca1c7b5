"""The results and methods as paragraphs to paste into a paper, and the works that they cite."""

from __future__ import annotations

import dataclasses
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib import resources

from percept import __version__
from percept.errors import capitalised, counted
from percept.inference.record import percent
from percept.report.basics import (
    KINDS,
    Section,
    distinct,
    family_of,
    gives_means,
    listed,
    makes_impedance,
    matching,
    percentage,
    possessive,
    present,
    short,
    without_ratios,
)
from percept.results import Results

_CLASSICAL = {
    "mean": "t-intervals of the mean",
    "user": "prediction intervals of the next {0}",
    "share": "exact two-sided tolerance intervals",
}


#: The key of a work, before it becomes a number.
_KEY = re.compile(r"\[\w+\]")


@dataclasses.dataclass(frozen=True)
class Reference:
    """A work to cite."""

    key: str
    entry: str  # Its type in BibTeX
    text: str  # For a list
    fields: dict[str, str]  # Of BibTeX


def methods(results: Results, paragraph: str) -> Section:
    """Return paragraphs to paste, and the references."""
    numbered = []
    for rank, reference in enumerate(cited(results), start=1):
        doi = reference.fields.get("doi")
        numbered.append(f"[{rank}] {reference.text}" + (f" doi:{doi}" if doi else ""))
    return Section(
        "methods",
        "Results and methods",
        parts=[
            Section("results", "Results", [paragraph] if paragraph else [], form="paste"),
            Section("paragraph", "Methods", methods_paragraph(results), form="paste"),
            Section("references", "References", numbered),
        ],
        is_folded=True,
    )


def methods_paragraph(results: Results) -> list[str]:
    """Say how the results were obtained, sentence by sentence, in the past tense of a paper."""
    ranks = {f"[{one.key}]": f"[{rank}]" for rank, one in enumerate(cited(results), start=1)}
    return [
        _KEY.sub(lambda found: ranks.get(found[0], found[0]), sentence)
        for sentence in _sentences(results)
    ]


def _sentences(results: Results) -> list[str]:
    """Return the sentences with the keys of works in square brackets."""
    sentences = [who_gave_what(results), *_fitted(results), *_compared(results)]
    return [sentence for sentence in [*sentences, *_displayed(results)] if sentence]


def who_gave_what(results: Results) -> str:
    """Say who gave the data, of what, and how often."""
    data = results.data
    words = data.words
    virtual = "virtual " if makes_impedance(results) else ""
    references = counted(data.references, virtual + words.environment, virtual + words.environments)
    if data.form != "trials":
        return f"The data are published limits, or means and SDs, of {references}."
    who = f"{data.subjects} {'simulated ' if data.simulated else ''}{words.subjects}"
    what = listed([quantity.label for quantity in data.quantities.values()])
    within, groups = _design(results)
    did = f"{words.verb} {what}"
    if makes_impedance(results):
        did = f"{words.verb} {what} to match {references}"
    elif data.references > 1 or not within:
        did += f" in {references}"
    at_each = f" at each of {within}" if within else ""
    return f"{who} {did}{at_each}{_repeats(results)}.{''.join(groups)}"


def _design(results: Results) -> tuple[str, list[str]]:
    """Name the levels of factors within subjects, and say how large groups are."""
    # Of several quantities the first has the same levels.
    every = matching(results.levels, parameter=results.data.parameters[0])
    within = []
    groups = []
    for factor in distinct(every, "factor"):
        levels = matching(every, factor=factor, environment=None)
        if levels and levels[0].within:
            within.append(f"{len(levels)} levels of {factor}")
            continue
        sizes = []
        for row in levels:
            # Some subjects lack references, and so an overall value.
            chosen = matching(every, factor=factor, level=row.level)
            values = zip(*(one.values for one in chosen), strict=True)
            count = sum(any(one is not None for one in of_subject) for of_subject in values)
            sizes.append(f"{row.level} {count}")
        subjects = capitalised(results.data.words.subjects)
        groups.append(f" {subjects} by {factor}: {', '.join(sizes)}.")
    return listed(within), groups


def _repeats(results: Results) -> str:
    """Say how many trials and sessions there were, and which cells have none."""
    design = results.data.design
    if design is None:
        return ""
    said = ", once each" if design.trials[1] == 1 else f", in {_span(design.trials)} trials each"
    if design.sessions[1] > 1:
        said += f" over {_span(design.sessions)} sessions"
    if design.missing:
        said += f" ({design.missing} of {design.cells} cells are empty)"
    return said


def _span(counts: tuple[int, int]) -> str:
    return " to ".join(dict.fromkeys(map(str, counts)))


def _fitted(results: Results) -> Iterator[str]:
    """Say which intervals there are, of which model."""
    words = results.data.words
    used = distinct(results.intervals, "method")
    kinds = present(KINDS, results.intervals, "kind")
    if not kinds:
        return
    what = "Realistic performance boundaries" if results.boundaries else "Intervals"
    boundaries = " [boundaries]" if makes_impedance(results) else ""
    yield f"{what}{boundaries} were derived with percept {__version__} [percept]."
    if "classical" in used:
        named = listed([_CLASSICAL[kind].format(words.user) for kind in kinds])
        families = {"normal"}
        absolute = without_ratios(results.intervals)
        for row in matching(results.intervals, method="classical"):
            # Lognormal limits of what has references of zero are in the tables alone.
            if row.parameter not in absolute:
                families.add(row.family)
        design = results.data.design
        repeats = ""
        if design and design.trials[1] > 1:
            repeats = f"; each {words.subject} counts once, by the mean of the trials"
        yield (
            f"Classical intervals are {named} [meeker2017], for"
            f" {' and for '.join(sorted(families, reverse=True))} values, each equal-tailed"
            f"{repeats}."
        )
    if "bayesian" in used:
        yield from _sampled(results)
    inference = results.provenance.scene["inference"]
    said = f"The level is {percent(inference['level'])}"
    if "share" in kinds:
        said += (
            f"; limits of a share of {words.users} hold {percent(inference['share'])} of them"
            f" with confidence {percent(inference['confidence'])}"
        )
    yield f"{said}."


def _sampled(results: Results) -> Iterator[str]:
    """Say which model was sampled, how, and how accurately."""
    model = results.provenance.scene["model"]
    sampler = (
        "emcee [emcee] by independent proposals and preconditioned Crank–Nicolson"
        " steps [cotter2013]"
    )
    if model["pooling"] == "partial":
        response = "logarithm of the ratio of adjustment to reference"
        if family_of(results) != "lognormal":
            response = "value" if gives_means(results) else "deviation from the reference"
            response += f" ({_scaled(results)})"
        yield (
            f"Bayesian intervals come from a hierarchical model of the {response}:"
            f" {model_words(results)}. All locations were integrated out exactly; the scales and"
            f" correlations were sampled with {sampler}, and locations drawn from their conditional"
            " normal distribution."
        )
    else:
        yield (
            f"Bayesian intervals come from a model of each {results.data.words.environment} and"
            f" parameter by itself with the reference prior, sampled with {sampler}."
        )
    diagnostics = results.diagnostics
    if diagnostics is None:
        return
    gate = diagnostics.gate
    start = "Sampling went on until"
    reached = f"at most {diagnostics.tolerance:g} of its interval’s half-width"
    if not gate.tolerance_met and gate.worst_error is not None:
        start = "Sampling ended when"
        reached = (
            f"at most {short(gate.worst_error, 3)} of its interval’s half-width, where"
            f" {diagnostics.tolerance:g} was asked"
        )
    yield (
        f"{start} the Monte Carlo standard error of every limit of the Bayesian intervals was"
        f" {reached}, with rank R̂ [vehtari2021] below {gate.rhat_limit} across"
        f" {diagnostics.ensembles} separately seeded ensembles."
    )
    changed = [prior for prior in diagnostics.priors if prior.prior in model.get("priors", {})]
    if changed:
        said = listed([f"the {prior.meaning} was {short(prior.value, 4)}" for prior in changed])
        yield f"Of the priors, {said}; all others are percept’s defaults."
    else:
        yield "All priors are percept’s defaults."


def _compared(results: Results) -> Iterator[str]:
    """Say how levels of factors were compared."""
    rows = results.contrast
    if not rows:
        return
    words = results.data.words
    by = distinct(rows, "method")
    if results.levels and "classical" in by:
        measure = "log ratios" if family_of(results) == "lognormal" else "differences"
        how = []
        if matching(rows, within=True):
            how.append(
                f"paired t-intervals of the {measure} within each {words.subject}, and their"
                " spreads by Pitman’s and Morgan’s test"
            )
        if matching(rows, within=False):
            how.append("groups by Welch’s intervals, and their spreads by F intervals")
        factors = listed(distinct(results.levels, "factor"))
        yield f"Levels of {factors} were compared by {'; '.join(how)}."
    if results.anova:
        yield (
            f"Analysis of variance of the {possessive(words.subjects)} means tested all levels of a"
            " term at once, with Greenhouse’s and Geisser’s correction [greenhouse1959]."
        )
    if "bayesian" in by:
        yield "One hierarchical model of all cells gave the Bayesian contrasts."
    slopes = matching(rows, of="slope")
    if slopes:
        yield f"Covariates, about their means, were {listed(distinct(slopes, 'factor'))}."
    if chosen := distinct(matching(slopes, within=True), "factor"):
        yield f"Each {words.subject} has a slope of their own on {listed(chosen)}."


def _displayed(results: Results) -> Iterator[str]:
    """Say how boundaries and verdicts were computed, and for which device."""
    scene = results.provenance.scene
    words = results.data.words
    if results.boundaries:
        device = scene["device"]
        averages = device.get("hold", "average") == "average"
        hold = "an averaging hold" if averages else "the true zero-order hold"
        frequency = scene["frequency"]
        yield (
            f"Boundaries of |Z_h| were computed with Tustin’s discretization and {hold} at a"
            f" sampling period of {device['period']:g} s{_device(results)}, from"
            f" {frequency['lower']:g} to {frequency['upper']:g} rad/s."
        )
        if "velocity_filter" in device:
            low_pass = device["velocity_filter"]
            yield (
                "The damper that joins the device acts on a velocity behind a Butterworth filter"
                f" of {low_pass['cutoff']:g} rad/s and order {low_pass['order']}. Boundaries take k"
                " and b as adjusted."
            )
        errors = [curve.error for curve in results.boundaries if curve.error is not None]
        if errors:
            yield (
                "The tolerance applies to interval limits, not to curves: the Monte Carlo error of"
                " Bayesian simultaneous and pointwise curves reached up to"
                f" {percentage(max(errors), 2)} of half the band’s width."
            )
    if results.verdicts:
        verdict = results.verdicts[0]
        sure = "posterior probability" if verdict.method == "bayesian" else "classical confidence"
        yield (
            f"Each {words.environment} was said to feel real where what is displayed lies in the"
            f" central {percent(verdict.central)} range of {words.users} at every frequency, by"
            f" |Z_h| and by effective stiffness and damping, with a {sure} of"
            f" {percent(verdict.decision)} or more."
        )
    if results.coupling and scene.get("coupling"):
        yield (
            f"The virtual coupling ({results.coupling.stiffness:g} N/m,"
            f" {results.coupling.damping:g} N·s/m) was judged by Eq. 10, Llewellyn’s"
            f" criterion [adams1999]. What the device renders was judged in time,"
            f" with every passive hand [colgate1997]."
        )


def _device(results: Results) -> str:
    """Name the loop and the device that boundaries are of."""
    device = results.provenance.scene["device"]
    said = ""
    if device.get("delay"):
        said += f", with a loop delay of {device['delay']:g} samples"
    elif device.get("delay_seconds"):
        said += f", with a loop delay of {device['delay_seconds']:g} s"
    if device.get("mass") is None:
        return f"{said} for the measured impedance of the device"
    said += f" for a device of {device['mass']:g} kg and {device['damping']:g} N·s/m"
    if device.get("stiffness"):
        said += f" on a spring of {device['stiffness']:g} N/m"
    if device.get("modes"):
        said += f" with {counted(len(device['modes']), 'flexible mode')}"
    return said


def _scaled(results: Results) -> str:
    """Say in what the responses of the normal family are measured."""
    scales = results.provenance.scene["model"]["scale"]
    parts = []
    absolute = without_ratios(results.intervals)
    for name, quantity in results.data.quantities.items():
        size = quantity.amount(scales[name]) if name in scales else "its unit"
        if name not in absolute:
            size = "the reference"
        parts.append(f"{quantity.label} over {size}")
    return listed(parts)


def model_words(results: Results) -> str:
    """Say what the hierarchical model is made of; data and scene leave parts of it out."""
    model = results.provenance.scene["model"]
    words = results.data.words
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
    in_force = results.diagnostics.priors if results.diagnostics else ()
    if matching(in_force, prior="sigma_trend_scale"):
        parts.append(f"a trend over the reference for each {words.subject}")
    scatter = f"between-{words.subject} scatter"
    if several and model["common_spread"]:
        scatter += f" equal in all {words.environments}"
    elif several:
        scatter += f" within each {words.environment}"
    if several and model["weber"]:
        scatter += (
            f", in proportion to the reference but for each {words.environment}’s own deviation"
        )
    if matching(in_force, prior="omega_s_scale"):
        scatter += f", with trial SDs that differ between {words.subjects}"
    by_itself = f" ({' and '.join(names)} each by itself)" if pair and not sessions else ""
    return f"{', '.join(parts)}, and {scatter}{by_itself}"


def _trend(results: Results) -> str:
    """Say what joins the biases: no reference of zero or below has a logarithm."""
    trend = "a regression of bias on the logarithm of the reference"
    quantities = results.data.quantities
    absolute = without_ratios(results.intervals)
    relative = [quantity.label for name, quantity in quantities.items() if name not in absolute]
    if len(relative) == len(quantities):
        return trend
    return f"{trend} ({listed(relative)}) or a common bias" if relative else "a common bias"


@cache
def _references() -> tuple[Reference, ...]:
    """Return works to cite, in order."""
    text = resources.files("percept.report").joinpath("references.toml").read_text(encoding="utf-8")
    tables = tomllib.loads(text.replace("{version}", __version__))
    return tuple(Reference(key, **table) for key, table in tables.items())


def cited(results: Results) -> list[Reference]:
    """Return what the methods paragraph of results cites, in order."""
    keys = dict.fromkeys(_KEY.findall(" ".join(_sentences(results))))
    works = {f"[{reference.key}]": reference for reference in _references()}
    return [works[key] for key in keys if key in works]


def bibtex(results: Results) -> str:
    """Return the BibTeX entries of what results cite."""
    entries = []
    for reference in cited(results):
        fields = ",\n".join(f"  {name} = {{{value}}}" for name, value in reference.fields.items())
        entries.append(f"@{reference.entry}{{{reference.key},\n{fields}\n}}\n")
    return "\n".join(entries)

"""The results and methods as paragraphs to paste into a paper, and the works that they cite."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import resources
from typing import Any

from percept import __version__
from percept.errors import capitalised, counted
from percept.inference.record import percent
from percept.report.contrast import design_words
from percept.report.numbers import percentage, short
from percept.report.sections import Section
from percept.report.select import (
    KINDS,
    compared_by_difference,
    distinct,
    family_of,
    gives_means,
    listed,
    makes_impedance,
    matching,
    ordered,
    words_of,
)
from percept.results import Results

__all__ = ["Reference", "bibtex", "cited", "methods", "methods_paragraph", "who_gave_what"]

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


def methods(results: Results, paragraph: str) -> Section:
    """Return paragraphs to paste, and the references."""
    works = [
        f"{reference.text} doi:{reference.fields['doi']}" if "doi" in reference.fields
        else reference.text
        for reference in cited(results)
    ]  # fmt: skip
    numbered = [f"[{rank}] {text}" for rank, text in enumerate(works, start=1)]
    return Section(
        "methods",
        "Results and methods, ready to paste",
        parts=[
            Section("results", "Results", [paragraph] if paragraph else [], form="paste"),
            Section("paragraph", "Methods", methods_paragraph(results), form="paste"),
            Section("references", "References", numbered),
        ],
        is_folded=True,
    )


def methods_paragraph(results: Results) -> list[str]:
    """Say how the results were obtained, sentence by sentence, in the past tense of a paper."""
    sentences = [who_gave_what(results), *_fitted(results), *_compared(results)]
    return [sentence for sentence in [*sentences, *_displayed(results)] if sentence]


def _cite(results: Results, key: str) -> str:
    """Return the number of a work in square brackets."""
    keys = [reference.key for reference in cited(results)]
    return f" [{keys.index(key) + 1}]" if key in keys else ""


def who_gave_what(results: Results) -> str:
    """Say who gave the data, of what, and how often."""
    data = results.data
    words = words_of(results)
    references = f"{data.references} {words.environments}"
    if data.references == 1:
        references = f"one {words.environment}"
    if data.form != "trials":
        return f"The data are published limits, or means and SDs, of {references}."
    simulated = "simulated " if data.simulated else ""
    who = f"{data.subjects} {simulated}{words.subject if data.subjects == 1 else words.subjects}"
    what = listed([quantity.label for quantity in data.quantities.values()])
    if gives_means(results):
        did = f"gave {what} in {references}"
    elif makes_impedance(results):
        did = (
            f"adjusted the {what} of virtual {words.environments} until they felt like {references}"
        )
    else:
        did = "adjusted" if words.verb == "set" else words.verb
        did = f"{did} the {what} to the references of {references}"
    design = design_words(results)
    within = f" at each of {design.within}" if design.within else ""
    groups = "".join(f" They were {group}." for group in design.groups)
    return f"{who} {did}{within}{_repeats(results)}.{groups}"


def _repeats(results: Results) -> str:
    """Say how many trials and sessions there were, and which cells have none."""
    design = results.data.design
    if design is None:
        return ""
    words = words_of(results)
    said = ", once each" if design.trials[1] == 1 else f", in {_span(design.trials)} trials each"
    if design.sessions[1] > 1:
        said += f" over {_span(design.sessions)} sessions"
    if design.missing:
        said += f" ({design.missing} of {design.cells} cells of {words.a_subject} are empty)"
    return said


def _span(counts: tuple[int, int]) -> str:
    return f"{counts[0]}" if counts[0] == counts[1] else f"{counts[0]} to {counts[1]}"


def _fitted(results: Results) -> Iterator[str]:
    """Say which intervals there are, of which model."""
    words = words_of(results)
    used = distinct(results.intervals, "method")
    kinds = ordered(KINDS, results.intervals, "kind")
    inference = results.provenance.scene["inference"]
    what = "Realistic performance boundaries" if results.boundaries else "Intervals"
    if kinds:
        cite = _cite(results, "boundaries")
        yield f"{what}{cite} were derived with percept {__version__}{_cite(results, 'percept')}."
    if "classical" in used:
        named = listed([_CLASSICAL[kind].format(words.user) for kind in kinds])
        families = " and for ".join(_classical_families(results))
        design = results.data.design
        repeats = ""
        if design and design.trials[1] > 1:
            repeats = f"; {words.a_subject} counts once, by the mean of the trials"
        yield (
            f"Classical intervals are {named}{_cite(results, 'meeker2017')}, for {families} values,"
            f" each equal-tailed{repeats}."
        )
    if "bayesian" in used:
        yield from _sampled(results)
    if kinds:
        said = f"The level is {percent(inference['level'])}"
        if "share" in kinds:
            said += (
                f"; limits of a share of {words.users} hold {percent(inference['share'])} of them"
                f" with confidence {percent(inference['confidence'])}"
            )
        yield f"{said}."


def _classical_families(results: Results) -> list[str]:
    """Return the families of the classical intervals that the page shows."""
    rows = matching(results.intervals, method="classical")
    # Lognormal limits of what has references of zero are in the tables alone.
    differences = compared_by_difference(rows)
    families = {row.family for row in rows if row.parameter not in differences} | {"normal"}
    return sorted(families, reverse=True)


def _sampled(results: Results) -> Iterator[str]:
    """Say which model was sampled, how, and how accurately."""
    scene = results.provenance.scene
    words = words_of(results)
    sampler = (
        f"emcee{_cite(results, 'emcee')} by independent proposals and preconditioned Crank–Nicolson"
        f" steps{_cite(results, 'cotter2013')}"
    )
    if scene["model"]["pooling"] == "partial":
        response = "logarithm of the ratio of adjustment to reference"
        if family_of(results) != "lognormal":
            response = _deviation(results)
        yield (
            f"Bayesian intervals come from a hierarchical model of the {response}:"
            f" {model_words(results)}. All locations were integrated out exactly; the scales and"
            f" correlations were sampled with {sampler}, and locations drawn from their conditional"
            " normal distribution."
        )
    else:
        yield (
            f"Bayesian intervals come from a model of each {words.environment} and parameter by"
            f" itself with the reference prior, sampled with {sampler}."
        )
    diagnostics = results.diagnostics
    if diagnostics is None:
        return
    gate = diagnostics.gate
    tolerance = f"{scene['inference']['tolerance']:g}"
    reached = f"at most {tolerance} of its interval’s half-width"
    start = "Sampling went on until"
    if not gate.tolerance_met and gate.worst_error is not None:
        start = "Sampling ended when"
        reached = (
            f"at most {short(gate.worst_error, 3)} of its interval’s half-width, where {tolerance}"
            " was asked"
        )
    yield (
        f"{start} the Monte Carlo standard error of every limit of the Bayesian intervals was"
        f" {reached}, with rank R̂{_cite(results, 'vehtari2021')} below {gate.rhat_limit} across"
        f" {diagnostics.ensembles} separately seeded ensembles."
    )
    changed = scene["model"].get("priors", {})
    said = [
        f"the {prior.meaning} was {short(prior.value, 4)}"
        for prior in diagnostics.priors
        if prior.prior in changed
    ]
    if said:
        yield f"Of the priors, {listed(said)}; all others are percept’s defaults."
    elif diagnostics.priors:
        yield "All priors are percept’s defaults."


def _compared(results: Results) -> Iterator[str]:
    """Say how levels of factors were compared."""
    rows = results.contrast
    if not rows:
        return
    words = words_of(results)
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
            f"Analysis of variance of the {words.subjects}’ means tested all levels of a term at"
            f" once, with Greenhouse’s and Geisser’s correction{_cite(results, 'greenhouse1959')}."
        )
    if "bayesian" in by:
        yield "One hierarchical model of all cells gave the Bayesian contrasts."
    design = design_words(results)
    if design.covariates:
        yield f"Covariates, about their means, were {design.covariates}."
    if design.own_slopes:
        yield f"Each {words.subject} has a slope of their own on {design.own_slopes}."


def _displayed(results: Results) -> Iterator[str]:
    """Say how boundaries and verdicts were computed, and for which device."""
    scene = results.provenance.scene
    words = words_of(results)
    if results.boundaries:
        frequency = scene["frequency"]
        hold = "an averaging hold"
        if scene["device"].get("hold", "average") != "average":
            hold = "the true zero-order hold"
        yield (
            f"Boundaries of |Z_h| were computed with Tustin’s discretization and {hold} at a"
            f" sampling period of {scene['device']['period']:g} s{_device(scene['device'])}, from"
            f" {frequency['lower']:g} to {frequency['upper']:g} rad/s."
        )
        if "velocity_filter" in scene["device"]:
            low_pass = scene["device"]["velocity_filter"]
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
            f"{capitalised(words.a_environment)} was said to feel real where what is displayed lies"
            f" in the central {percent(verdict.central)} range of {words.users} at every frequency,"
            f" by |Z_h| and by effective stiffness and damping, with a {sure} of"
            f" {percent(verdict.decision)} or more."
        )
    if results.coupling and scene.get("coupling"):
        yield (
            f"The virtual coupling ({results.coupling.stiffness:g} N/m,"
            f" {results.coupling.damping:g} N·s/m) was judged by Eq. 10, Llewellyn’s"
            f" criterion{_cite(results, 'adams1999')}. What the device renders was judged in time,"
            f" with every passive hand{_cite(results, 'colgate1997')}."
        )


def _device(device: Mapping[str, Any]) -> str:
    """Name the loop and the device that boundaries are of."""
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


def model_words(results: Results) -> str:
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
    used = distinct(results.intervals, "method")
    needed = {"percept"}
    if makes_impedance(results):
        needed.add("boundaries")
    if "classical" in used:
        needed.add("meeker2017")
    if "bayesian" in used:
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

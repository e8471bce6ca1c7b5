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
    grouped,
    listed,
    makes_impedance,
    matching,
    percentage,
    possessive,
    present,
    short,
    without_ratios,
)
from percept.results import Diagnostics, Results

_CLASSICAL = {
    "mean": "t-intervals of the mean",
    "user": "prediction intervals of the next {0}",
    "share": "exact two-sided tolerance intervals",
}
#: Parts of the hierarchical model, by the prior that a model with this part has.
_MODEL = {
    "alpha_sd": "a common bias",
    "gamma_sd": "a regression of bias on the logarithm of the reference",
    "tau_scale": "a deviation for each {environment}",
    "lambda_sd": "differences between the levels of factors",
    "covariate_sd": "slopes on covariates",
    "sigma_u_scale": "effects of each {subject}",
    "sigma_trend_scale": "a trend over the reference for each {subject}",
    "log_s_sd": "scatter between {subjects} within each {environment}",
    "kappa_sd": "a trend of this scatter over the reference",
    "log_s_e_sd": "scatter between trials",
    "omega_s_scale": "trial SDs that differ between {subjects}",
    "rho_shape": "correlations of the quantities",
}

#: What the device has, by the keys of a scene's `[device]`.
_DEVICE = {
    "mass": "a mass of {:g} kg",
    "damping": "a damping of {:g} N·s/m",
    "stiffness": "a spring of {:g} N/m",
    "modes": "flexible modes ({})",
    "response": "the measured impedance of {}",
    "period": "a sampling period of {:g} s",
    "hold": "the {} hold",
    "delay": "a delay of {:g} samples",
    "delay_seconds": "a delay of {:g} s",
    "velocity_filter": "a velocity filter (Butterworth, {0[cutoff]:g} rad/s, order {0[order]})",
}
#: The key of a work, in square brackets.
_KEY = re.compile(r"\[(\w+)\]")


@dataclasses.dataclass(frozen=True)
class Reference:
    """A work to cite."""

    key: str
    entry: str  # Its type in BibTeX
    text: str  # For a list
    fields: dict[str, str]  # Of BibTeX


def methods(results: Results, paragraph: str) -> Section:
    """Return paragraphs to paste, and the references."""
    references = []
    for work in cited(results):
        doi = work.fields.get("doi")
        references.append(f"[{work.key}] {work.text}" + (f" doi:{doi}" if doi else ""))
    return Section(
        "methods",
        "Results and methods",
        parts=[
            Section("results", "Results", [paragraph] if paragraph else [], form="paste"),
            Section("paragraph", "Methods", methods_paragraph(results), form="paste"),
            Section("references", "References", references),
        ],
        is_folded=True,
    )


def methods_paragraph(results: Results) -> list[str]:
    """Say how the results were obtained, sentence by sentence, in the past tense of a paper.

    Works are cited by their keys in references.bib.
    """
    return [
        who_gave_what(results),
        *_fitted(results),
        *_compared(results),
        *_displayed(results),
    ]


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
    for factor, rows in grouped(every, "factor").items():
        levels = matching(rows, environment=None)
        if levels and levels[0].within:
            within.append(f"{len(levels)} levels of {factor}")
            continue
        sizes = []
        for row in levels:
            # Some subjects lack references, and so an overall value.
            chosen = matching(rows, level=row.level)
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
    trials = " to ".join(dict.fromkeys(map(str, design.trials)))
    sessions = " to ".join(dict.fromkeys(map(str, design.sessions)))
    said = ", once each" if trials == "1" else f", in {trials} trials each"
    if sessions != "1":
        said += f" over {sessions} sessions"
    if design.missing:
        said += f" ({design.missing} of {design.cells} cells are empty)"
    return said


def _fitted(results: Results) -> Iterator[str]:
    """Say which intervals there are, and by which model."""
    words = results.data.words
    kinds = present(KINDS, results.intervals, "kind")
    if not kinds:
        return
    what = "Realistic performance boundaries" if results.boundaries else "Intervals"
    boundaries = " [boundaries]" if makes_impedance(results) else ""
    yield f"{what}{boundaries} were derived with percept {__version__} [percept]."
    if matching(results.intervals, method="classical"):
        named = listed([_CLASSICAL[kind].format(words.user) for kind in kinds])
        families = " and for ".join(dict.fromkeys((family_of(results), "normal")))
        design = results.data.design
        repeats = ""
        if design and design.trials[1] > 1:
            repeats = f"; each {words.subject} counts once, by the mean of the trials"
        yield (
            f"Classical intervals are {named} [meeker2017], for {families} values, each"
            f" equal-tailed{repeats}."
        )
    if matching(results.intervals, method="bayesian") and results.diagnostics:
        yield from _sampled(results, results.diagnostics)
    inference = results.provenance.scene["inference"]
    said = f"The level is {percent(inference['level'])}"
    if "share" in kinds:
        said += (
            f"; limits of a share of {words.users} hold {percent(inference['share'])} of them"
            f" with confidence {percent(inference['confidence'])}"
        )
    yield f"{said}."


def _sampled(results: Results, diagnostics: Diagnostics) -> Iterator[str]:
    """Say which model was sampled, how, and how accurately."""
    sampler = (
        "emcee [emcee] by independent proposals and preconditioned Crank–Nicolson"
        " steps [cotter2013]"
    )
    if diagnostics.priors:
        response = "logarithm of the ratio of adjustment to reference"
        if family_of(results) != "lognormal":
            response = "value" if gives_means(results) else "deviation from the reference"
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
    gate = diagnostics.gate
    reached = max(gate.worst_error, diagnostics.tolerance)
    yield (
        "Sampling ended when the Monte Carlo standard error of every limit of the Bayesian"
        f" intervals was at most {short(reached)} of its interval’s half-width"
        f" ({diagnostics.tolerance:g} was asked), with rank R̂ [vehtari2021] below"
        f" {gate.rhat_limit} across {diagnostics.ensembles} separately seeded ensembles."
    )
    given = results.provenance.scene["model"].get("priors", {})
    changed = [f"{one.prior} = {short(one.value, 4)}" for one in diagnostics.priors]
    changed = [said for said in changed if said.partition(" ")[0] in given]
    but = f" but for {listed(changed)}" if changed else ""
    yield f"All priors are percept’s defaults{but}."


def model_words(results: Results) -> str:
    """Say what the hierarchical model is made of, by the priors in force."""
    in_force = distinct(results.diagnostics.priors if results.diagnostics else (), "prior")
    parts = [said for prior, said in _MODEL.items() if prior in in_force]
    if without_ratios(results.intervals) >= results.data.quantities.keys():
        # References of zero and below have no logarithm, and no trend.
        parts = [said for said in parts if "reference" not in said]
    return listed(parts).format(**vars(results.data.words))


def _compared(results: Results) -> Iterator[str]:
    """Say how levels of factors were compared."""
    rows = results.contrast
    subjects = results.data.words.subjects
    factors = listed(distinct(results.levels, "factor"))
    if factors and matching(rows, method="classical"):
        measure = "log ratios" if family_of(results) == "lognormal" else "differences"
        how = []
        if matching(rows, within=True):
            how.append(
                f"paired t-intervals of the {subjects}’ own {measure}, and their spreads by"
                " Pitman’s and Morgan’s test"
            )
        if matching(rows, within=False):
            how.append("groups by Welch’s intervals, and their spreads by F intervals")
        yield f"Levels of {factors} were compared by {'; '.join(how)}."
    if results.anova:
        yield (
            f"Analysis of variance of the {possessive(subjects)} means tested all levels of a"
            " term at once, with Greenhouse’s and Geisser’s correction [greenhouse1959]."
        )
    if matching(rows, method="bayesian"):
        yield "One hierarchical model of all cells gave the Bayesian contrasts."


def _displayed(results: Results) -> Iterator[str]:
    """Say how boundaries and verdicts were computed, and for which device."""
    scene = results.provenance.scene
    words = results.data.words
    if results.boundaries:
        device = scene["device"]
        described = [
            text.format(len(device[name]) if name == "modes" else device[name])
            for name, text in _DEVICE.items()
            if device.get(name)
        ]
        yield (
            "Boundaries of |Z_h| were computed with Tustin’s discretization from"
            f" {scene['frequency']['lower']:g} to {scene['frequency']['upper']:g} rad/s. The"
            f" device has {listed(described)}."
        )
        if "velocity_filter" in device:
            yield "Boundaries leave the velocity filter out: k and b are as adjusted."
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
    if results.coupling:
        yield (
            f"The virtual coupling ({results.coupling.stiffness:g} N/m,"
            f" {results.coupling.damping:g} N·s/m) was judged by Eq. 10, Llewellyn’s"
            f" criterion [adams1999]. What the device renders was judged in time,"
            f" with every passive hand [colgate1997]."
        )


@cache
def _references() -> dict[str, Reference]:
    """Return works to cite, by their keys."""
    text = resources.files("percept.report").joinpath("references.toml").read_text(encoding="utf-8")
    tables = tomllib.loads(text.replace("{version}", __version__))
    return {key: Reference(key, **table) for key, table in tables.items()}


def cited(results: Results) -> list[Reference]:
    """Return what the methods paragraph of results cites, in order."""
    keys = dict.fromkeys(_KEY.findall(" ".join(methods_paragraph(results))))
    works = _references()
    return [works[key] for key in keys if key in works]


def bibtex(results: Results) -> str:
    """Return the BibTeX entries of what results cite."""
    entries = []
    for reference in cited(results):
        fields = ",\n".join(f"  {name} = {{{value}}}" for name, value in reference.fields.items())
        entries.append(f"@{reference.entry}{{{reference.key},\n{fields}\n}}\n")
    return "\n".join(entries)

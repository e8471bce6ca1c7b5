"""What can be rendered, what of it feels real, and what to do next: sentences that decide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from percept.boundary.feels_real import FEWEST_FOR_MAGNITUDE, judge
from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.basics import (
    METHOD_NAMES,
    MOST_NAMED,
    distinct,
    grouped,
    listed,
    matching,
    short,
    spanned,
)
from percept.report.biases import drawn_said
from percept.results import (
    ConfirmedCoupling,
    Rendered,
    Results,
    Verdict,
    Words,
)

#: How an environment is displayed, by whether it is through the coupling.
RENDERED = {False: "directly", True: "through the coupling"}
_WAYS = {False: "Displayed directly", True: "Through this coupling"}
#: What a verdict is called in a table.
FEELINGS = {
    "feels real": "feels real",
    "does not": "does not feel real",
    "too little data": "not decided",
}
#: Outcomes in the order of a sentence: what is said of one environment, and of several.
_SAID = {
    "feels real": ("{} feels real", "{} feel real"),
    "does not": ("{} does not feel real", "{} do not feel real"),
    "too little data": ("for {} the data do not decide", "for {} the data do not decide"),
}
_ALMOST_CERTAIN = 0.995  # from here on a probability in whole per cents would be 100
_KILO = 1e3  # N/m in kN/m
_MOST_SPANS = 2  # couplings' ends in a sentence; a table has all


def _probability_said(probability: float, decision: float) -> str:
    """Write a probability in per cent, with the digits that keep it on its side of the decision."""
    outcome = judge(probability, decision)
    for digits in range(2, 6):
        shown = round(probability, digits)
        if judge(shown, decision) == outcome:
            break
    if shown > _ALMOST_CERTAIN:
        return "> 99 %"
    return f"{100.0 * shown:.6g} %" if shown > 1.0 - _ALMOST_CERTAIN else "< 1 %"


def _named(names: Sequence[str], words: Words, every: int = 0) -> str:
    """Name environments; count many of them."""
    if 2 < len(names) == every:
        return f"all {every}"
    return listed(names) if len(names) <= MOST_NAMED else f"{len(names)} {words.environments}"


def _is_coupled(results: Results) -> bool:
    """Say whether there is a coupling, which sentences are then about."""
    rendering = matching(results.rendering or (), coupled=True)
    return bool(rendering or matching(results.verdicts, coupled=True))


def _rendering(results: Results) -> list[Rendered]:
    """Return what is rendered, through the coupling where there is one, without rigid walls."""
    rows = matching(results.rendering or (), coupled=_is_coupled(results))
    return [row for row in rows if row.environment is not None]


def _names(rows: Sequence[Rendered], verdict: str) -> list[str]:
    return [str(row.environment) for row in matching(rows, verdict=verdict)]


def judged_verdicts(results: Results) -> list[Verdict]:
    """Return the verdicts on what can be rendered, through the coupling where there is one."""
    verdicts = matching(results.verdicts, coupled=_is_coupled(results))
    # Without rendering nothing is known against it.
    if not results.rendering:
        return verdicts
    names = _names(_rendering(results), "can")
    return [verdict for verdict in verdicts if verdict.environment in names]


def feeling_sentences(results: Results) -> list[str]:
    """Say what can be rendered, what of it feels real by which method, and how many more decide.

    Through the coupling where there is one. Where the methods disagree both are named.
    """
    judged = judged_verdicts(results)
    sentences = [_rendered_said(results)] if results.rendering else []
    if judged:
        outcomes = {row.environment: (row.outcome, row.probability) for row in judged}
        words = results.data.words
        said = _felt(outcomes, judged, words)
        # Names stay as they are written.
        if said.startswith(("for ", "all ")):
            said = capitalised(said)
        sentences.append(f"{said}.")
        sentences += [*_disagreeing(judged, words), *_deciding(judged, words)]
    return sentences


def _rendered_said(results: Results) -> str:
    """Say which environments can be rendered with every hand."""
    words = results.data.words
    rows = _rendering(results)
    way = _WAYS[_is_coupled(results)]
    names = _names(rows, "can")
    unknown = _names(rows, "undecided")
    if len(unknown) == len(rows):
        return f"{way}, the device’s table does not tell what can be rendered."
    if not names and len(rows) == 1:
        return f"{way}, {rows[0].environment} cannot be rendered with every hand."
    some = f"only {_named(names, words)}" if names else f"none of {len(rows)} {words.environments}"
    if len(names) == len(rows):
        some = f"all {len(names)} {words.environments}" if len(names) > 1 else names[0]
    said = f"{way}, {some} can be rendered with every hand"
    if unknown:
        said += f"; for {_named(unknown, words)} the device’s table does not tell"
    return f"{said}."


def _felt(
    outcomes: Mapping[str, tuple[str, float]], judged: Sequence[Verdict], words: Words
) -> str:
    """Say which environments have which outcome, with probabilities."""
    groups = []
    for outcome, forms in _SAID.items():
        chosen = {name: chance for name, (found, chance) in outcomes.items() if found == outcome}
        if chosen:
            said = forms[len(chosen) > 1].format(_named(list(chosen), words, len(judged)))
            shown = [_probability_said(chance, judged[0].decision) for chance in chosen.values()]
            groups.append(f"{said} ({spanned(list(chosen.values()), shown)})")
    return "; ".join(groups)


def _disagreeing(judged: Sequence[Verdict], words: Words) -> list[str]:
    """Say where the classical method comes to another outcome than the Bayesian one."""
    others = {}
    for verdict in judged:
        classical = verdict.classical
        if classical and verdict.bayesian and classical.outcome != verdict.bayesian.outcome:
            others[verdict.environment] = (classical.outcome, classical.probability)
    said = _felt(others, judged, words)
    return [f"That is the Bayesian answer; by the classical method, {said}."] if said else []


def _deciding(judged: Sequence[Verdict], words: Words) -> list[str]:
    """Say how many more subjects would decide what the data do not."""
    needed = {verdict.environment: verdict.more for verdict in judged if verdict.more}
    counts = {name: more.subjects for name, more in needed.items() if more.subjects}
    too_many = [name for name in needed if name not in counts]
    sentences = []
    if counts:
        shown = [f"{float(f'{count:.2g}'):,.0f}" for count in counts.values()]
        numbers = spanned(list(counts.values()), shown)
        several = words.subject if numbers == "1" else words.subjects
        which = _named(list(counts), words)
        sentences.append(f"To decide {which}, about {numbers} more {several}.")
    if too_many:
        which = _named(too_many, words)
        most = f"{needed[too_many[0]].most:,} {words.subjects}"
        sentences.append(f"{which} would take more than {most}.")
    return sentences


def doubtful_rendering(results: Results) -> list[str]:
    """Say what the device renders as stated, but not surely over its posterior."""
    rows = {row.environment: row.by_device for row in _rendering(results) if row.by_device}
    open_cases = []
    for verdict in judged_verdicts(results):
        by_device = rows.get(verdict.environment)
        if by_device and by_device.probability < verdict.decision:
            probability = _probability_said(by_device.probability, verdict.decision)
            open_cases.append(f"{verdict.environment} ({probability})")
    if not open_cases:
        return []
    way = RENDERED[_is_coupled(results)]
    return [
        f"What is known of the device leaves open whether it renders {listed(open_cases)} {way}: in"
        " brackets is how probably it does. Above, the device is as the scene states it."
    ]


def doubtful_verdicts(results: Results) -> list[str]:
    """Say which verdicts rest on few subjects, on the sampler's luck or on rows that look wrong."""
    words = results.data.words
    verdicts = judged_verdicts(results)
    sentences = []
    held = [
        verdict.environment
        for verdict in verdicts
        if verdict.outcome == "too little data" and verdict.subjects < FEWEST_FOR_MAGNITUDE
        if judge(verdict.probability, verdict.decision) == "does not"
    ]
    if held:
        sentences.append(
            f"With fewer than {FEWEST_FOR_MAGNITUDE} {words.subjects} only k or b can show that"
            f" {listed(held)} would not feel real."
        )
    for verdict in verdicts:
        evidence = verdict.bayesian
        if evidence and evidence.straddles:
            probability = short(100.0 * evidence.probability)
            sentences.append(
                f"The Monte Carlo error of {verdict.environment} {RENDERED[verdict.coupled]}"
                f" ({probability} ± {short(100.0 * evidence.error, 2)} %) still reaches over a"
                f" threshold after {evidence.draws} draws."
            )
        leaning = verdict.leaning
        if leaning is None:
            continue
        # The page's data say what is wrong with a row.
        rows = [f"row {one.row} of {one.file}" if one.row else one.text for one in leaning.rows]
        without = "that row" if len(rows) == 1 else "those rows"
        said = "there is no verdict"
        other = leaning.without
        if other is not None:
            said = _felt({other.environment: (other.outcome, other.probability)}, [other], words)
        sentences.append(
            f"The verdict on {verdict.environment} leans on {listed(rows)}. Without {without},"
            f" {said}."
        )
    return sentences


def device_sentence(results: Results) -> str:
    """Say how much damping the device lacks for what it cannot render."""
    rows = matching(_rendering(results), verdict="cannot")
    device = results.provenance.scene.get("device", {})
    if not rows or device.get("damping") is None or device.get("modes"):
        return ""
    names = [str(row.environment) for row in rows]
    needed = [row.needed_damping for row in rows]
    said = spanned(needed, [short(size) for size in needed])
    return (
        f"{_named(names, results.data.words)} would need a device with {said} N·s/m of damping;"
        f" this one has {device['damping']:g}."
    )


def coupling_sentences(results: Results) -> list[str]:
    """Name what some coupling makes feel real, of few with its ends, and what none does."""
    design = results.design
    if design is None:
        return []
    words = results.data.words
    spans = {}
    absent: list[str] = []
    unknown: list[str] = []
    for row in design.environments:
        if row.softest and row.stiffest:
            stiffest = "rigid" if row.stiffest.bound == "map" else _coupling(row.stiffest)
            spans[row.name] = f"{row.name} ({_coupling(row.softest)} to {stiffest})"
        else:
            (absent if row.outcome == "none" else unknown).append(row.name)
    sentences = []
    measure = "probability" if design.method == "bayesian" else "confidence"
    if spans:
        shown = list(spans.values() if len(spans) <= _MOST_SPANS else spans)
        said = f"couplings make {_named(shown, words)} feel real"
        if len(spans) > 1:
            one = _coupling(design.together) if design.together else "none of these ends"
            said += f"; {one} serves {'both' if len(spans) == 2 else 'all of them'}"
        sentences.append(f"With {percent(design.decision)} {measure}, {said}.")
    if absent:
        reached = f"{percent(design.decision)} {measure} of feeling real"
        sentences.append(f"For {_named(absent, words)}, no coupling reaches {reached}.")
    if unknown:
        sentences.append(
            f"Whether a coupling makes {_named(unknown, words)} feel real the data do not decide."
        )
    sentences.append(drawn_said(results))
    return [said for said in sentences if said]


def _coupling(coupling: ConfirmedCoupling) -> str:
    """Write a coupling: its damping belongs to its stiffness."""
    stiffness = short(coupling.stiffness / _KILO, 2)
    return f"{stiffness} kN/m with {short(coupling.damping, 2)} N·s/m"


def paper_rule(results: Results) -> list[str]:
    """Say what the rule "curve between curves" says, by the next user's exact envelope."""
    words = results.data.words
    memberships = results.coupling.memberships if results.coupling else ()
    rows = matching(memberships, kind="user")
    if not rows:
        return []
    ways = []
    for field, how in (("verdict_uncoupled", "directly"), ("verdict_coupled", RENDERED[True])):
        groups = [
            f"{inside} {_named(distinct(chosen, 'environment'), words)}"
            for inside, chosen in grouped(rows, field).items()
        ]
        ways.append(f"{how}, {'; '.join(groups)}")
    by = f"{METHOD_NAMES[rows[0].method]}, {rows[0].family}"
    return [
        "The paper’s rule asks another question: whether the curve of |Z_h| stays between the"
        f" curves of a boundary, which few {words.subjects} make wide. By the next {words.user}’s"
        f" exact envelope ({by}): {'; '.join(ways)}."
    ]

"""What the device displays: what it renders, what feels real, couplings, and other devices."""

from __future__ import annotations

from collections.abc import Callable

from percept.boundary.confidence import FEWEST_FOR_PAIR, PARTS
from percept.boundary.feels_real import FEWEST_FOR_MAGNITUDE
from percept.errors import capitalised
from percept.inference.record import percent
from percept.report.basics import (
    METHOD_NAMES,
    NOTHING,
    Cell,
    Columns,
    Section,
    Table,
    column,
    distinct,
    grouped,
    matching,
    of,
    percentage,
    plus_minus,
    short,
    table_of,
    value,
)
from percept.report.decisions import RENDERED, judged_verdicts, paper_rule
from percept.results import (
    ChangedVerdict,
    Coupling,
    Results,
    Verdict,
)

_RENDERS = {"can": "yes", "cannot": "no", "undecided": "undecided"}
_BOUNDS = {
    "stability": "stability",
    "magnitude": "|Z_h|",
    "plane": "k and b",
    "map": "nothing: it counts as rigid",
}


def display(results: Results) -> Section:
    """Return the section on the device and its coupling."""
    return Section(
        "display",
        "What the device displays",
        parts=[_rendering(results), _verdicts(results), _couplings(results)],
        is_folded=True,
    )


def _rendering(results: Results) -> Section:
    """Return what the device renders with every hand."""
    rows = results.rendering or ()
    if not rows:
        return Section("rendering")
    words = results.data.words
    sentences = [
        "A sampled loop works out a force from positions and holds it for a sample. Some passive"
        " hand makes the motion grow unless the device dissipates enough (Colgate and Schenkel"
        f" 1997). Where it does not, the {words.environment} may chatter, and {words.users} may set"
        " it wrongly."
    ]
    width = results.zwidth
    if width and width.edge:
        said = (
            "With every hand the device renders springs below"
            f" {short(width.edge.stiffest, 5)} N/m, and softer ones with damping."
        )
        if width.likely:
            stiffest = short(width.likely.stiffest, 5)
            said += f" 95 % of the devices of its posterior render up to {stiffest} N/m."
        sentences.append(said)
    columns: Columns = {capitalised(words.environment): lambda name: name or "a rigid wall"}
    for coupled, chosen in grouped(rows, "coupled").items():
        way = ", coupled" if coupled else ""
        cells = {
            capitalised(RENDERED[coupled]): lambda row: _RENDERS[row.verdict],
            f"needs (N·s/m){way}": of("needed_damping"),
            f"margin{way}": of("margin", 3),
            f"probability{way}": plus_minus("by_device.probability", "by_device.error"),
        }
        # Without delay and filter every row binds at Nyquist.
        if len(distinct(rows, "binding_omega")) > 1:
            cells[f"binds at ω (rad/s){way}"] = of("binding_omega")
        columns |= {head: column(chosen, "environment", cell) for head, cell in cells.items()}
    caption = (
        "Rendering with every hand, and the damping that a rigid device needs. Margin: what this"
        " one dissipates over what is asked."
    )
    if rows[0].by_device:
        caption += f" Probability over {rows[0].by_device.draws} devices of its posterior."
    if results.coupling:
        sentences.append(_eq10(results.coupling))
    names = distinct(rows, "environment")
    table = table_of(caption, names, columns, name="rendering")
    title = "What can be rendered with every hand"
    return Section("rendering", title, sentences, [table], ["stability"])


def centrals(results: Results) -> Table:
    """Return how probably what can be rendered lies in other central ranges."""
    words = results.data.words
    rows = [row for row in judged_verdicts(results) if row.bayesian]
    columns: Columns = {capitalised(words.environment): of("environment")}
    for index, one in enumerate(rows[0].bayesian.by_central if rows and rows[0].bayesian else ()):
        # The verdict's own share stands in the table above.
        if one.central != rows[0].central:
            probability = of(f"bayesian.by_central.{index}.probability", 3, "percent")
            columns[f"central {percent(one.central)}"] = probability
    way = capitalised(RENDERED[rows[0].coupled]) if rows else ""
    caption = f"{way}: probability of feeling real, for other central shares of {words.users}."
    return table_of(caption, rows, columns, name="centrals", csv="verdicts")


def _verdicts(results: Results) -> Section:
    """Return the verdicts of both methods by parts, and what the paper's rule says."""
    verdicts = results.verdicts
    if not verdicts:
        return Section("verdicts")
    words = results.data.words
    first = verdicts[0]
    sentences = [
        f"What is displayed feels real if it lies among the central {percent(first.central)} of"
        f" {words.users} at every ω: |Z_h|, effective stiffness and effective damping. At a"
        f" probability of {percent(first.decision)} or more it does, and at"
        f" {percent(1.0 - first.decision)} or less it does not.",
        *paper_rule(results),
    ]
    if first.subjects < FEWEST_FOR_MAGNITUDE:
        sentences.append(
            f"Wide limits of few {words.subjects} are no evidence: with fewer than"
            f" {FEWEST_FOR_MAGNITUDE} |Z_h| alone never says “does not”."
        )
    if results.data.form == "summary":
        sentences.append("Published limits hold no correlation: k and b vary independently here.")
    title = "Does what is displayed lie among what users set?"
    return Section("verdicts", title, sentences, [_by_parts(results)])


def _by_parts(results: Results) -> Table:
    """Return how sure both methods are of what can be rendered, together and by parts."""
    rows = judged_verdicts(results)
    if not rows:
        return Table()
    words = results.data.words
    columns: Columns = {
        capitalised(words.environment): of("environment"),
        "Bayesian: |Z_h|": plus_minus("bayesian.magnitude", "bayesian.error"),
        "k and b": of("bayesian.plane", 3, "percent"),
        "at ω (rad/s)": of("bayesian.lowest_omega", 3),
        "classical: k": of("classical.stiffness", 3, "percent"),
        "b": of("classical.damping", 3, "percent"),
        "|Z_h|": of("classical.magnitude", 3, "percent"),
        "at ω, rad/s": of("classical.magnitude_omega", 3),
        "all parts": plus_minus("classical.together", "classical.together_error"),
        f"more {words.subjects}": _more,
    }
    caption = (
        f"How sure it is that what is displayed {RENDERED[rows[0].coupled]} lies there, part by"
        " part, at the least favourable ω."
    )
    if "posterior" in results.provenance.scene.get("device", {}):
        columns["and rendered"] = of("stable_and_real", 3, "percent")
        caption += " Each draw has a device of its own."
    if any(row.classical for row in rows):
        refuted = (1.0 - rows[0].decision) / PARTS
        caption += (
            " Classically, the weakest of k, b and |Z_h| decides:"
            f" {percent(rows[0].decision)} or more is real, {percentage(refuted, 2)} or less is not"
            f" ({percentage(refuted / 2.0, 2)} where it lies on both sides of the mean"
            f" {words.user} over ω). “All parts” at once are less sure, and decide nothing."
            f" |Z_h| is approximate and needs {FEWEST_FOR_PAIR} {words.subjects}."
        )
    needed = [row.more for row in rows if row.more]
    if needed:
        sure = f"with probability {needed[0].assurance:g}"
        caption += f" The last column says how many more {words.subjects} would decide, {sure}."
    return table_of(caption, rows, columns, name="verdicts")


def _more(row: Verdict) -> Cell:
    """Return how many more subjects would decide."""
    if row.more is None:
        return NOTHING
    if row.more.subjects is None:
        return ("> ", *value(row.more.most, style="count"))
    return value(row.more.subjects, style="count")


def _eq10(coupling: Coupling) -> str:
    """Say whether the coupling meets Eq. 10, and by which margin."""
    said = (
        "Eq. 10 of the paper asks for absolute stability of two ports joined by velocities. It"
        " leaves out that sampled forces alias, and does not say what a sampled loop renders. For"
        f" the coupling of {coupling.stiffness:g} N/m and {coupling.damping:g} N·s/m it is"
        f" {coupling.eq10}. {coupling.eq10_reason}"
    )
    if coupling.required_damping is not None:
        said += f" A rigid device needs {short(coupling.required_damping, 5)} N·s/m."
    return said


def _couplings(results: Results) -> Section:
    """Return the map of couplings, and its ends."""
    design = results.design
    if design is None:
        return Section("design")
    words = results.data.words
    of_which = ", the share of fiducial draws" if design.method == "classical" else ""
    sentences = [
        f"A coupling is admissible where the device renders the {words.environment} through it"
        " with every hand, and the display feels real. Its probability has to lie two Monte Carlo"
        f" errors above {percent(design.decision)} ({METHOD_NAMES[design.method]}{of_which})."
        " There is none if every coupling lies two errors below."
    ]
    if design.devices:
        sentences.append(
            f"Probabilities are products: of being rendered, over {design.devices} devices of the"
            " posterior, and of feeling real with the device at its point."
        )
    ends = []
    for row in design.environments:
        for side, end in (("softest", row.softest), ("stiffest", row.stiffest)):
            if end is not None:
                ends.append((row.name, side, end))
    columns: Columns = {
        capitalised(words.environment): of("0"),
        "Coupling": of("1"),
        "k_c (N/m)": of("2.stiffness"),
        "b_c (N·s/m)": of("2.damping", 4),
        "Probability": plus_minus("2.probability", "2.error"),
        "Bounded by": lambda row: _BOUNDS[row[2].bound],
    }
    caption = "Softest and stiffest admissible coupling, confirmed at every ω; what fails beyond."
    table = table_of(caption, ends, columns, name="design")
    return Section(
        "design",
        "Which couplings feel real",
        [" ".join(sentences)],
        [table, _other_devices(results)],
        ["design"],
    )


def _other_devices(results: Results) -> Table:
    """Return how verdicts move with another mass or damping of the device."""
    others = results.sensitivity
    if others is None:
        return Table()
    columns: Columns = {capitalised(results.data.words.environment): of("environment")}
    for index in range(1, len(others.mass)):
        changed, unit = (others.mass, "kg") if index < 3 else (others.damping, "N·s/m")
        columns[f"{short(changed[index], 4)} {unit}"] = _with_device(index)
    caption = (
        "Half and 1.5 times the device’s mass and damping: probability of lying among users"
        f" {RENDERED[others.coupled]} ({METHOD_NAMES[others.method]}, {others.draws} draws or"
        " more). †: cannot be rendered with every hand; what none of them renders is left out."
    )
    rows = matching(others.verdicts, coupled=others.coupled)
    return table_of(caption, rows, columns, name="device")


def _with_device(index: int) -> Callable[[ChangedVerdict], Cell]:
    def cell(row: ChangedVerdict) -> Cell:
        probability = value(row.probability[index], 3, "percent")
        return probability if row.rendered[index] else (*probability, " †")

    return cell

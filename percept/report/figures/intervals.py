"""Intervals against their references: bars on axes, and the figure of each quantity."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from percept.report.figures.canvas import (
    COLOURS,
    GROUND,
    LETTER,
    MARKERS,
    REFERENCE_DASHES,
    Drawing,
    Frame,
    brief,
    common_range,
    legend,
    log_scale,
    mark,
    panels,
    row_labels,
)
from percept.report.figures.people import draw_subjects, subjects_of
from percept.report.select import (
    KINDS,
    METHOD_NAMES,
    METHODS,
    MOST_OPEN,
    Words,
    choice_said,
    chosen,
    clearest,
    compared_by_difference,
    distinct,
    families_of,
    first,
    kind_names,
    matching,
    words_of,
)
from percept.results import IntervalRow, Results
from percept.sessions.quantities import Quantity

__all__ = ["Bar", "BarAxis", "bars_of", "draw_intervals", "interval_drawings"]

#: Points, by what an interval covers: the narrower the interval, the thicker its bar.
_THICKNESS = {"mean": 3.2, "user": 1.6, "share": 0.7}
_BARS_SAID = {
    "mean": "Thick: the average {0.user}, with a mark at the estimate",
    "user": "thin: the next {0.user}",
    "share": "thinnest: a share of {0.users}",
}
# In rows, which stand one unit apart: bars share the upper part.
_TOP_OF_BARS = 0.38
_HEIGHT_OF_BARS = 0.72
#: Ends of the axis over each other, up to which labels stand close together without touching.
_SHORT_SPAN = 5.0
_LONG_SPAN = 1e3
#: Room at the ends of a logarithmic axis, a factor, and of a linear one, a share of its length.
_LOG_ROOM = 1.03
_LINEAR_ROOM = 0.02
# mm: the left margin is at least that of short names, and at most what leaves the bars half the
# width.
_LEAST_MARGIN = 12.0
_MOST_MARGIN = 26.0
#: mm, from a label to the axis and to the edge; other viewers' letters may be wider.
_BESIDE_LABEL = 4.0
#: mm on the right, for counts of subjects beyond the axis.
_COUNT_MARGIN = 9.0
_WIDTH = 86.0  # mm, half a page
_HEIGHT = 29.0  # mm, without rows
_ROW_HEIGHT = 2.8  # mm, without bars
_BAR_HEIGHT = 1.7  # mm


@dataclass(frozen=True, eq=False)
class Bar:
    """An interval to draw, divided by its reference, or less it in the quantity's unit."""

    environment: str
    kind: str
    method: str
    lower: float
    upper: float
    estimate: float


@dataclass(frozen=True)
class BarAxis:
    """What bars are drawn against."""

    relative: bool  # Bars are divided by their references; else they are less them
    log: bool  # Where the bars allow it

    @property
    def centre(self) -> float:
        """Where all references lie."""
        return 1.0 if self.relative else 0.0

    def label(self, adjusted: str, quantity: Quantity) -> str:
        """Return the label of the axis."""
        if self.relative:
            return f"{adjusted} / reference"
        unit = f" ({quantity.unit})" if quantity.unit else ""
        if not quantity.is_matched:
            return f"{quantity.label}{unit}"
        return f"{adjusted} − reference{unit}"

    def is_log(self, bars: Sequence[Bar]) -> bool:
        """Say whether the axis is logarithmic: some bar reaches above zero."""
        return self.log and self.relative and any(bar.upper > 0 for bar in bars)

    def ends(self, bars: Sequence[Bar]) -> tuple[float, float]:
        """Return the ends of the axis: one environment far out does not flatten the rest."""
        lows: list[float] = []
        highs: list[float] = []
        for name in distinct(bars, "environment"):
            group = matching(bars, environment=name)
            lows.append(min(bar.lower for bar in group))
            highs.append(max(bar.upper for bar in group))
        log = self.is_log(bars)
        low, high = common_range(lows, highs, log=log, centre=self.centre)
        margin = 0.0 if log else _LINEAR_ROOM * (high - low)
        return low - margin, high + margin

    def is_left_by(self, bars: Sequence[Bar]) -> bool:
        """Say whether some bar goes on beyond the axis."""
        left, right = self.ends(bars)
        return any(bar.lower < left or bar.upper > right for bar in bars)


def draw_intervals(
    ax: Axes,
    environments: Sequence[str],
    bars: Sequence[Bar],
    axis: BarAxis,
    *,
    kinds: Mapping[str, str],
    labels: Sequence[str] | None = None,
) -> None:
    """Draw a group of bars per environment: kinds by thickness, methods by colour and mark.

    Parameters
    ----------
    ax : Axes
        To draw on.
    environments : sequence of str
        The rows, from the top.
    bars : sequence of Bar
        At least one.
    axis : BarAxis
        What the bars are against.
    kinds : mapping of str to str
        What kinds are called in the legend.
    labels : sequence of str, optional
        Of the rows; their names by default.
    """
    rows = {environment: -float(index) for index, environment in enumerate(environments)}
    methods_drawn = [method for method in METHODS if matching(bars, method=method)]
    kinds_drawn = [kind for kind in KINDS if matching(bars, kind=kind)]
    left, right = axis.ends(bars)
    # Lines of no length stand for methods and kinds in the legend.
    for method in methods_drawn:
        ax.plot([], [], color=COLOURS[method], linewidth=3, label=METHOD_NAMES[method])
    for kind in kinds_drawn:
        ax.plot([], [], color=COLOURS["quiet"], linewidth=_THICKNESS[kind], label=kinds[kind])
    step = _HEIGHT_OF_BARS / (len(kinds_drawn) * len(methods_drawn))
    for bar in bars:
        # Kinds from top to bottom, and methods within a kind.
        place = kinds_drawn.index(bar.kind) * len(methods_drawn) + methods_drawn.index(bar.method)
        y = rows[bar.environment] + _TOP_OF_BARS - step * place
        mark(ax, _draw_bar(ax, bar, y, left, right), bar.method, bar.kind)
    ax.axvline(axis.centre, color=COLOURS["ink"], linestyle=REFERENCE_DASHES, linewidth=0.8)
    if axis.is_log(bars):
        log_scale(ax, "x", plain=True)
        ax.xaxis.set_major_locator(LogLocator(subs=tick_steps(right / left)))
        ax.set_xlim(left / _LOG_ROOM, right * _LOG_ROOM)
    else:
        room = _LINEAR_ROOM * (right - left)
        ax.set_xlim(left - room, right + room)
    ax.set_yticks(list(rows.values()), environments if labels is None else labels)
    ax.set_ylim(-len(environments) + 0.4, 0.6)
    ax.grid(visible=False, axis="y")
    ax.tick_params(axis="y", length=0)


def tick_steps(span: float) -> tuple[float, ...]:
    """Return what is labelled between powers of ten: as much as fits without touching."""
    if span < _SHORT_SPAN:
        return (1, 1.2, 1.5, 2, 3, 5, 7)
    if span < _LONG_SPAN:
        return (1, 2, 5)
    return (1,)


def _draw_bar(ax: Axes, bar: Bar, y: float, left: float, right: float) -> list[Artist]:
    """Draw a bar between the ends of the axis, with arrows where it goes on beyond them."""
    colour = COLOURS[bar.method]
    shown = [max(bar.lower, left), min(bar.upper, right)]
    drawn: list[Artist] = [*ax.plot(shown, [y, y], color=colour, linewidth=_THICKNESS[bar.kind])]
    if not left <= bar.lower <= right:
        drawn += _point_beyond(ax, (left, y), bar.lower, "left", colour)
    if not left <= bar.upper <= right:
        drawn += _point_beyond(ax, (right, y), bar.upper, "right", colour)
    if bar.kind == "mean" and left <= bar.estimate <= right:
        drawn += ax.plot(
            [bar.estimate],
            [y],
            MARKERS[bar.method],
            markersize=3.4,
            markerfacecolor=COLOURS["paper"],
            markeredgecolor=colour,
        )
    return drawn


def _point_beyond(
    ax: Axes, edge: tuple[float, float], value: float, side: str, colour: str
) -> list[Artist]:
    """Mark where a bar leaves the axis, with the value it ends at."""
    arrow, inward = ("<", 3) if side == "left" else (">", -3)
    text = ax.annotate(
        brief(value),
        edge,
        xytext=(inward, 0),
        textcoords="offset points",
        ha=side,
        va="center",
        fontsize=5.2,
        bbox=GROUND,
    )
    (point,) = ax.plot(*edge, marker=arrow, markersize=3, color=colour, clip_on=False)
    return [point, text]


def bars_of(
    intervals: Sequence[IntervalRow],
    parameter: str,
    kinds: Collection[str],
    families: Sequence[str],
) -> list[Bar]:
    """Return the bars of a quantity, each in the first of the families that has it."""
    rows = matching(intervals, parameter=parameter, joint="marginal")
    relative = parameter not in compared_by_difference(rows)
    bars: list[Bar] = []
    for environment in distinct(rows, "environment"):
        for kind in kinds:
            for method in METHODS:
                candidates = matching(rows, environment=environment, kind=kind, method=method)
                row = first(candidates, family=families)
                bar = None if row is None else _bar(row, relative=relative)
                if bar is not None:
                    bars.append(bar)
    return bars


def _bar(row: IntervalRow, *, relative: bool) -> Bar | None:
    """Return a row's bar; None without reference or limits."""
    if row.reference is None:
        return None
    ends = np.array([row.lower, row.upper, row.estimate])
    lower, upper, estimate = ends / row.reference if relative else ends - row.reference
    return Bar(row.environment, row.kind, row.method, float(lower), float(upper), float(estimate))


@dataclass(frozen=True)
class _Choice:
    """The environments of a figure, from the top."""

    figure: str  # Its name
    environments: list[str]
    said: str  # Which they are; empty where these are all, in their own order


def interval_drawings(results: Results) -> list[Drawing]:
    """Return figures per quantity: the average and the next user, and each subject.

    Of many environments the first figure has those whose bias is clearest, and another has all.
    """
    families = families_of(results)
    drawings = []
    for parameter in distinct(results.intervals, "parameter"):
        bars = bars_of(results.intervals, parameter, ("mean", "user"), families)
        if not bars:
            bars = bars_of(results.intervals, parameter, ("share",), families)
        if bars:
            for choice in _choices(results, parameter, bars):
                drawings.append(_interval_drawing(results, parameter, bars, choice))
    return drawings


def _choices(results: Results, parameter: str, bars: Sequence[Bar]) -> Iterator[_Choice]:
    """Yield the figure of all environments; of many, that of the clearest biases before it."""
    rows = matching(results.intervals, parameter=parameter)
    # A single subject of an environment has no interval, and is drawn all the same.
    cells = [cell for cell in matching(results.data.cells, parameter=parameter) if cell.n]
    names = distinct([*rows, *cells], "environment")
    if len(names) <= MOST_OPEN:
        yield _Choice(f"overview_{parameter}", names, "")
        return
    relative = parameter not in compared_by_difference(rows)
    centre = 1.0 if relative else 0.0
    estimates: dict[str, float] = {}
    clarities: dict[str, float] = {}
    for name in distinct(bars, "environment"):
        bar = first(matching(bars, environment=name), kind=KINDS, method=METHODS[::-1])
        assert bar is not None
        estimates[name] = bar.estimate
        clarities[name] = abs(bar.estimate - centre) / (bar.upper - bar.lower)
    ranked = sorted(names, key=lambda name: -estimates.get(name, centre))
    chosen_names = clearest(clarities, MOST_OPEN)
    words = words_of(results)
    matched = results.data.quantities[parameter].is_matched
    which = "whose bias is clearest" if matched else "farthest from zero"
    said = f"{len(chosen_names)} of {len(names)} {words.environments}, those {which}"
    foremost = [name for name in ranked if name in chosen_names]
    yield _Choice(f"overview_{parameter}", foremost, said)
    yield _Choice(f"overview_all_{parameter}", ranked, f"all {len(names)} {words.environments}")


def _interval_drawing(
    results: Results, parameter: str, bars: Sequence[Bar], choice: _Choice
) -> Drawing:
    """Return a figure of one quantity."""
    rows = matching(results.intervals, parameter=parameter, joint="marginal")
    environments = chosen(choice.environments)
    bars = [bar for bar in bars if bar.environment in environments]
    values = [subjects_of(results.data.cells, name, parameter) for name in environments]
    families = families_of(results)
    relative = parameter not in compared_by_difference(rows)
    axis = BarAxis(relative, log=families[0] == "lognormal")
    quantity = results.data.quantities[parameter]
    words = words_of(results)

    def draw(figure: Figure) -> None:
        labels = row_labels(environments, most=_MOST_MARGIN)
        longest = LETTER * max(map(len, labels))
        left = max(_LEAST_MARGIN, longest + _BESIDE_LABEL)
        (ax,) = panels(figure, frame=Frame(left=left, right=_COUNT_MARGIN, bottom=20.4))
        draw_intervals(
            ax, environments, bars, axis, kinds=kind_names(results.data.words), labels=labels
        )
        draw_subjects(ax, values, subject=results.data.words.subject[0])
        ax.set_title(quantity.head, loc="left")
        ax.set_xlabel(axis.label("adjusted", quantity))
        legend(ax, ncols=3)

    groups = len({(bar.kind, bar.method) for bar in bars})
    title = f"What {words.users} set, {'divided by' if relative else 'less'} the reference"
    if not quantity.is_matched:
        title = f"Values of {quantity.label}"
    if choice.said:
        title += f": {choice.said}"
    dashed = "the reference" if quantity.is_matched else "zero"
    description = _caption(rows, bars, axis, families, words, dashed)
    if any(len(of_row) for of_row in values):
        description += f" Ticks: the {words.subjects}; those beyond the axis are counted."
    return Drawing(
        name=choice.figure,
        title=title,
        description=description + choice_said(choice.environments, words.environments),
        size=(_WIDTH, _HEIGHT + (_ROW_HEIGHT + _BAR_HEIGHT * groups) * len(environments)),
        draw=draw,
    )


def _caption(
    rows: Sequence[IntervalRow],
    bars: Sequence[Bar],
    axis: BarAxis,
    families: Sequence[str],
    words: Words,
    dashed: str,
) -> str:
    """Say what bars, arrows and the dashed line stand for."""
    kinds = [said.format(words) for kind, said in _BARS_SAID.items() if matching(bars, kind=kind)]
    sentences = [f"{'; '.join(kinds)}; dashed: {dashed}"]
    if len(distinct(bars, "method")) == len(METHODS):
        sentences.append("Each classical bar stands above the Bayesian one")
    classical = matching(rows, method="classical")
    families_drawn = set()
    for name in distinct(classical, "environment"):
        row = first(matching(classical, environment=name), family=families)
        if row is not None:
            families_drawn.add(row.family)
    said = [family for family in families if family in families_drawn]
    if said:
        sentences.append(f"Classical limits are {', where there are none '.join(said)}")
    if axis.is_left_by(bars):
        sentences.append("An arrow with a value ends a bar that leaves the axis")
    return " ".join(f"{sentence}." for sentence in sentences)

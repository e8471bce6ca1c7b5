"""What figures are drawn on, and how they become files and parts of the page."""

from __future__ import annotations

import base64
import io
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context, rc_params_from_file
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from percept.report.basics import METHOD_NAMES, METHODS, SUPERSCRIPT, Plot, present

# Blue and vermilion remain apart in every common form of colour blindness, and form tells them
# apart as well.
COLOURS = {
    "ink": "#1c2127",
    "quiet": "#667079",
    "rule": "#d4d9de",
    "paper": "#fffffe",
    "classical": "#0067a5",
    "bayesian": "#c44e00",
    "coupled": "#007a5a",
    "warn": "#a8326e",
}

#: Marks tell the methods apart where colours do not.
MARKERS = {"classical": "o", "bayesian": "D"}
#: The line of the reference.
REFERENCE: dict[str, Any] = {"color": COLOURS["ink"], "linestyle": (0, (7, 3))}
#: Inches.
MM = 1 / 25.4
#: mm, of every figure: a column of a journal, and of the page.
WIDTH = 87.5
_TITLE = 18  # letters, of a panel
#: Ends of a logarithmic axis over each other, up to which more is labelled than powers of ten.
_SHORT_SPAN = 5.0
_LONG_SPAN = 1e3
#: Over so many decades only every second or fifth power is labelled.
_MOST_TICKS = 5


#: mm, of a panel with its labels, and of the legend below all.
_PANEL_HEIGHT = 38.0
LEGEND_HEIGHT = 12.0


@dataclass(frozen=True)
class Drawing:
    """A figure before it is drawn."""

    name: str  # Of its file, without ending
    title: str  # What it shows, in a few words
    description: str  # What a reader who cannot see it should know
    height: float  # mm
    draw: Callable[[Figure], None]  # Draws on an empty matplotlib Figure with constrained layout


def panels(figure: Figure, count: int = 1, *, columns: int | None = None) -> list[Axes]:
    """Add axes row by row from the top, all in one row by default."""
    columns = columns or count
    rows = -(-count // columns)
    axes: list[Axes] = list(figure.subplots(rows, columns, squeeze=False).flat)
    for spare in axes[count:]:
        spare.remove()
    return axes[:count]


def draw_panels(
    figure: Figure, names: Sequence[str], columns: int, draw: Callable[[Axes, int], None]
) -> None:
    """Draw panels by their index, with short names as titles, outer labels and one legend."""
    axes = panels(figure, len(names), columns=columns)
    for index, (ax, name) in enumerate(zip(axes, shortened(names, _TITLE), strict=True)):
        ax.set_title(name)
        draw(ax, index)
        if index % columns:
            ax.set_ylabel("")
        if index < len(names) - columns:
            ax.set_xlabel("")
    legend(axes, ncols=2)


def panels_height(count: int, columns: int = 1) -> float:
    """Return the height of a figure of panels, mm."""
    return LEGEND_HEIGHT + _PANEL_HEIGHT * -(-count // columns)


def log_scale(ax: Axes, axes: str = "xy", *, plain: bool = False) -> None:
    """Make axes logarithmic, without minor ticks; as plain numbers between ends that are set."""
    for name in axes:
        ax.set(**{f"{name}scale": "log"})
        axis = {"x": ax.xaxis, "y": ax.yaxis}[name]
        axis.minorticks_off()
        # In letters: matplotlib's formulas take longer than the figure.
        axis.set_major_formatter("{x:g}" if plain else _power_of_ten)
        low, high = sorted(axis.get_view_interval())
        steps: tuple[float, ...] = (1,)
        if plain and high < _SHORT_SPAN * low:
            steps = (1, 1.2, 1.5, 2, 3, 5, 7)
        elif plain and high < _LONG_SPAN * low:
            steps = (1, 2, 5)
        axis.set_major_locator(LogLocator(subs=steps, numticks=_MOST_TICKS))


def _power_of_ten(x: float, _: object) -> str:
    return f"10{str(round(np.log10(x))).translate(SUPERSCRIPT)}"


def legend(axes: Sequence[Axes], *, ncols: int = 4) -> None:
    """Put one legend of some axes below their figure, each label once."""
    named: dict[str, Artist] = {}
    for ax in axes:
        handles, labels = ax.get_legend_handles_labels()
        named |= dict(zip(labels, handles, strict=True))
    figure = axes[0].get_figure(root=True)
    if figure is not None and named:
        figure.legend(list(named.values()), list(named), loc="outside lower left", ncols=ncols)


def method_legend(ax: Axes, records: Sequence[Any]) -> None:
    """Name the methods of records in the legend, by lines without points."""
    for method in present(METHODS, records, "method"):
        ax.plot([], [], color=COLOURS[method], linewidth=3, label=METHOD_NAMES[method])


def draw_interval(
    ax: Axes,
    place: float,
    limits: Sequence[float] | NDArray[np.float64],
    estimate: float | None,
    method: str,
    *,
    width: float = 2.4,
    upright: bool = False,
) -> None:
    """Draw an interval as a bar, and its estimate as a mark if there is one."""
    beside = [place, place]
    colour = COLOURS[method]
    bar = (beside, limits) if upright else (limits, beside)
    ax.plot(*bar, color=colour, linewidth=width)
    if estimate is not None:
        at = (place, estimate) if upright else (estimate, place)
        ax.plot(
            *at,
            MARKERS[method],
            markersize=3.4,
            markerfacecolor=COLOURS["paper"],
            markeredgecolor=colour,
        )


def shortened(names: Sequence[str], letters: int) -> list[str]:
    """Cut long names in the middle: names in a series differ at their ends."""
    end = letters // 2
    return [
        name if len(name) <= letters else f"{name[: letters - 1 - end]}…{name[len(name) - end :]}"
        for name in names
    ]


_DPI = 300  # of a PNG
_POINTS = 72.0  # of an SVG, per inch
#: matplotlib's settings for every figure.
_STYLE = rc_params_from_file(
    str(resources.files("percept.report") / "templates" / "figures.mplstyle"),
    use_default_template=False,
)
# Dates and versions would make equal figures differ.
_NO_METADATA: dict[str, dict[str, str | None]] = {
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}
# Characters that XML cannot hold, even as references.
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ufffe\uffff]")


def draw_all(
    drawings: Iterable[Drawing], folder: Path, *, formats: Sequence[str]
) -> dict[str, Plot]:
    """Draw figures, write their files, and return them by name."""
    plots = {}
    for one in drawings:
        files = drawn(one, {"svg", *formats})
        for form in formats:
            folder.mkdir(exist_ok=True)
            (folder / f"{one.name}.{form}").write_bytes(files[form])
        image = base64.b64encode(files["svg"]).decode()
        plots[one.name] = Plot(one.title, one.description, image, tuple(formats))
    return plots


def drawn(drawing: Drawing, formats: Collection[str] = ("svg",)) -> dict[str, bytes]:
    """Draw a figure once; return its files by format."""
    # Ids of clips and markers are made with salt: equal figures become equal files.
    salted = {**_STYLE, "svg.hashsalt": f"percept {drawing.name}"}
    with rc_context(salted), warnings.catch_warnings():
        # An SVG holds text as text; whoever shows it has more fonts.
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        # Names as long as a figure leave no room for axes: they lie over each other.
        warnings.filterwarnings("ignore", "constrained_layout not applied", UserWarning)
        figure = Figure((WIDTH * MM, drawing.height * MM), dpi=_POINTS)
        FigureCanvasSVG(figure)
        layout = ConstrainedLayoutEngine()
        figure.set_layout_engine(layout)
        drawing.draw(figure)
        # Once for all files. `savefig` would draw the figure once more for it.
        layout.execute(figure)
        figure.set_layout_engine(None)
        return {form: _saved(figure, form, drawing.title) for form in formats}


def _saved(figure: Figure, form: str, title: str) -> bytes:
    buffer = io.BytesIO()
    metadata = _NO_METADATA[form]
    if form != "svg":
        figure.savefig(buffer, format=form, metadata=metadata, dpi=_DPI)
        return buffer.getvalue()
    figure.savefig(buffer, format=form, metadata={**metadata, "Title": title}, dpi=_POINTS)
    return _CONTROL.sub("\ufffd", buffer.getvalue().decode()).encode()

"""The paper's figures drawn again, and what it left to do: device maps and adapted couplings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from percept.haptics import Coupling, Device, corner_curves, required_damping
from percept.haptics.impedance import coupling_admittance
from percept.haptics.limits import stable_region
from percept.haptics.stability import coupling_bound
from percept.report.figures.canvas import COLOURS, Drawing, Frame, legend, log_scale, panels
from percept.report.figures.curves import Limits, draw_magnitude, draw_stability
from reports.hbfd import devices
from reports.hbfd.devices import (
    DAMPINGS,
    MASSES,
    Adapted,
    Panel,
    environments_inside,
    over_devices,
)
from reports.hbfd.published import THEORETICAL, Array, Published, Wall

Segments = Sequence[Array]  # Per line of coupling damping: (n, 2) intervals of stiffness, N/m

#: The axes of a map show at most this many times what qualifies.
_BEYOND = 4.0
_ROOM = 1.05  # factor on what an axis has to show
_KILO = 1e3  # N/m in kN/m
_PAIR = (86.0, 72.0)  # mm, width and height: two figures stand side by side
# rad/s; the paper's axes reach past the device's resonances at 300
_WIDE = np.geomspace(0.1, 1000.0, 241)
_CLOSE = 121  # Points over an enlarged panel
_MAP_MASSES = np.geomspace(MASSES[0], MASSES[-1], 141)
_MAP_DAMPINGS = np.geomspace(DAMPINGS[0], DAMPINGS[-1], 121)


def drawings(published: Published, adapted: Adapted) -> list[Drawing]:
    """Return every figure of the page; nothing is drawn yet."""
    drawn = [_fig4(published), _fig5(published)]
    for panel, letter in zip(devices.panels(published), "ace", strict=True):
        drawn += [_whole(published, panel, letter), _enlarged(published, panel)]
    return [*drawn, _maps(published), _design(published, adapted)]


def _fig4(published: Published) -> Drawing:
    needed = published.needed()
    period = published.period

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, frame=Frame(left=18, top=3))
        nyquist = np.pi / period
        omega = np.geomspace(10.0, nyquist * 0.9999, 401)
        bound = coupling_bound(omega, Device(published.device.mass, needed), period)
        lines = {}
        for coupling in (THEORETICAL, published.tuned):
            admittance = coupling_admittance(omega, coupling, period, discretization="backward")
            binds = float(required_damping(coupling, period).omega)
            lines[_stiffness(coupling)] = np.asarray(admittance).real, binds
        draw_stability(ax, omega, bound, lines)

    return Drawing(
        "fig-4",
        "Fig. 4: stability of the theoretical and the tuned coupling",
        f"Re 1/Z_c of both couplings and its lower bound for a rigid device of {needed:.4g} N·s/m,"
        " with which the theoretical one just touches it. The knots of the paper’s figure are"
        " resonances it gives no numbers for.",
        (120.0, 80.0),
        draw,
    )


def _stiffness(coupling: Coupling) -> str:
    return f"{float(coupling.stiffness) / 1e3:g} kN/m"


def _fig5(published: Published) -> Drawing:
    wall, _ = published.drawn[0]
    return _curves(
        published,
        "fig-5",
        "Fig. 5: realistic performance boundaries",
        f"The limits of {wall.name} without a device, so that the upper limits lie above the lower"
        " ones throughout; the reference is dashed.",
        (Device(0.0, 0.0), wall, None),
        published.omega(),
    )


def _whole(published: Published, panel: Panel, letter: str) -> Drawing:
    device = published.device
    return _curves(
        published,
        f"fig-7{letter}",
        f"Fig. 7{letter}: {panel.wall.name}",
        f"Boundaries, reference, and reference through the coupling, {_device(device)}.",
        (device, panel.wall, published.tuned),
        _WIDE,
    )


def _enlarged(published: Published, panel: Panel) -> Drawing:
    device = published.device
    mass = np.array(device.mass)
    damping = np.array(device.damping)
    verdict = "So it is" if over_devices(published, panel, mass, damping) else "Not so"
    return _curves(
        published,
        f"fig-{panel.name}",
        f"Fig. {panel.name}: {panel.wall.name}, enlarged",
        f"The paper reads: {panel.says}. {verdict} with {_device(device)}.",
        (device, panel.wall, published.tuned),
        np.linspace(*panel.window, _CLOSE),
        log=False,
    )


def _device(device: Device) -> str:
    return f"m = {float(device.mass):.3g} kg and b_d = {float(device.damping):.3g} N·s/m"


def _curves(
    published: Published,
    name: str,
    title: str,
    description: str,
    setting: tuple[Device, Wall, Coupling | None],
    omega: Array,
    *,
    log: bool = True,
) -> Drawing:
    """Draw boundaries and reference for a device, and the reference through a coupling."""
    device, wall, coupling = setting

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, frame=Frame(left=18, bottom=24, right=5))
        ends = corner_curves(omega, device, wall.stiffness, wall.damping, published.period)
        direct = published.felt(omega, wall.environment, device=device)
        coupled = None
        if coupling is not None:
            coupled = published.felt(omega, wall.environment, device=device, coupling=coupling)
        label = f"boundaries, {published.limits.level:.0%} limits of k and b"
        limits = Limits(label, "classical", omega, *ends, direct)
        draw_magnitude(ax, omega, [limits], direct, coupled, log=log)
        ax.set_title(f"{wall.name}: {wall.k:g} N/m, {wall.b:g} N·s/m", loc="left")
        legend(ax, ncols=1)

    return Drawing(name, title, description, _PAIR, draw)


def _maps(published: Published) -> Drawing:
    enlarged = devices.panels(published)

    def draw(figure: Figure) -> None:
        frame = Frame(left=14, gap=14, top=6, bottom=22, line=18)
        axes = panels(figure, len(enlarged) + 1, columns=2, frame=frame)
        for ax, panel in zip(axes, enlarged, strict=False):
            true = over_devices(published, panel, _MAP_MASSES, _MAP_DAMPINGS[:, None])
            _shade(ax, true, [0.5, 1.5], 0.35)
            ax.set_title(f"Fig. {panel.name}: {panel.says}", loc="left", fontsize=7)
        _count_map(axes[-1], published)
        for ax in axes:
            _mark_devices(ax, published)
            ax.set_xlabel("device mass (kg)")
        for ax in axes[::2]:
            ax.set_ylabel("device damping (N·s/m)")
        # Contours have no entry in a legend: an empty area of their colour has one.
        label = "true over the window"
        colour = COLOURS["coupled"]
        axes[0].fill_between([], [], [], color=colour, alpha=0.35, linewidth=0, label=label)
        legend(axes[0], ncols=2)

    return Drawing(
        "device-maps",
        "How verdicts move with the device, whose mass and damping were not published",
        "Shaded: the reading of the paper is true over the whole window; in the last map the"
        " darker, the more environments stay inside the next user’s boundary through the tuned"
        " coupling. Above a line the coupling named is stable; the cross is the scene’s device.",
        (150.0, 128.0),
        draw,
    )


def _count_map(ax: Axes, published: Published) -> None:
    """Shade how many environments feel real through the tuned coupling."""
    count = environments_inside(published, _MAP_MASSES, _MAP_DAMPINGS[:, None])
    for least in range(1, len(published.walls) + 1):
        _shade(ax, count, [least - 0.5, np.inf], 0.18)
    ends = sorted({int(count.min()), int(count.max())})
    told = " to ".join(map(str, ends))
    title = f"real through the tuned coupling: {told} of {len(published.walls)}"
    ax.set_title(title, loc="left", fontsize=7)


def _shade(ax: Axes, values: np.ndarray, levels: list[float], alpha: float) -> None:
    colour = COLOURS["coupled"]
    ax.contourf(_MAP_MASSES, _MAP_DAMPINGS, values, levels=levels, colors=colour, alpha=alpha)


def _mark_devices(ax: Axes, published: Published) -> None:
    _mark_needed(ax, published, THEORETICAL, (0, (6, 2)))
    _mark_needed(ax, published, published.tuned, (0, (2, 1.5)))
    device = published.device
    ax.plot(
        device.mass,
        device.damping,
        color=COLOURS["warn"],
        marker="X",
        markersize=5,
        linestyle="none",
        label="the scene’s device",
    )
    log_scale(ax, plain=True)
    ax.set_xlim(MASSES[0], MASSES[-1])
    ax.set_ylim(DAMPINGS[0], DAMPINGS[-1])


def _mark_needed(
    ax: Axes, published: Published, coupling: Coupling, dashes: tuple[int, tuple[float, float]]
) -> None:
    needed = published.needed(coupling)
    label = f"{_stiffness(coupling)} is stable above {needed:.4g} N·s/m"
    colour = COLOURS["classical"]
    ax.axhline(needed, color=colour, linestyle=dashes, linewidth=0.9, label=label)


def _design(published: Published, adapted: Adapted) -> Drawing:
    names = [*(wall.name for wall in published.walls), "one coupling for all"]
    regions = [*adapted.design.each, adapted.design.common]
    damping = float(adapted.device.damping)
    tuned = (float(published.tuned.stiffness), float(published.tuned.damping))

    def draw(figure: Figure) -> None:
        edge = stable_region(damping, published.period, points=65)
        axes = panels(figure, len(regions), columns=3, frame=Frame(bottom=17))
        for ax, name, region in zip(axes, names, regions, strict=True):
            draw_design(ax, region.damping, region.intervals, CouplingMarks(edge, tuned))
            ax.set_title(name, loc="left")
        for ax in axes[::3]:
            ax.set_ylabel("coupling damping (N·s/m)")
        legend(axes[0], ncols=3)

    rows = -(-len(regions) // 3)
    return Drawing(
        "design",
        "Couplings that are stable and feel real, by environment",
        f"For {_device(adapted.device)}, the damping Fig. 4 implies. Shaded: stable, and inside the"
        " next user’s limits at every perceivable ω, by |Z_h| and by k and b. Cross: the paper’s"
        " tuned coupling.",
        (175.0, 16.0 + 52.0 * rows),
        draw,
    )


@dataclass(frozen=True, eq=False)
class CouplingMarks:
    """What a map shows beside the couplings that qualify."""

    stable: tuple[Array, Array] | None = None  # Edge: stiffness, N/m, and damping, N·s/m
    coupling: tuple[float, float] | None = None  # In use: stiffness, N/m, and damping, N·s/m


def draw_design(
    ax: Axes,
    damping: Array,
    intervals: Segments,
    marks: CouplingMarks,
) -> None:
    """Draw the couplings that are stable and stay inside a boundary, by stiffness and damping.

    Parameters
    ----------
    ax : Axes
        To draw on.
    damping : ndarray, shape (n,)
        Coupling damping of each line, N·s/m.
    intervals : sequence of ndarray, shape (m, 2)
        Per line, the intervals of stiffness that qualify, N/m.
    marks : CouplingMarks
        What else is drawn.
    """
    if marks.stable is not None:
        stiffness, edge_damping = marks.stable
        ax.plot(
            np.append(stiffness, stiffness[0]) / _KILO,
            np.append(edge_damping, edge_damping[0]),
            color=COLOURS["quiet"],
            linewidth=0.8,
            label="edge of the stable region",
        )
    boxes = _boxes(damping, intervals)
    if len(boxes):
        # left, right, bottom and top make the five corners of a closed box
        corners = boxes[:, [[0, 2], [1, 2], [1, 3], [0, 3], [0, 2]]]
        shade = PathPatch(
            Path.make_compound_path_from_polys(corners),
            color=COLOURS["coupled"],
            alpha=0.35,
            linewidth=0,
            antialiased=False,  # smoothed edges would leave a light line where boxes touch
            label="stable and inside the boundary",
        )
        # add_patch would look for the extent segment by segment; the ends are known.
        ax.add_artist(shade)
    else:
        quiet = COLOURS["quiet"]
        ax.text(0.5, 0.5, "none qualifies", ha="center", color=quiet, transform=ax.transAxes)
    right, top = _map_ends(boxes, marks)
    if marks.coupling is not None:
        _draw_coupling(ax, *marks.coupling, right=right, top=top)
    ax.set_xlim(0, right)
    ax.set_ylim(0, top)
    ax.set_xlabel("coupling stiffness (kN/m)")


def _draw_coupling(ax: Axes, stiffness: float, damping: float, *, right: float, top: float) -> None:
    """Mark the coupling in use; at the edge with its numbers where it lies beyond."""
    own = (stiffness / _KILO, damping)
    shown = (min(own[0], right), min(own[1], top))
    ax.plot(
        [shown[0]], [shown[1]], "X", markersize=5, color=COLOURS["warn"], label="coupling in use",
        clip_on=False,
    )  # fmt: skip
    if shown != own:
        text = f"at {own[0]:.4g} kN/m,\n{own[1]:.4g} N·s/m"
        ax.annotate(
            text, shown, xytext=(-6, -4), textcoords="offset points", ha="right", va="top",
            fontsize=6,
        )  # fmt: skip


def _map_ends(boxes: Array, marks: CouplingMarks) -> tuple[float, float]:
    """Return the ends of a map's axes: behind what qualifies, and behind marks that are near.

    Stiffness is in kN/m, damping in N·s/m.
    """
    qualifying = boxes[:, [1, 3]].max(axis=0, initial=0.0)
    marked = np.zeros(2)
    if marks.coupling is not None:
        marked = np.array([marks.coupling[0] / _KILO, marks.coupling[1]])
    if marks.stable is not None:
        stiffness, edge_damping = marks.stable
        marked = np.maximum(marked, [stiffness.max() / _KILO, edge_damping.max()])
    if qualifying.all():
        marked = np.minimum(marked, _BEYOND * qualifying)
    right, top = _ROOM * np.maximum(qualifying, marked)
    return float(right or 1.0), float(top or 1.0)


def _boxes(damping: Array, intervals: Segments) -> Array:
    """Return left, right, bottom, top of a box per interval, half way to the next lines."""
    halfway = (damping[1:] + damping[:-1]) / 2
    edges = np.concatenate([damping[:1], halfway, damping[-1:]])
    boxes: list[tuple[float, float, float, float]] = []
    for line, segments in enumerate(intervals):
        for low, high in segments:
            boxes.append((low / _KILO, high / _KILO, edges[line], edges[line + 1]))
    return np.array(boxes, dtype=float).reshape(-1, 4)

"""The paper's figures drawn again, and what it left to do: device maps and adapted couplings."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept.haptics import (
    Coupling,
    Device,
    corner_curves,
    required_damping,
)
from percept.haptics.impedance import coupling_admittance
from percept.haptics.limits import stable_region
from percept.haptics.stability import coupling_bound
from percept.report.figures.canvas import (
    COLOURS,
    Drawing,
    legend,
    log_scale,
    panels,
)
from percept.report.figures.curves import Limits, draw_magnitude, draw_stability
from percept.report.figures.marks import draw_design
from percept.reproduce import devices
from percept.reproduce.devices import DAMPINGS, MASSES, Adapted, over_devices
from percept.reproduce.published import THEORETICAL, Array, Published, Wall

_PAIR = (86.0, 72.0)
_WIDE = np.geomspace(
    0.1, 1000.0, 241
)  # rad/s; the paper's axes reach past the device's resonances at 300
_MAP_MASSES = np.geomspace(MASSES[0], MASSES[-1], 141)
_MAP_DAMPINGS = np.geomspace(DAMPINGS[0], DAMPINGS[-1], 121)


def drawings(published: Published, adapted: Adapted) -> list[Drawing]:
    """Return every figure of the page; nothing is drawn yet."""
    device, tuned = published.device, published.tuned
    wall, _ = published.drawn[0]
    bare = _curves(
        published,
        "fig-5",
        "Fig. 5: realistic performance boundaries",
        f"The limits of {wall.name} without a device, so that the upper limits lie above the lower"
        " ones throughout; the reference is dashed.",
        (Device(0.0, 0.0), wall, None),
        published.omega(),
    )
    found = [_fig4(published), bare]
    for panel, letter in zip(devices.panels(published), "ace", strict=True):
        name, shown = panel.wall.name, (device, panel.wall, tuned)
        true = over_devices(published, panel, np.array(device.mass), np.array(device.damping))
        wide = f"Boundaries, reference, and reference through the coupling, {_device(device)}."
        close = (
            f"The paper reads: {panel.says}. {'So it is' if true else 'Not so'} with"
            f" {_device(device)}."
        )
        found += [
            _curves(published, f"fig-7{letter}", f"Fig. 7{letter}: {name}", wide, shown, _WIDE),
            _curves(
                published, f"fig-{panel.name}", f"Fig. {panel.name}: {name}, enlarged", close, shown,
                np.linspace(*panel.window, 121), log=False,
            ),
        ]  # fmt: skip
    return [*found, _maps(published), _design(published, adapted)]


def _fig4(published: Published) -> Drawing:
    needed = published.needed()

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, left=18, top=3)
        nyquist = np.pi / published.period
        omega = np.geomspace(10.0, nyquist * 0.9999, 401)
        bound = coupling_bound(omega, Device(published.device.mass, needed), published.period)
        lines = {}
        for coupling in (THEORETICAL, published.tuned):
            label = f"{float(coupling.stiffness) / 1e3:g} kN/m"
            admittance = coupling_admittance(
                omega, coupling, published.period, discretization="backward"
            )
            binds = float(required_damping(coupling, published.period).omega)
            lines[label] = np.asarray(admittance).real, binds
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


def _device(device: Device) -> str:
    return f"m = {float(device.mass):.3g} kg and b_d = {float(device.damping):.3g} N·s/m"


def _curves(
    published: Published,
    name: str,
    title: str,
    description: str,
    shown: tuple[Device, Wall, Coupling | None],
    omega: Array,
    *,
    log: bool = True,
) -> Drawing:
    """Draw boundaries and reference for a device, and the reference through a coupling."""
    device, wall, coupling = shown

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, left=18, bottom=24, right=5)
        at_low, at_high = corner_curves(
            omega, device, wall.stiffness, wall.damping, published.period
        )
        direct, coupled = (
            published.felt(omega, wall.environment, device=device, coupling=each)
            for each in (None, coupling)
        )
        label = f"boundaries, {published.limits.level:.0%} limits of k and b"
        limits = Limits(label, "classical", omega, at_low, at_high, direct)
        draw_magnitude(ax, omega, [limits], direct, None if coupling is None else coupled, log=log)
        ax.set_title(f"{wall.name}: {wall.k:g} N/m, {wall.b:g} N·s/m", loc="left")
        legend(ax, ncols=1)

    return Drawing(name, title, description, _PAIR, draw)


def _maps(published: Published) -> Drawing:
    shown = devices.panels(published)

    def draw(figure: Figure) -> None:
        axes = panels(figure, len(shown) + 1, columns=2, left=14, gap=14, top=6, bottom=22, line=18)
        for ax, panel in zip(axes, shown, strict=False):
            true = over_devices(published, panel, _MAP_MASSES, _MAP_DAMPINGS[:, None])
            ax.contourf(
                _MAP_MASSES,
                _MAP_DAMPINGS,
                true,
                levels=[0.5, 1.5],
                colors=COLOURS["coupled"],
                alpha=0.35,
            )
            ax.set_title(f"Fig. {panel.name}: {panel.says}", loc="left", fontsize=7)
        count = devices.environments_inside(published, _MAP_MASSES, _MAP_DAMPINGS[:, None])
        for least in range(1, len(published.walls) + 1):
            axes[-1].contourf(
                _MAP_MASSES, _MAP_DAMPINGS, count, levels=[least - 0.5, np.inf], colors=COLOURS["coupled"],
                alpha=0.18,
            )  # fmt: skip
        told = " to ".join(map(str, sorted({int(count.min()), int(count.max())})))
        title = f"real through the tuned coupling: {told} of {len(published.walls)}"
        axes[-1].set_title(title, loc="left", fontsize=7)
        for ax in axes:
            _mark_devices(ax, published)
            ax.set_xlabel("device mass (kg)")
        for ax in axes[::2]:
            ax.set_ylabel("device damping (N·s/m)")
        axes[0].fill_between(
            [],
            [],
            [],
            color=COLOURS["coupled"],
            alpha=0.35,
            linewidth=0,
            label="true over the window",
        )
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


def _mark_devices(ax: Axes, published: Published) -> None:
    for coupling, dashes in ((THEORETICAL, (0, (6, 2))), (published.tuned, (0, (2, 1.5)))):
        needed = published.needed(coupling)
        ax.axhline(
            needed,
            color=COLOURS["classical"],
            linestyle=dashes,
            linewidth=0.9,
            label=f"{float(coupling.stiffness) / 1e3:g} kN/m is stable above {needed:.4g} N·s/m",
        )
    device = published.device
    ax.plot(
        device.mass, device.damping, color=COLOURS["warn"], marker="X", markersize=5, linestyle="none",
        label="the scene’s device",
    )  # fmt: skip
    log_scale(ax, plain=True)
    ax.set_xlim(MASSES[0], MASSES[-1])
    ax.set_ylim(DAMPINGS[0], DAMPINGS[-1])


def _design(published: Published, adapted: Adapted) -> Drawing:
    regions = [
        *zip((wall.name for wall in published.walls), adapted.design.each, strict=True),
        ("one coupling for all", adapted.design.common),
    ]
    damping = float(adapted.device.damping)

    def draw(figure: Figure) -> None:
        edge = stable_region(damping, published.period, points=65)
        axes = panels(figure, len(regions), columns=3, bottom=17)
        for ax, (name, region) in zip(axes, regions, strict=True):
            draw_design(
                ax,
                region.damping,
                region.intervals,
                stable=edge,
                coupling=(float(published.tuned.stiffness), float(published.tuned.damping)),
            )
            ax.set_title(name, loc="left")
        for ax in axes[::3]:
            ax.set_ylabel("coupling damping (N·s/m)")
        legend(axes[0], ncols=3)

    return Drawing(
        "design",
        "Couplings that are stable and feel real, by environment",
        f"For {_device(adapted.device)}, the damping Fig. 4 implies. Shaded: stable, and inside the"
        " next user’s limits at every perceivable ω, by |Z_h| and by k and b. Cross: the paper’s"
        " tuned coupling.",
        (175.0, 16.0 + 52.0 * -(-len(regions) // 3)),
        draw,
    )

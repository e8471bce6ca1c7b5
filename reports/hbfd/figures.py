"""The paper's figures drawn again."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from percept.haptics import Coupling, Device, Loop, corner_curves
from percept.haptics.impedance import coupling_admittance
from percept.haptics.stability import coupling_bound
from reports.hbfd.devices import Panel, over_devices, panels
from reports.hbfd.published import THEORETICAL, Array, Published, Wall

_SIZE = (4.6, 3.4)  # Inches
# rad/s; the paper's axes reach past the device's resonances at 300
_WIDE = np.geomspace(0.1, 1000.0, 241)
_CLOSE = 121  # Points over an enlarged panel


def figures(published: Published) -> Iterator[tuple[str, str, Figure]]:
    """Draw every figure: its name, what it shows, and the figure."""
    needed = published.needed()
    yield (
        "fig-4",
        "Fig. 4. Re 1/Z_c of the theoretical and the tuned coupling, and its lower bound for a"
        f" rigid device of {needed:.4g} N·s/m, with which the theoretical one just touches it. The"
        " knots of the paper's figure are resonances it gives no numbers for.",
        _fig4(published, needed),
    )
    wall, _ = published.drawn[0]
    yield (
        "fig-5",
        f"Fig. 5. The limits of {wall.name} without a device, so that the upper limits lie above"
        " the lower ones throughout; the reference is dashed.",
        _curves(published, Device(0.0, 0.0), wall, None, np.geomspace(*published.span, 241)),
    )
    device = published.device
    named = f"m = {float(device.mass):.3g} kg and b_d = {float(device.damping):.3g} N·s/m"
    for panel, letter in zip(panels(published), "ace", strict=True):
        yield (
            f"fig-7{letter}",
            f"Fig. 7{letter}. {panel.wall.name}: boundaries, reference, and reference through the"
            f" coupling, {named}.",
            _curves(published, device, panel.wall, published.tuned, _WIDE),
        )
        verdict = "So it is" if _is_so(published, panel) else "Not so"
        yield (
            f"fig-{panel.name}",
            f"Fig. {panel.name}. {panel.wall.name}, enlarged. The paper reads: {panel.says}."
            f" {verdict} with {named}.",
            _curves(
                published,
                device,
                panel.wall,
                published.tuned,
                np.linspace(*panel.window, _CLOSE),
            ),
        )


def _is_so(published: Published, panel: Panel) -> bool:
    device = published.device
    return bool(over_devices(published, panel, np.array(device.mass), np.array(device.damping)))


def _axes(xlabel: str, ylabel: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=_SIZE, layout="constrained")
    ax = figure.add_subplot()
    ax.set_xlabel(xlabel)
    ax.set_ylabel(ylabel)
    return figure, ax


def _fig4(published: Published, needed: float) -> Figure:
    figure, ax = _axes("ω (rad/s)", "Re 1/Z_c (m/(N·s))")
    period = published.period
    omega = np.geomspace(10.0, np.pi / period * 0.9999, 401)
    for coupling in (THEORETICAL, published.tuned):
        admittance = np.asarray(coupling_admittance(published.loop, omega, coupling)).real
        label = f"{float(coupling.stiffness) / 1e3:g} kN/m"
        ax.loglog(omega, admittance, label=label)
    bound = coupling_bound(Loop(Device(published.device.mass, needed), period), omega)
    ax.loglog(omega, bound, color="black", label=f"bound, {needed:.4g} N·s/m")
    ax.legend()
    return figure


def _curves(
    published: Published, device: Device, wall: Wall, coupling: Coupling | None, omega: Array
) -> Figure:
    """Draw boundaries and reference for a device, and the reference through a coupling."""
    figure, ax = _axes("ω (rad/s)", "|Z_h| (N·s/m)")
    label = f"boundaries, {published.limits.level:.0%} limits of k and b"
    for end in corner_curves(Loop(device, published.period), omega, wall.stiffness, wall.damping):
        ax.plot(omega, end, color="tab:blue", label=label)
        label = "_"
    direct = published.felt(omega, wall.environment, device=device)
    ax.plot(omega, direct, color="black", linestyle="--", label="reference")
    if coupling is not None:
        coupled = published.felt(omega, wall.environment, device=device, coupling=coupling)
        ax.plot(omega, coupled, color="tab:green", label="through the coupling")
    if omega[-1] > 2.0 * omega[0]:
        ax.set_xscale("log")
        ax.set_yscale("log")
    ax.set_title(f"{wall.name}: {wall.k:g} N/m, {wall.b:g} N·s/m")
    ax.legend()
    return figure

"""The paper's figures drawn again."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from percept.haptics import Coupling, Device, Loop, corner_curves, required_damping
from percept.haptics.impedance import coupling_admittance
from percept.haptics.stability import coupling_bound
from percept.report.figures.canvas import Drawing, Frame, legend, panels
from percept.report.figures.curves import Limits, draw_magnitude, draw_stability
from reports.hbfd import devices
from reports.hbfd.devices import Panel, over_devices
from reports.hbfd.published import THEORETICAL, Array, Published, Wall

_KILO = 1e3  # N/m in kN/m
_PAIR = (86.0, 72.0)  # mm, width and height: two figures stand side by side
# rad/s; the paper's axes reach past the device's resonances at 300
_WIDE = np.geomspace(0.1, 1000.0, 241)
_CLOSE = 121  # Points over an enlarged panel


def drawings(published: Published) -> list[Drawing]:
    """Return every figure of the page; nothing is drawn yet."""
    drawn = [_fig4(published), _fig5(published)]
    for panel, letter in zip(devices.panels(published), "ace", strict=True):
        drawn += [_whole(published, panel, letter), _enlarged(published, panel)]
    return drawn


def _fig4(published: Published) -> Drawing:
    needed = published.needed()
    period = published.period

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, frame=Frame(left=18, top=3))
        nyquist = np.pi / period
        omega = np.geomspace(10.0, nyquist * 0.9999, 401)
        bound = coupling_bound(Loop(Device(published.device.mass, needed), period), omega)
        lines = {}
        for coupling in (THEORETICAL, published.tuned):
            admittance = coupling_admittance(
                published.loop, omega, coupling, discretization="backward"
            )
            binds = float(required_damping(published.loop, coupling).omega)
            lines[_stiffness(coupling)] = np.asarray(admittance).real, binds
        draw_stability(ax, omega, bound, lines)

    return Drawing(
        "fig-4",
        "Fig. 4: Eq. 10 for the theoretical and the tuned coupling",
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
        ends = corner_curves(Loop(device, published.period), omega, wall.stiffness, wall.damping)
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

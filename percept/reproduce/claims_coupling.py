"""Claims on what a coupling does to the impedance that is felt, and to realism."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from percept.haptics import Coupling, Device, environment_impedance, magnitude_envelope
from percept.reproduce.devices import (
    DAMPINGS,
    MASSES,
    change_over_band,
    coupled_inside,
    direct_inside,
    most_passed,
    panels,
    share_true,
)
from percept.reproduce.evidence import Evidence, evidence
from percept.reproduce.published import LOOKED_AT, Array, Published, Wall
from percept.reproduce.squares import cells, envelope_squares, felt_square, rendered_square, share

__all__ = [
    "affects_realism",
    "always_smaller",
    "coupling_unnoticed",
    "lower_or_medium",
    "suits_high",
]

_HIGH = 2  # VE4 and VE5: the paper calls them high and very high impedance


def coupling_unnoticed(published: Published) -> Evidence:
    """Judge whether the coupling does not matter at very low impedance."""
    panel, _, _ = panels(published)
    part, device = most_passed(published, panel)
    own = float(change_over_band(published, panel, published.device).max())
    return evidence(
        [part == 0, own < 1],
        part=part,
        own=own,
        mass=float(device.mass),
        damping=float(device.damping),
        most_mass=MASSES[-1],
        most_damping=DAMPINGS[-1],
    )


def suits_high(published: Published) -> Evidence:
    """Judge whether a coupling suits high impedance and harms low."""
    felt = {}
    losses = {}
    inside = []
    for wall in published.softest_first:
        stiffness, _ = published.through_coupling(wall)
        felt[wall.name] = stiffness
        losses[wall.name] = 1 - stiffness / wall.k
        low, high = wall.stiffness
        if low <= stiffness <= high:
            inside.append(wall.name)
    parts = list(losses.values())
    falls = [soft >= stiff for soft, stiff in pairwise(parts)]
    told = ", ".join(f"{part:.2%} ({name})" for name, part in losses.items())
    if any(falls):
        told = f"The stiffness lost does not rise with the wall’s: {told}."
    else:
        told = (
            f"The opposite is true: the coupling takes {told} of the stiffness, more the stiffer"
            " the wall."
        )
    highest = list(losses)[-_HIGH:]
    return evidence(
        [*(name in inside for name in highest), *falls],
        high=[name for name in highest if name in inside],
        told=told,
        inside=inside,
        most=parts[-1],
        felt=felt,
    )


def always_smaller(published: Published) -> Evidence:
    """Judge whether what is felt through the coupling is always below the virtual environment."""
    shares = {wall.name: _share_below(published, wall) for wall in published.walls}
    least = min(published.walls, key=lambda wall: shares[wall.name])
    alone = np.abs(environment_impedance(LOOKED_AT, least.environment, published.period))
    cases = []
    for part in shares.values():
        cases += [part > 0, part == 1.0]
    return evidence(
        cases,
        always=[name for name, part in shares.items() if part == 1.0],
        shares=shares,
        worst=least.name,
        least=shares[least.name],
        others={name: part for name, part in shares.items() if name != least.name},
        with_it=float(published.felt(LOOKED_AT, least.environment, coupling=published.tuned)),
        alone=float(alone),
    )


def _share_below(published: Published, wall: Wall) -> float:
    """Return the share of the range over which |Z_h_vc| is below |Z_e|."""
    period = published.period
    coupling = published.tuned
    felt_curve = felt_square(published.device, wall.environment, period, coupling=coupling)
    rendered_curve = rendered_square(wall.environment, period)
    edges, middles = cells([felt_curve, rendered_curve], *published.span, period)
    rendered = np.abs(environment_impedance(middles, wall.environment, period))
    felt = published.felt(middles, wall.environment, coupling=coupling)
    return share(edges, felt < rendered)


def lower_or_medium(published: Published) -> Evidence:
    """Judge whether the coupling takes low and medium impedances out of the boundaries."""
    spoilt, _ = _spoilt(published)
    coupled = {}
    direct = {}
    for wall in published.softest_first[:-_HIGH]:
        coupled[wall.name] = share_true(published, wall, coupled_inside)
        direct[wall.name] = share_true(published, wall, direct_inside)
    cases = [part < 1 for part in coupled.values()]
    cases += [name in spoilt for name in coupled]
    lost = list(dict.fromkeys(spoilt))
    return evidence(cases, lost=lost, coupled=coupled, direct=direct, least=min(coupled.values()))


def affects_realism(published: Published) -> Evidence:
    """Judge the conclusion that a static coupling can spoil realism, by the next user's boundary."""
    spoilt, tried = _spoilt(published)
    names = list(dict.fromkeys(spoilt))
    return evidence([bool(spoilt)], names=names, spoilt=len(spoilt), tried=tried)


def _spoilt(published: Published) -> tuple[list[str], int]:
    """Return the environments that only the coupling takes out, once a device, and how many were tried."""
    masses = (0.0, *MASSES[::14].tolist())
    spoilt = []
    for wall, box in zip(published.walls, published.next_user, strict=True):
        for mass in masses:
            device = Device(mass, published.device.damping)
            direct = _inside(published, wall, device, box, None)
            if direct and not _inside(published, wall, device, box, published.tuned):
                spoilt.append(wall.name)
    return spoilt, len(published.walls) * len(masses)


def _inside(
    published: Published, wall: Wall, device: Device, box: Array, coupling: Coupling | None
) -> bool:
    """Say whether a reference stays inside the envelope of a box of k and b at every perceivable ω."""
    period = published.period
    own = felt_square(device, wall.environment, period, coupling=coupling)
    # The pieces of the envelope change places among themselves too; only the curve's own crossings
    # with them matter.
    edges = np.array([])
    for piece in envelope_squares(device, box, period):
        cuts, _ = cells([own, piece], *published.span, period)
        edges = np.union1d(edges, cuts)
    middles = np.sqrt(edges[1:] * edges[:-1])
    lower, upper = magnitude_envelope(middles, device, box[0], box[1], period)
    felt = published.felt(middles, wall.environment, coupling=coupling, device=device)
    return bool(((lower <= felt) & (felt <= upper)).all())

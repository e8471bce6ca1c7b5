"""Claims that turn on what is printed, left out, or said of perception."""

from __future__ import annotations

import numpy as np

from percept.haptics import Environment, environment_impedance, perceived_impedance
from percept.reproduce.claims.record import Claim, Quantity
from percept.reproduce.published import LOOKED_AT, TEXT_REFERENCES, Published

# Where thresholds of vibration are usually measured, Hz: the fast and slow mechanoreceptors of the hand.
_TOUCH_HERTZ = (40.0, 250.0)
_SAME = 1e-3
_MASSES = (0.0, *np.geomspace(1e-4, 100.0, 121))


def environments_in_text(published: Published) -> Claim:
    """Judge whether section 4 lists the environments of Table 1."""
    table = {(wall.k, wall.b) for wall in published.walls}
    text = set(TEXT_REFERENCES)
    return Claim.judged(
        "environments-in-text",
        place="Section 4",
        paper="The text lists five cases of the reference environment.",
        cases=[wall in text for wall in sorted(table)],
        condition="the case printed twice is replaced by the one Table 1 has instead",
        finding=f"The text prints {len(text)} different environments, Table 1 has {len(table)}; "
        f"{len(table - text)} of them is not in the text. Table 1’s are used.",
        margin=Quantity("environments the text lacks", len(table - text)),
        numbers=[Quantity("different environments in the text", len(text))],
        source="percept.reproduce.published.TEXT_REFERENCES; datasets/hbfd_table1.csv",
    )


def substitution(published: Published) -> Claim:
    """Judge the substitution of Tustin's method as Eqs 5 and 7 print it, where Fig. 7 looks closely."""
    period = published.period
    z = np.exp(1j * LOOKED_AT * period)
    printed = complex(2 / period * (z - 1 / z + 1))
    meant = complex(2 / period * (z - 1) / (z + 1))
    true = 1j * (2 / period) * np.tan(LOOKED_AT * period / 2)
    return Claim.judged(
        "substitution",
        place="Eqs 5, 7",
        paper="Tustin’s method replaces s by (2/T)(z − 1/z + 1).",
        cases=[abs(printed - true) <= _SAME * abs(true), abs(meant - true) <= _SAME * abs(true)],
        condition="it is read as (2/T)(z − 1)/(z + 1), as Eq. 12 prints it",
        finding=f"At {LOOKED_AT:g} rad/s the printed form gives |s| = {abs(printed):.4g} 1/s, Eq. 12’s "
        f"{abs(meant):.6g}, as it should be.",
        margin=Quantity("printed |s| over the true one", abs(printed) / abs(true)),
        source="percept.haptics.environment_impedance (Eq. 12's form throughout)",
    )


def felt_and_rendered(published: Published) -> Claim:
    """Judge the conclusion's Z_e in the place of Z_h."""
    ratios = {}
    for wall in published.walls:
        rendered = environment_impedance(LOOKED_AT, wall.environment, published.period)
        felt = perceived_impedance(LOOKED_AT, published.device, wall.environment, published.period)
        ratios[wall.name] = abs(abs(complex(felt)) / abs(complex(rendered)) - 1)
    worst = max(ratios, key=ratios.__getitem__)
    return Claim.judged(
        "felt-and-rendered",
        place="Section 6",
        paper="The boundaries are of the perceived impedance, written Z_e.",
        cases=[ratio <= _SAME for ratio in ratios.values()],
        condition="the environment outweighs the device",
        finding=f"Z_h is meant. With the scene’s device |Z_h| differs from |Z_e| at {LOOKED_AT:g} rad/s by "
        f"{min(ratios.values()):.2%} to {ratios[worst]:.1%} ({worst}).",
        margin=Quantity("largest difference of |Z_h| from |Z_e|", ratios[worst], "1"),
        source="percept.haptics.perceived_impedance, environment_impedance",
    )


def mass_left_out(published: Published) -> Claim:
    """Judge whether the figures follow from the numbers given, the mass m_e being left out."""
    wall, _ = published.drawn[1]
    low, high = (Environment(k, b) for k, b in zip(wall.stiffness, wall.damping, strict=True))

    def felt(environment: Environment, mass: float, *, coupled: bool) -> float:
        heavy = Environment(environment.stiffness, environment.damping, mass)
        coupling = published.tuned if coupled else None
        return abs(
            complex(
                perceived_impedance(LOOKED_AT, published.device, heavy, published.period, coupling=coupling)
            )
        )

    kept = []
    for mass in _MASSES:
        ends = sorted((felt(low, mass, coupled=False), felt(high, mass, coupled=False)))
        coupled = felt(wall.environment, mass, coupled=True)
        kept.append(ends[0] <= coupled < felt(wall.environment, mass, coupled=False) <= ends[1])
    until = _MASSES[max(kept.index(False) - 1, 0)] if False in kept else _MASSES[-1]
    return Claim.judged(
        "mass-left-out",
        place="Eq. 7, section 4",
        paper="The figures follow from the numbers given; no mass m_e is.",
        cases=kept,
        condition=f"m_e is at most about {until:.3g} kg; percept takes 0",
        finding=f"What Fig. 7d shows of {wall.name} stays true at {LOOKED_AT:g} rad/s for an m_e up to about "
        f"{until:.3g} kg with the scene’s device.",
        margin=Quantity("largest m_e tried that keeps Fig. 7d", until, "kg"),
        source="percept.haptics.perceived_impedance(omega, device, Environment(k, b, mass), period)",
    )


def perceivable_range(published: Published) -> Claim:
    """Judge the statement that forces are felt below 100 rad/s only."""
    top = published.scene.frequency.upper
    felt = [2 * np.pi * hertz for hertz in _TOUCH_HERTZ]
    return Claim.judged(
        "perceivable-range",
        place="Section 5",
        paper=f"People perceive force feedback below {top:g} rad/s.",
        cases=[omega <= top for omega in felt],
        condition="the vibration is slow",
        finding="Thresholds of touch are measured at "
        + " and ".join(
            f"{hertz:g} Hz, {omega:.4g} rad/s" for hertz, omega in zip(_TOUCH_HERTZ, felt, strict=True)
        )
        + f", beyond {top:g} rad/s. The range is a setting; the paper’s is used here.",
        margin=Quantity("touch beyond the range, lowest", min(felt) / top),
        source="[frequency] of the scene",
    )

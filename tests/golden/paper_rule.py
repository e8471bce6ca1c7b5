"""What the paper's rule says by a study's classical limits."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from percept import Study, haptics
from percept.haptics.perceived import Boxes
from percept.haptics.shown import ON_LIMIT, departure
from percept.study.device import Setup

__all__ = ["by_the_paper_s_rule"]

#: Of the scene's mass and damping, for the devices that verdicts are given for.
_TIMES = (0.125, 1.0, 8.0)


def by_the_paper_s_rule(study: Study) -> dict[str, Any]:
    """Take what is frozen of the rule "curve between curves"."""
    setup = study.setup
    if setup is None:
        return {}
    found = {}
    if setup.coupling is not None:
        found |= _memberships(study, setup)
    if isinstance(setup.loop.device, haptics.Device):
        found |= _devices(study, setup)
    return found


def _memberships(study: Study, setup: Setup) -> dict[str, Any]:
    found: dict[str, Any] = {}
    read_at = study.scene.frequency.read_at
    for region in study.regions:
        if region.method != "classical" or region.limits is None:
            continue
        if region.environment not in setup.references:
            continue
        labels = region.environment, region.kind, region.family, region.joint
        reference = setup.references[region.environment]
        shown = haptics.effective_impedance(setup.loop, read_at, reference, setup.coupling)
        box = Boxes.of(*region.limits)
        verdicts = []
        for coupled in (False, True):
            display = setup.display(region.environment, coupled=coupled)
            verdicts.append(departure(display, box, *study.data.within).verdict)
        name = " ".join(("realism", *labels, "envelope"))
        found[f"{name} verdict"] = verdicts
        found[f"{name} effective"] = [[float(shown.stiffness)], [float(shown.damping)]]
    return found


def _limits(study: Study, kind: str) -> dict[str, Any]:
    """Rectangles of a kind, in the scene's family, by environment."""
    family = study.scene.inference.family
    wanted = ("classical", kind, "marginal", family)
    return {
        region.environment: region.limits
        for region in study.regions
        if (region.method, region.kind, region.joint, region.family) == wanted
        and region.limits is not None
    }


def _devices(study: Study, setup: Setup) -> dict[str, Any]:
    """Judge nine devices about the scene's."""
    masses, dampings = (
        [value * times for times in _TIMES] if value else [0.0, *_TIMES[1:]]
        for value in (float(setup.loop.device.mass), float(setup.loop.device.damping))
    )
    inside = {}
    for kind in study.scene.inference.kinds:
        counts = np.zeros((len(dampings), len(masses)), dtype=int)
        for environment, limits in _limits(study, kind).items():
            for place in np.ndindex(counts.shape):
                device = _varied(setup, masses[place[1]], dampings[place[0]])
                display = device.display(environment, coupled=setup.coupling is not None)
                departed = departure(display, Boxes.of(*limits), *study.data.within)
                counts[place] += departed.largest <= ON_LIMIT
        inside[str(kind)] = counts.tolist()
    needed = None
    verdicts: list[list[str | None]] = [[None] * len(masses) for _ in dampings]
    if setup.coupling is not None:
        need = haptics.required_damping(setup.loop, setup.coupling)
        needed = float(need.damping)
        for i, j in np.ndindex(len(dampings), len(masses)):
            loop = _varied(setup, masses[j], dampings[i]).loop
            stability = haptics.absolute_stability(loop, setup.coupling)
            verdicts[i][j] = stability.verdict
    return {
        "sensitivity required_damping": needed,
        "sensitivity verdict": verdicts,
        "sensitivity inside": inside,
    }


def _varied(setup: Setup, mass: float, damping: float) -> Setup:
    return setup.with_device(dataclasses.replace(setup.loop.device, mass=mass, damping=damping))

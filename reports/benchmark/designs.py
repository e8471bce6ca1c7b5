"""Ordinary studies of many shapes: what a fit costs in time and memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from percept.errors import RefusalError, UsageError
from reports.benchmark.simulated import DESIGNS, StudyDesign, simulated
from reports.calibration.studies import KINDS, Kind, draw_study
from reports.fitted import by_percept
from reports.measure import in_a_process
from reports.page import Page, say
from reports.studies import Observed

_FACTOR = Kind(16, 5, (3, 3), factors=("hand",))
#: Drawn from the prior. Of those with subjects' own trial SDs a plain design is the same with one.
FACTORS: Mapping[str, Kind] = {
    "16x5x2x3, factor": _FACTOR,
    "300x5x2x3, factor": replace(_FACTOR, subjects=300),
    "40x6x10, own trial SDs": Kind(40, 6, (10, 10), own_trial_sds=True),
    **{name: kind for name, kind in KINDS.items() if kind.factors or kind.own_trial_sds},
}
STUDIES: Mapping[str, StudyDesign | Kind] = {**DESIGNS, **FACTORS}

_TOLERANCE = 0.01  # percept's default
_PATIENCE = 900.0  # s that a process may take
_INTRODUCTION = """\
Fits of simulated studies to the default tolerance, each in a process of its own. A design is
subjects x environments x trials. weak: sigma_w = 0.02. none: sigma_w = 0, and a correlation of 0.9.
irregular: a fifth of the cells missing, and 1 to 4 trials (10x5: 1 to 6; 40x20: 2 to 5, none
missing). outlier: one subject three times off. k: stiffness only. Others are drawn from the prior.
Times and memory are those of the whole process, imports included. `error` is the largest Monte
Carlo error over the half-width, `tau` the autocorrelation time of the slowest limit in steps."""


def study_of(name: str, seed: int) -> Observed:
    """Draw a study of a design; UsageError for a name that is none."""
    if name not in STUDIES:
        raise UsageError(f"no such design; there are {', '.join(STUDIES)}.", value=name)
    study = STUDIES[name]
    if isinstance(study, StudyDesign):
        return simulated(study, seed)
    return draw_study(study, np.random.default_rng(seed)).observed


def notes_of_fit(name: str, seed: int) -> dict[str, float]:
    """Fit one study to the default tolerance, and return what its user would look at."""
    return by_percept(study_of(name, seed), _TOLERANCE, seed).notes


def page(out: Path, *, rows: tuple[str, ...] = tuple(STUDIES), seeds: int = 3) -> Page:
    """Fit studies of many shapes, and say what that takes.

    Parameters
    ----------
    out : Path
        Folder of the page.
    rows : tuple of str
        Names of the designs.
    seeds : int
        Studies of each.

    Returns
    -------
    Page
    """
    found: list[list[object]] = []
    failed = []
    for name in rows:
        for seed in range(1, seeds + 1):
            say(f"{name}, seed {seed}")
            study_of(name, seed)
            try:
                notes, cost = in_a_process(notes_of_fit, name, seed, timeout=_PATIENCE)
            except RefusalError as error:
                failed.append(f"{name} (seed {seed}): {error.message}")
                continue
            told = [notes[key] for key in ("steps", "tau", "R-hat", "error")]
            found.append([name, seed, cost.processor, cost.wall, cost.memory, *told])
            if not notes["passed"]:
                failed.append(f"{name} (seed {seed}): the gate did not pass.")
    page = Page("Designs", _INTRODUCTION, right=not failed)
    heads = ["design", "seed", "processor, s", "wall, s", "memory, MB"]
    page.table([*heads, "steps", "tau", "R-hat", "error"], found)
    page.add("\n".join(f"- {line}" for line in failed) or "All fits pass the gate.")
    return page

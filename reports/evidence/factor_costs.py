"""What a fit costs in studies with factors, covariates or trial SDs of subjects' own.

Each study is simulated and fitted to the default tolerance in a process of its own. The time is
processor time from the opened study to its intervals, without imports.
"""

from __future__ import annotations

import itertools
import json
import sys
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
import pandas as pd

from percept import Scene, Study
from percept.provenance import Made, markdown_table
from percept.sessions import ReadOptions, Sessions
from reports.benchmark.measure import in_a_process, print_result
from reports.command import say

PAGE = """# What factors, covariates and subjects' own trial SDs cost

Simulated studies of stiffness and damping, fitted at 99 % to the default tolerance. `s` is the
processor time from the opened study to its intervals, without imports: the median of {repeats}
processes. `times` is the same over the time of the study named beside it.

{table}

{made}
"""


@dataclass(frozen=True)
class Case:
    """A simulated study, and what its fit may cost."""

    name: str
    subjects: int
    environments: int
    factors: Sequence[str] = ()  # Each has two levels, which every subject meets
    covariate: bool = False  # A column that varies by trial
    trials: int = 2
    family: str = "lognormal"
    own_trial_sds: bool = False
    allowed_s: float | None = None
    against: str = ""  # The case that its time is compared with
    allowed_times: float | None = None


def _cases() -> dict[str, Case]:
    text = resources.files("reports.evidence").joinpath("factor_costs.toml").read_text("utf-8")
    return {name: Case(name, **fields) for name, fields in tomllib.loads(text).items()}


CASES = _cases()


def simulated_study(case: Case, seed: int = 1) -> Study:
    """Draw the trials of a case, and open them as a study."""
    rng = np.random.default_rng(seed)
    shape = (case.environments, *(2 for _ in case.factors))
    reference = np.geomspace(10.0, 10_000.0, case.environments)
    shift = rng.normal(0.0, 0.1, (case.subjects, 1, 2))
    own = shift + rng.normal(0.0, 0.08, (case.subjects, int(np.prod(shape)), 2))
    trial_sd = 0.05 * np.exp(0.4 * rng.standard_normal(case.subjects) * case.own_trial_sds)
    rows = []
    for subject in range(case.subjects):
        for cell, (environment, *levels) in enumerate(itertools.product(*map(range, shape))):
            for trial in range(1, case.trials + 1):
                start = rng.normal()
                response = own[subject, cell] + 0.05 * sum(levels) + 0.02 * start
                response = response + trial_sd[subject] * rng.standard_normal(2)
                k = reference[environment]
                b = 0.01 * k
                adjusted = np.array([k, b]) * np.exp(response)
                names = [f"S{subject}", f"VE{environment}", k, b, trial, start, *adjusted]
                rows.append([*names, *(f"level {level}" for level in levels)])
    columns = ["subject", "environment", "k_ref", "b_ref", "trial", "start", "k_adj", "b_adj"]
    table = pd.DataFrame(rows, columns=[*columns, *case.factors])
    terms = " * ".join(case.factors)
    if case.covariate:
        terms += " + start"
    model: dict[str, Any] = {"subjects_trial_sd": case.own_trial_sds}
    if terms:
        model["bias"] = terms
    inference = {"method": "bayesian", "level": 0.99, "family": case.family}
    scene = Scene(model=model, inference=inference)
    sessions = Sessions.from_frame(table, scene=ReadOptions.from_mapping(dict(scene)))
    return Study(sessions, scene)


def fit_time(case: Case) -> float:
    """Return the processor time of one fit, in s."""
    study = simulated_study(case)
    start = time.process_time()
    assert len(study.intervals)
    return time.process_time() - start


def row_of(case: Case, seconds: Mapping[str, float]) -> list[str]:
    """Return the cells of a row: study, time, what it is compared with, and what was allowed."""
    times = ""
    allowed = ""
    if case.against:
        times = f"{seconds[case.name] / seconds[case.against]:.1f} of {case.against}"
        allowed = f"{case.allowed_times:g} times"
    if case.allowed_s is not None:
        allowed = f"{case.allowed_s:g} s"
    return [case.name, f"{seconds[case.name]:.1f}", times, allowed]


def page(repeats: int, made: Made) -> str:
    """Fit every case in processes of its own, and write the page."""
    times: dict[str, list[float]] = {name: [] for name in CASES}
    # Rounds, not case by case: what else the machine does falls on all of them.
    for _ in range(repeats):
        for name, seconds in times.items():
            seconds.append(in_a_process(__name__, name)["seconds"])
            say(f"{name}: {seconds[-1]:.1f} s")
    median = {name: float(np.median(each)) for name, each in times.items()}
    rows = [row_of(case, median) for case in CASES.values()]
    table = markdown_table(["study", "s", "times", "allowed"], rows)
    return PAGE.format(repeats=repeats, table=table, made=made.sentence)


def _main(task: str) -> None:
    """Print the time of one case."""
    print_result({"seconds": fit_time(CASES[json.loads(task)])})


if __name__ == "__main__":
    _main(sys.argv[1])

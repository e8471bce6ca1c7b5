"""What whole commands cost: over importing libraries, by what a scene skips, by a study's size."""

from __future__ import annotations

import itertools
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from percept import Scene, Sessions, Study, read_sessions
from reports import dataset
from reports.calibration.studies import Kind, draw_study
from reports.measure import Cost, in_a_process, run_python
from reports.page import Page, say

_LIBRARIES = "numpy, scipy.stats, pandas, emcee, xarray, h5netcdf, matplotlib.pyplot"
_IMPORTS = ("-c", f"import {_LIBRARIES}")
_PERCEPT = ("-m", "percept")
#: Nothing draws, and matplotlib is not imported.
_WITHOUT_FIGURES = """
import sys
from types import SimpleNamespace
sys.modules["percept.report.figures"] = SimpleNamespace(drawings=lambda *_: [])
sys.modules["percept.report.figures.canvas"] = SimpleNamespace(draw_all=lambda *_, **__: {})
from percept.cli import main
sys.exit(main(sys.argv[1:]))
"""
_REPORT = ("report", "SESSIONS", "--scene", "SCENE", "--out", "OUT", "--seed", "SEED")
#: Name to arguments of Python. SESSIONS, SCENE, OUT and the round's SEED are filled in.
COMMANDS: dict[str, tuple[str, ...]] = {
    "report": (*_PERCEPT, *_REPORT),
    "report without figures": ("-c", _WITHOUT_FIGURES, *_REPORT),
    "report --method classical": (*_PERCEPT, *_REPORT, "--method", "classical"),
    "fit": (*_PERCEPT, "fit", *_REPORT[1:]),
    "validate": (*_PERCEPT, "validate", "SESSIONS", "--scene", "SCENE"),
}
#: Scenes by what each leaves out of the published study.
SCENES = ("nothing", "coupling", "device", "one parameter", "all but one environment", "bayesian")
#: Packages, of others and of ours, that some scene does without.
_PACKAGES = ("emcee", "arviz_base", "arviz_stats", "xarray", "matplotlib.figure")


_SCENE = """
[device]
mass = 1.0
damping = 5.0
period = 0.001
[coupling]
stiffness = 50000
damping = 100
"""
_PLAIN = Kind(10, 5)
_FACTORS = ("hand", "load", "tool")
#: What grows, and the studies of its ladder. A factor of two levels doubles the cells.
LADDERS: Mapping[str, Mapping[int, Kind]] = {
    "subjects": {n: replace(_PLAIN, subjects=n) for n in (10, 20, 40, 80, 160)},
    "environments": {n: replace(_PLAIN, environments=n) for n in (5, 10, 20, 40)},
    "trials": {n: replace(_PLAIN, trials=(n, n)) for n in (1, 2, 4, 8, 16)},
    "cells of factors": {2**n: replace(_PLAIN, factors=_FACTORS[:n]) for n in range(4)},
}
#: Studies by size, and the method they are analysed by.
LARGE: Mapping[str, tuple[Kind, str]] = {
    "100 x 160": (replace(_PLAIN, subjects=100, environments=160), "both"),
    "315 x 60": (replace(_PLAIN, subjects=315, environments=60), "classical"),
    "16 x 5 x 2, 36 trials, own trial SDs": (
        Kind(16, 5, (36, 36), ("hand",), own_trial_sds=True),
        "both",
    ),
}


def timed(
    commands: Mapping[str, Sequence[str]], rounds: int
) -> tuple[dict[str, Cost], dict[str, Cost]]:
    """Run commands round by round, importing libraries before each, and keep the least of each.

    Returns
    -------
    dict of str to Cost
        Of the commands: least wall time, least processor time, least memory.
    dict of str to Cost
        The same of the imports around each.
    """
    costs: dict[str, list[Cost]] = {name: [] for name in commands}
    imports: dict[str, list[Cost]] = {name: [] for name in commands}
    sessions = str(dataset("hbfd_sessions.csv"))
    scene = str(dataset("hbfd.toml"))
    for seed in range(1, rounds + 1):
        for name, words in commands.items():
            say(f"round {seed}: {name}")
            imports[name].append(run_python(*_IMPORTS)[1])
            with tempfile.TemporaryDirectory() as folder:
                out = str(Path(folder, "out"))
                values = {"SESSIONS": sessions, "SCENE": scene, "OUT": out, "SEED": str(seed)}
                costs[name].append(run_python(*(values.get(word, word) for word in words))[1])
            imports[name].append(run_python(*_IMPORTS)[1])
    return least(costs), least(imports)


def least(costs: Mapping[str, Iterable[Cost]]) -> dict[str, Cost]:
    """Return the least of every part of a cost: other work on the machine only adds."""
    found = {}
    for name, each in costs.items():
        parts = [astuple(cost) for cost in each]
        found[name] = Cost(*np.min(parts, axis=0).tolist())
    return found


def study_without(without: str, *, tolerance: float = 0.01, points: int | None = None) -> Study:
    """Open the published study, one thing left out; `points` makes its grid coarser."""
    tables = Scene.load(dataset("hbfd.toml")).to_dict()
    tables["inference"]["tolerance"] = tolerance
    if points is not None:
        tables["frequency"]["points"] = points
    if without in ("coupling", "device"):
        del tables[without]
    if without == "bayesian":
        tables["inference"]["method"] = "classical"
    if without == "one parameter":
        tables["inference"]["parameters"] = ["k"]
    sessions = read_sessions(dataset("hbfd_sessions.csv"))
    if without == "all but one environment":
        table = sessions.table
        sessions = Sessions.from_frame(table[table["environment"] == sessions.environments[0]])
    return Study(sessions, Scene(**tables))


def not_imported(without: str, tolerance: float = 0.01) -> list[str]:
    """Write the report of a scene, and return the packages that it does without."""
    with tempfile.TemporaryDirectory() as folder:
        study_without(without, tolerance=tolerance).report(Path(folder) / "out")
    return [name for name in _PACKAGES if name not in sys.modules]


def sessions_of(kind: Kind, seed: int = 1) -> pd.DataFrame:
    """Draw the trials of a study, as a file of sessions has them."""
    study = draw_study(kind, np.random.default_rng(seed)).observed
    columns: dict[str, Any] = {
        "subject": [f"S{number}" for number in study.subject],
        "environment": [f"VE{number}" for number in study.environment[study.cell]],
    }
    for p, name in enumerate(study.parameters):
        reference = 1000.0 / 100.0**p * 10.0 ** study.x[p, study.cell]
        columns[f"{name}_ref"] = reference
        columns[f"{name}_adj"] = reference * np.exp(study.response[:, p])
    for factor, contrast in study.contrast.items():
        columns[factor] = np.where(contrast[study.cell] > 0, "second", "first")
    table = pd.DataFrame(columns)
    cells = ["subject", "environment", *study.factors]
    return table.assign(trial=table.groupby(cells).cumcount() + 1)


def report_of(kind: Kind, method: str = "both") -> tuple[Cost, float]:
    """Write the report of a simulated study; return its cost and the size of report.json, MB."""
    scene = _SCENE
    if kind.factors:
        scene += f'[model]\nbias = "{" + ".join(kind.factors)}"\n'
    with tempfile.TemporaryDirectory() as folder:
        sessions, scene_file, out = (Path(folder) / name for name in ("s.csv", "s.toml", "out"))
        sessions_of(kind).to_csv(sessions, index=False)
        scene_file.write_text(scene, encoding="utf-8")
        words = ["report", str(sessions), "--scene", str(scene_file), "--out", str(out)]
        _, cost = run_python(*_PERCEPT, *words, "--method", method)
        return cost, (out / "report.json").stat().st_size / 1e6


def exponent(seconds: Mapping[int, float]) -> float:
    """Return the power of an amount that time goes with, over the upper half of a ladder."""
    upper = list(seconds)[len(seconds) // 2 :]
    slope, _ = np.polyfit(np.log(upper), np.log([seconds[amount] for amount in upper]), 1)
    return float(slope)


def scale(out: Path) -> Page:
    """Time reports of larger studies, some twenty, and tell the powers that time goes with."""
    page = Page(
        "Reports of larger studies",
        "Ladders begin at 10 subjects and 5 environments with one trial of a cell, and one amount"
        " grows. Studies are drawn from the prior. Each report runs in a process of its own.",
    )
    rows: list[list[object]] = []
    powers = []
    for what, ladder in LADDERS.items():
        seconds = {}
        for amount, kind in ladder.items():
            say(f"{amount} {what}")
            cost, json_size = report_of(kind)
            seconds[amount] = cost.processor
            rows.append([f"{amount} {what}", "both", *astuple(cost), json_size])
        powers.append(f"{what} to the power {exponent(seconds):.2f}")
    for size, (kind, method) in LARGE.items():
        say(size)
        cost, json_size = report_of(kind, method)
        rows.append([size, method, *astuple(cost), json_size])
    page.table(["size", "method", "wall, s", "processor, s", "memory, MB", "JSON, MB"], rows)
    page.add(f"Over the upper half of each ladder processor time goes with {', '.join(powers)}.")
    return page


def page(out: Path, *, rounds: int = 7) -> Page:
    """Time whole commands on the published study.

    Parameters
    ----------
    out : Path
        Folder of the page.
    rounds : int
        Runs of each command and scene.

    Returns
    -------
    Page
    """
    page = Page(
        "What whole commands cost",
        f"Each runs in a process of its own and finds no posterior of an earlier one. The least of"
        f" {rounds} runs counts: other work on the machine only adds. `×` is over the time that"
        f" `import {_LIBRARIES}` takes before and after each run. All studies are simulated.",
        "## The published study",
    )
    costs, imports = timed(COMMANDS, rounds)
    rows = []
    for name, cost in costs.items():
        around = imports[name]
        ratios = [cost.wall / around.wall, cost.processor / around.processor]
        rows.append([name, cost.wall, ratios[0], cost.processor, ratios[1], cost.memory])
    page.table(["command", "wall, s", "×", "processor, s", "×", "memory, MB"], rows)
    page.add("## What a scene saves that leaves something out")
    page.table(["without", "processor, s", "share", "memory, MB", "not imported"], skipping(rounds))
    return page


def skipping(rounds: int) -> list[list[object]]:
    """Return a row of each scene; the first leaves nothing out."""
    costs: dict[str, list[Cost]] = {scene: [] for scene in SCENES}
    not_there: dict[str, list[str]] = {}
    for _, scene in itertools.product(range(rounds), SCENES):
        say(f"without {scene}")
        not_there[scene], cost = in_a_process(not_imported, scene)
        costs[scene].append(cost)
    found = least(costs)
    whole = found[SCENES[0]].processor
    rows: list[list[object]] = []
    for scene, cost in found.items():
        rows.append([scene, cost.processor, cost.processor / whole, cost.memory, not_there[scene]])
    return rows

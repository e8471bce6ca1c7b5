"""What whole commands cost: over importing libraries, by what a scene skips, by a study's size."""

from __future__ import annotations

import itertools
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from percept import Scene, Sessions, Study, read_sessions
from reports import dataset
from reports.measure import Cost, in_a_process, run_python
from reports.page import Page, say

_LIBRARIES = "numpy, scipy.stats, pandas, emcee, xarray, h5netcdf, matplotlib.pyplot"
_IMPORTS = ("-c", f"import {_LIBRARIES}")
_PERCEPT = ("-m", "percept")
_WITHOUT_FIGURES = """
import sys
import percept.report.figures
percept.report.figures.drawings = lambda results: []
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
_PACKAGES = ("emcee", "arviz_base", "arviz_stats", "xarray", "h5netcdf", "matplotlib.figure")


@dataclass(frozen=True)
class Size:
    """Of a simulated study; every subject meets every level of the factor."""

    subjects: int = 10
    environments: int = 5
    trials: int = 1
    levels: int = 1  # Of a factor; 1 for none
    method: str = "both"

    @property
    def name(self) -> str:
        """Subjects x environments x levels x trials."""
        parts = [self.subjects, self.environments, self.levels, self.trials]
        return " x ".join(map(str, parts))


#: What grows, and the sizes of its ladder.
LADDERS: Mapping[str, tuple[Size, ...]] = {
    "subjects": tuple(Size(subjects=n) for n in (10, 20, 40, 80, 160)),
    "environments": tuple(Size(environments=n) for n in (5, 10, 20, 40)),
    "trials": tuple(Size(trials=n) for n in (1, 2, 4, 8, 16)),
    "levels": tuple(Size(levels=n) for n in (1, 2, 4, 8)),
}
LARGE = (
    Size(100, 160),
    Size(315, 60, method="classical"),
    Size(16, 5, trials=36, levels=2),
)


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


def sessions_of(size: Size, seed: int = 1) -> pd.DataFrame:
    """Draw the trials of a study whose subjects differ in their trial SDs."""
    shape = (size.subjects, size.environments, size.levels, size.trials)
    subject, environment, level, trial = np.indices(shape).reshape(4, -1)
    rng = np.random.default_rng(seed)
    shift = rng.normal(0.0, 0.1, (size.subjects, 2))
    own = rng.normal(0.0, 0.08, (*shape[:3], 2))
    trial_sd = 0.05 * np.exp(0.4 * rng.standard_normal(size.subjects))
    log_ratio = shift[subject] + own[subject, environment, level] + 0.05 * level[:, None]
    log_ratio += trial_sd[subject, None] * rng.standard_normal(log_ratio.shape)
    stiffness = np.geomspace(10.0, 10_000.0, size.environments)[environment]
    columns: dict[str, Any] = {
        "subject": np.char.add("S", subject.astype(str)),
        "environment": np.char.add("VE", environment.astype(str)),
        "k_ref": stiffness,
        "b_ref": 0.01 * stiffness,
        "trial": trial + 1,
        "k_adj": stiffness * np.exp(log_ratio[:, 0]),
        "b_adj": 0.01 * stiffness * np.exp(log_ratio[:, 1]),
    }
    if size.levels > 1:
        columns["hand"] = np.char.add("level ", level.astype(str))
    return pd.DataFrame(columns)


def report_of(size: Size) -> tuple[Cost, float]:
    """Write the report of a simulated study; return its cost and the size of its page, MB."""
    say(f"{size.name}, {size.method}")
    scene = dataset("hbfd.toml").read_text(encoding="utf-8")
    if size.levels > 1:
        scene += '\n[model]\nbias = "hand"\n'
    with tempfile.TemporaryDirectory() as folder:
        sessions, scene_file, out = (Path(folder) / name for name in ("s.csv", "s.toml", "out"))
        sessions_of(size).to_csv(sessions, index=False)
        scene_file.write_text(scene, encoding="utf-8")
        words = ["report", str(sessions), "--scene", str(scene_file), "--out", str(out)]
        _, cost = run_python(*_PERCEPT, *words, "--method", size.method)
        return cost, (out / "report.html").stat().st_size / 1e6


def exponent(amounts: Sequence[int], seconds: Sequence[float]) -> float:
    """Return the power of an amount that time goes with, over the upper half of a ladder."""
    half = len(amounts) // 2
    slope, _ = np.polyfit(np.log(amounts[half:]), np.log(seconds[half:]), 1)
    return float(slope)


def add_scale(page: Page) -> None:
    """Add reports of larger studies to a page, and the powers that time goes with."""
    page.add("## Larger studies")
    page.add("A size is subjects x environments x levels of a factor x trials.")
    rows = []
    powers = []
    for what, sizes in [*LADDERS.items(), ("", LARGE)]:
        seconds = []
        for size in sizes:
            cost, page_size = report_of(size)
            seconds.append(cost.processor)
            rows.append([size.name, size.method, *astuple(cost), page_size])
        if what:
            power = exponent([getattr(size, what) for size in sizes], seconds)
            powers.append(f"{what} to the power {power:.2f}")
    page.table(["size", "method", "wall, s", "processor, s", "memory, MB", "page, MB"], rows)
    page.add(f"Over the upper half of each ladder processor time goes with {', '.join(powers)}.")


def page(out: Path, *, rounds: int = 7, scale: bool = False) -> Page:
    """Time whole commands on the published study, and reports of larger ones.

    Parameters
    ----------
    out : Path
        Folder of the page.
    rounds : int
        Runs of each command and scene.
    scale : bool
        Whether larger studies are analysed: some twenty reports.

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
    if scale:
        add_scale(page)
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

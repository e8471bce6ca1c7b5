"""Small studies, all of which get a page: subsets of the published one, and random ones."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from percept import Scene, Study, read_sessions
from percept.cli import main as percept
from percept.sessions import Sessions
from tests import DATASETS

__all__ = ["RANDOM", "curves_of", "pages_of", "random_study", "subsets"]

#: Random studies that the command makes a page of.
RANDOM = 80
#: Coarse, so that a fit takes about a second.
_TOLERANCE = 0.3
_PLACES = {
    "VE1": (10.0, 0.1),
    "VE2": (1000.0, 1.0),
    "VE3": (10_000.0, 10.0),
    "VE4": (20_000.0, 100.0),
    "VE5": (40_000.0, 50.0),
}
_DEVICE = """
[device]
mass = 1.0
damping = 5.0
period = 0.001
[coupling]
stiffness = 50e3
damping = 100.0
"""


def subsets(count: int) -> Iterator[tuple[str, ...]]:
    """Yield every choice of so many of the ten subjects; of four every third or fourth, 60 in
    all."""
    subjects = read_sessions(DATASETS / "hbfd_sessions.csv").subjects
    chosen = list(itertools.combinations(subjects, count))
    yield from chosen if count == 3 else (chosen[i * len(chosen) // 60] for i in range(60))


def curves_of(subjects: tuple[str, ...], environments: int = len(_PLACES)) -> Study:
    """Draw the curves of some of the published study's subjects, in its first environments."""
    table = read_sessions(DATASETS / "hbfd_sessions.csv").table
    table = table[table["environment"].isin(list(_PLACES)[:environments])]
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(tolerance=_TOLERANCE)
    study = Study(Sessions.from_frame(table[table["subject"].isin(subjects)]), scene)
    boundaries = study.boundaries
    assert boundaries
    for boundary in boundaries:
        limits = np.concatenate([boundary.lower, boundary.upper])
        assert np.isfinite(limits).all(), boundary
        assert boundary.error is None or boundary.error <= 10.0 * _TOLERANCE
    refused = [part.what for part in study.skipped_rows if " curves of " in part.what]
    shapes = [b for b in boundaries if b.shape in ("pointwise", "simultaneous")]
    # Every curve of a law is either drawn or said to be missing.
    assert len(shapes) + len(refused) >= 2 * len(study.curve_laws)
    return study


def random_study(seed: int, folder: Path) -> tuple[Path, Path]:
    """Write a random small study, its sessions and its scene."""
    rng = np.random.default_rng(seed)
    subjects = int(rng.integers(2, 7))
    places = dict(list(_PLACES.items())[: int(rng.integers(1, 6))])
    quantities = [("k", "b"), ("k",), ("b",)][int(rng.choice(3, p=[0.6, 0.2, 0.2]))]
    trials = int(rng.choice([1, 3]))
    factor = bool(rng.random() < 0.3)
    device = bool(rng.random() < 0.6)
    between = 10.0 ** rng.uniform(-4.0, np.log10(3.0))
    within = 10.0 ** rng.uniform(-4.0, np.log10(3.0))
    rows = []
    effects = between * rng.standard_normal((subjects, 2))
    grips = ("tight", "loose") if factor else ("tight",)
    for subject, place, grip in itertools.product(range(subjects), places, grips):
        references = places[place]
        for trial in range(1, trials + 1):
            adjusted = np.array(references) * np.exp(
                effects[subject] + within * rng.standard_normal(2)
            )
            row = {"subject": f"s{subject}", "environment": place, "trial": trial}
            row |= {f"{q}_ref": references["kb".index(q)] for q in quantities}
            row |= {f"{q}_adj": adjusted["kb".index(q)] for q in quantities}
            if factor:
                row["grip"] = grip
            rows.append(row)
    sessions = folder / f"{seed}.csv"
    pd.DataFrame(rows).to_csv(sessions, index=False)
    scene = folder / f"{seed}.toml"
    text = f"[inference]\ntolerance = {_TOLERANCE}\n"
    text += '[study]\nfactor = "grip"\n' if factor else ""
    scene.write_text(text + (_DEVICE if device else ""), encoding="utf-8")
    return sessions, scene


def pages_of(seed: int, folder: Path) -> list[str]:
    """Report a random study by the whole command, and return what it did not compute."""
    sessions, scene = random_study(seed, folder)
    out = folder / f"{seed}"
    told = ["report", str(sessions), "--scene", str(scene), "--out", str(out), "--quiet"]
    assert percept([*told, "--no-cache"]) == 0
    assert (out / "report.html").stat().st_size > 10_000
    document = json.loads((out / "report.json").read_text(encoding="utf-8"))
    return [f"{row['what']}: {row['why']}" for row in document["skipped"]]

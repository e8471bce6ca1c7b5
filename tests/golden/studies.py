"""The twelve studies, and what is frozen of each: numbers of report.json, and classical curves.

What users see makes them, `percept.Study` and report.json's fields. Files that are not in
`datasets/` stand in `data/`:

* `stiffness.csv`, `one_environment.csv` and `three_environments.csv` are subsets of the published
sessions.
* `repeats.csv` has 6 subjects, 3 environments and 3 trials, drawn once from the model. The SDs of k
and b on
  the log scale are 0.12 and 0.2 between subjects, 0.12 and 0.25 within an environment, 0.07 and
  0.12 between trials.
* `own_trials.csv` has 6 subjects, 3 environments and 4 trials, drawn once from the model. The
  log of a subject's trial SD has the SD 0.5 between subjects: they have trial SDs of their own.
* `conditions.csv` is part of what `crossed(subjects=8)` of `tests/study/within.py` draws: both
hands,
  two groups and a dose at two references. Three cells are missing.
* `response.csv` is a device of 0.8 kg and 4 N·s/m with a mode at 200 rad/s, as a sweep would give
it.

Of the classical report every number and short word of report.json is frozen. Of the Bayesian
method limits and probabilities are, which have a Monte Carlo error.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import percept
from tests import DATASETS
from tests.documents import build_document
from tests.fits import SHARED

__all__ = ["FOLDER", "SEED", "STUDIES", "TOLERANCE", "Golden", "flat", "frozen_part"]

FOLDER = Path(__file__).resolve().parent
_DATA = FOLDER / "data"
SEED = 1
TOLERANCE = 0.05
OMEGA = np.geomspace(0.1, 100.0, 25)
#: Of long lists every so manieth value is frozen.
_EVERY = 40
#: Letters of a word that is frozen; longer texts are sentences.
_LONGEST_WORD = 20
#: Parts of a document that say what went in, or what numbers say, or lie on grids for drawing.
_OTHERS = (
    "schema", "provenance", "summary", "skipped", "boundaries", "impedances", "covers",
)  # fmt: skip
#: Fields that tell the rows of a table apart.
_LABELS = (
    "what", "quantity", "measure", "environment", "subject", "parameter", "factor", "level",
    "first", "second", "of", "kind", "method", "family", "joint", "shape", "model", "name",
    "statistic",
)  # fmt: skip
_LIMITS = {"lower", "estimate", "upper"}

Document = Mapping[str, Any]


@dataclass(frozen=True)
class Golden:
    """A study: its sessions and its scene."""

    name: str
    sessions: Path
    scene: Path

    def report(self, *, seed: int = SEED, **inference: Any) -> Document:
        """Return what `percept report` writes into report.json, checks included."""
        study = self.study(seed=seed, tolerance=TOLERANCE, **inference)
        document: Document = build_document(study)
        return document

    def study(self, *, curves: str = "family", **inference: Any) -> percept.Study:
        """Open the study, with other settings of the scene's [inference]."""
        scene = percept.Scene.load(self.scene).with_inference(**inference)
        shown = scene.report.model_dump(exclude_none=True)
        scene = scene.with_tables(report={**shown, "curves": curves}, checks={})
        sessions = percept.read_sessions(self.sessions, scene=scene)
        return percept.Study(sessions, scene, store=SHARED)


STUDIES = (
    Golden("published", DATASETS / "hbfd_sessions.csv", DATASETS / "hbfd.toml"),
    Golden("table1", DATASETS / "hbfd_table1.csv", DATASETS / "hbfd.toml"),
    Golden("one_parameter", _DATA / "stiffness.csv", _DATA / "stiffness.toml"),
    Golden("one_environment", _DATA / "one_environment.csv", _DATA / "curves.toml"),
    Golden("repeats", _DATA / "repeats.csv", _DATA / "curves.toml"),
    Golden("own_trials", _DATA / "own_trials.csv", _DATA / "stiffness.toml"),
    Golden("no_pooling", _DATA / "three_environments.csv", _DATA / "no_pooling.toml"),
    Golden("no_device", DATASETS / "hbfd_sessions.csv", _DATA / "no_device.toml"),
    Golden("tabulated", _DATA / "three_environments.csv", _DATA / "tabulated.toml"),
    Golden("stools", DATASETS / "stools.csv", DATASETS / "stools.toml"),
    Golden("growth", DATASETS / "growth.csv", DATASETS / "growth.toml"),
    Golden("conditions", _DATA / "conditions.csv", _DATA / "conditions.toml"),
)


def frozen_part(golden: Golden, classical: Document, document: Document) -> dict[str, Any]:
    """Take what is frozen: of the classical report all, of the scene's own what has an error."""
    study = golden.study(method="classical", curves="all")
    return {
        "exact": flat(classical),
        "curves": _curves(study),
        "endpoints": _endpoints(document),
        "estimates": _estimates(document),
        "skipped": sorted({row["what"] for row in document["skipped"]}),
    }


def _named(row: Mapping[str, Any], what: str, *names: str) -> str:
    return " ".join([what, *(str(row[name]) for name in names)])


def flat(document: Document) -> dict[str, Any]:
    """Gather the numbers and short words of a document, rows of tables by their labels.

    Long lists are thinned. Sentences are left out, and what the scene, versions and files say.
    """
    parts = {name: part for name, part in document.items() if name not in _OTHERS}
    found: dict[str, Any] = {}
    for name, value in _values(parts, ""):
        row, bracket, field = name.rpartition("].")
        if bracket:
            found.setdefault(f"{row}]", {})[field] = value
        else:
            found[field] = value
    for row in found.values():
        # Each is held to the largest of the three: an estimate may be all but zero.
        if isinstance(row, dict) and row.keys() >= _LIMITS:
            row["limits"] = [row.pop(name) for name in sorted(_LIMITS)]
    return found


def _values(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in _LABELS or not isinstance(inner, str):
                yield from _values(inner, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and any(isinstance(inner, dict) for inner in value):
        seen: Counter[str] = Counter()
        for inner in value:
            label = " ".join(inner[key] for key in _LABELS if isinstance(inner.get(key), str))
            seen[label] += 1
            again = f" {seen[label]}" if seen[label] > 1 else ""
            yield from _values(inner, f"{name}[{label}{again}]")
    elif isinstance(value, list):
        values = [inner[::_EVERY] if isinstance(inner, list) else inner for inner in value]
        yield name, values[::_EVERY] if len(values) > _EVERY else values
    elif not isinstance(value, str) or len(value) <= _LONGEST_WORD:
        yield name, value


def contrast_name(row: Mapping[str, Any]) -> str:
    """Name a contrast as messages of the sampler do."""
    where = row["environment"] or "overall"
    levels = f"{row['second']} against {row['first']}"
    return f"{row['parameter']}, {row['factor']}: {levels}, {where}"


def _curves(study: percept.Study) -> dict[str, dict[str, list[float]]]:
    found: dict[str, dict[str, list[float]]] = {}
    grid = {"lower": OMEGA[0], "upper": OMEGA[-1], "points": OMEGA.size}
    drawn = study.over(study.sessions, study.scene.with_tables(frequency=grid))
    for curve in drawn.boundaries:
        if curve.shape == "simultaneous":
            continue
        name = " ".join((curve.shape, curve.environment, curve.kind, curve.family, curve.joint))
        found[name] = {"lower": curve.lower.tolist(), "upper": curve.upper.tolist()}
        own = curve.reference if curve.coupled is None else curve.coupled
        found[f"reference {curve.environment}"] = {
            "lower": curve.reference.tolist(),
            "upper": own.tolist(),
        }
    return found


def _endpoints(document: Document) -> dict[str, dict[str, Any]]:
    gate = (document["diagnostics"] or {}).get("gate", {})
    found: dict[str, dict[str, Any]] = {}
    for row in document["intervals"]:
        if row["method"] == "bayesian":
            name = _named(row, "bayesian", "environment", "parameter", "kind", "joint")
            found[name] = _endpoint(row, gate, log=row["family"] == "lognormal")
    for row in document["contrast"] or ():
        # Ratios of SDs have an error of their own, which report.json does not hold.
        if row["method"] == "bayesian" and row["kind"]:
            name = f"bayesian contrast {row['kind']} {contrast_name(row)}"
            found[name] = _endpoint(row, gate, log=not row["unit"])
    return found


def _endpoint(row: Mapping[str, Any], gate: Mapping[str, Any], *, log: bool) -> dict[str, Any]:
    error = [gate["worst_error"]] * 2
    return {"lower": row["lower"], "upper": row["upper"], "log": log, "error": error}


def _estimates(document: Document) -> dict[str, dict[str, Any]]:
    """Take Bayesian numbers that stand beside their Monte Carlo error, in the unit of both."""
    found: dict[str, dict[str, Any]] = {}
    for row in document["psychophysics"]:
        if row["method"] == "bayesian":
            name = _named(row, "psychophysics", "measure", "environment", "parameter")
            found[name] = {"values": [row["lower"], row["upper"]], "error": row["error"]}
    for row in document["verdicts"]:
        evidence = row["bayesian"]
        if evidence is not None:
            name = _named(row, "verdict", "environment", "coupled")
            found[name] = {"values": [evidence["probability"]], "error": evidence["error"]}
    return found

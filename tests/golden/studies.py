"""The twelve studies, and what is frozen of each: numbers of report.json, and classical curves.

What users see makes them, `percept.Study` and report.json's fields; the paper's rule, of which the
report keeps one line, is worked out from `percept.haptics`. Files that are not in `datasets/` stand
in `data/`:

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

Not frozen: verdicts on what feels real, simultaneous bands, limits from a bootstrap, and Bayesian
numbers that have no Monte Carlo error.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import percept
from tests import DATASETS
from tests.documents import build_document
from tests.golden.paper_rule import by_the_paper_s_rule

__all__ = ["FOLDER", "SEED", "STUDIES", "TOLERANCE", "Golden", "frozen_part"]

FOLDER = Path(__file__).resolve().parent
_DATA = FOLDER / "data"
SEED = 1
TOLERANCE = 0.05
OMEGA = np.geomspace(0.1, 100.0, 25)
#: Of grids the report chooses every so manieth point is frozen.
_EVERY = 40

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
        checked = percept.Study(study.sessions, study.scene.with_tables(checks={}))
        document: Document = build_document(checked)
        return document

    def study(self, **inference: Any) -> percept.Study:
        """Open the study, with other settings of the scene's [inference]."""
        scene = percept.Scene.load(self.scene).with_inference(**inference)
        sessions = percept.read_sessions(self.sessions, scene=scene)
        return percept.Study(sessions, scene)


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


def frozen_part(golden: Golden, document: Document) -> dict[str, Any]:
    """Take what is frozen from a study and its document."""
    exact = {
        **_data(document),
        **_intervals(document),
        **_contrasts(document),
        **_coupling(document),
        **_band(document),
        **by_the_paper_s_rule(golden.study(method="classical")),
    }
    return {
        "exact": exact,
        "curves": _curves(golden),
        "endpoints": _endpoints(document),
        "skipped": sorted({row["what"] for row in document["skipped"]}),
    }


def _named(row: Mapping[str, Any], what: str, *names: str) -> str:
    return " ".join([what, *(str(row[name]) for name in names)])


def _classical(rows: Iterable[Mapping[str, Any]] | None) -> list[Mapping[str, Any]]:
    return [row for row in rows or () if row["method"] == "classical"]


def _data(document: Document) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for row in document["data"].get("cells") or ():
        name = _named(row, "cell", "environment", "parameter")
        found[f"{name} n"] = row["n"]
        found[f"{name} mean, sd"] = [row["mean"], row["sd"]]
    return found


def _intervals(document: Document) -> dict[str, Any]:
    names = ("environment", "parameter", "kind", "family", "joint")
    return {
        _named(row, "interval", *names): [row["lower"], row["estimate"], row["upper"]]
        for row in _classical(document["intervals"])
    }


def contrast_name(row: Mapping[str, Any]) -> str:
    """Name a contrast as messages of the sampler do."""
    where = row["environment"] or "overall"
    levels = f"{row['second']} against {row['first']}"
    return f"{row['parameter']}, {row['factor']}: {levels}, {where}"


def _contrasts(document: Document) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for row in _classical(document["contrast"]):
        name = f"contrast {row['of']} {row['kind']} {contrast_name(row)}"
        found[name] = [row["lower"], row["estimate"], row["upper"]]
        found[f"{name} p"] = row["p_value"]
    for row in document["anova"] or ():
        name = _named(row, "anova", "parameter", "factor")
        for field in ("f", "df", "df_error", "p_value", "epsilon", "p_corrected"):
            found[f"{name} {field}"] = row[field]
    return found


def _coupling(document: Document) -> dict[str, Any]:
    found: dict[str, Any] = {
        _named(row, "passivity", "environment"): [row["needed_colgate"], row["needed_paper"]]
        for row in document["passivity"] or ()
    }
    coupling = document["coupling"]
    if coupling is None:
        return found
    found["coupling verdict"] = coupling["verdict"]
    for name in ("margin", "binding_omega", "required_damping", "required_omega"):
        found[f"coupling {name}"] = coupling[name]
    for at in range(0, len(coupling["omega"]), _EVERY):
        for name in ("omega", "bound", "admittance"):
            found[f"coupling {name} {at}"] = coupling[name][at]
    return found


def _band(document: Document) -> dict[str, Any]:
    band = document["band"] or {"rows": [], "laws": []}
    found: dict[str, Any] = {}
    for row in _classical(band["rows"]):
        name = _named(row, "band", "environment", "kind", "family")
        size = row["reference"] if row["impedance"] is None else row["impedance"]
        found[f"{name} limits"] = [row["lower"], row["upper"], row["band"], size]
        found[f"{name} relative"] = row["relative"]
    for row in _classical(band["laws"]):
        name = _named(row, "law", "kind", "family", "model")
        for parameter, value in row["parameters"].items():
            found[f"{name} {parameter}"] = value["value"]
        found[f"{name} left_out_error"] = row["left_out_error"]
        found[f"{name} carried_by"] = row["carried_by"]
    return found


def _curves(golden: Golden) -> dict[str, dict[str, list[float]]]:
    found: dict[str, dict[str, list[float]]] = {}
    for curve in golden.study(method="classical").parts.boundaries_at(OMEGA):
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
        # Ratios of spread have an error of their own, which report.json does not hold.
        if row["method"] == "bayesian" and row["of"] != "spread":
            name = f"bayesian contrast {row['kind']} {contrast_name(row)}"
            found[name] = _endpoint(row, gate, log=not row["unit"])
    return found


def _endpoint(row: Mapping[str, Any], gate: Mapping[str, Any], *, log: bool) -> dict[str, Any]:
    error = [gate["worst_error"]] * 2
    return {"lower": row["lower"], "upper": row["upper"], "log": log, "error": error}

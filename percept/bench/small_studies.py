"""Small studies to work on: four subjects, two environments, stiffness and damping."""

from __future__ import annotations

from pathlib import Path

import numpy as np

_HEADER = "subject,environment,k_ref,b_ref,k_adj,b_adj\n"
_REFERENCES = ((1e3, 5.0), (1e4, 20.0))


def write_small_studies(folder: Path, count: int, rng: np.random.Generator) -> list[str]:
    """Write studies, each a different one, over those that are there."""
    paths = [folder / f"study-{number}.csv" for number in range(count)]
    for path in paths:
        path.write_text(_study(rng), encoding="utf-8")
    return [str(path) for path in paths]


def _study(rng: np.random.Generator) -> str:
    lines = []
    for subject in range(4):
        shared = rng.normal(0.0, 0.1, 2)
        for j, (k, b) in enumerate(_REFERENCES):
            k_adj, b_adj = np.array([k, b]) * np.exp(shared + rng.normal(0.0, 0.1, 2))
            lines.append(f"S{subject},VE{j},{k},{b},{k_adj:.6g},{b_adj:.6g}\n")
    return _HEADER + "".join(lines)

"""Simulate the tutorial's study: python docs/tutorial/make.py writes matching.csv beside it."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

_UNITS = {"stiffness": "N/mm", "damping": "N·s/m"}
#: Stiffness (N/mm) and damping (N·s/m) of each wall, and the bias of both in its logarithm.
_WALLS = {
    "foam": (0.4, 2.0, 0.12, 0.20),
    "rubber": (2.0, 6.0, 0.02, 0.10),
    "wood": (8.0, 15.0, -0.10, 0.05),
}
_COLUMNS = [
    f"{name} {side} ({unit})" for side in ("standard", "response") for name, unit in _UNITS.items()
]
_PERSON, _WALL, _TRIAL = 0.10, 0.12, 0.06  # SDs of the logarithm


def main() -> None:
    """Write twelve participants who match each wall twice."""
    rng = np.random.default_rng(7)
    path = Path(__file__).with_name("matching.csv")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["participant", "condition", "rep", *_COLUMNS])
        for person in range(1, 13):
            own = rng.normal(0, _PERSON, 2)
            for wall, (k, b, *bias) in _WALLS.items():
                mean = np.array(bias) + own + rng.normal(0, _WALL, 2)
                for trial in (1, 2):
                    set_k, set_b = np.array([k, b]) * np.exp(mean + rng.normal(0, _TRIAL, 2))
                    writer.writerow(
                        [f"P{person:02}", wall, trial, k, b, f"{set_k:.3f}", f"{set_b:.2f}"]
                    )


if __name__ == "__main__":
    main()

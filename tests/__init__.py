"""Tests of percept; the folders mirror those of the package."""

from pathlib import Path

#: The published study and the sessions simulated like it.
DATASETS = Path(__file__).resolve().parent.parent / "datasets"

"""Tests of percept; the folders mirror those of the package."""

import os
from pathlib import Path

#: The published study and the sessions simulated like it.
DATASETS = Path(__file__).resolve().parent.parent / "datasets"

#: The committed run of the benchmark, with the reference limits that it is measured against.

#: Whether `make evidence` runs: tests then go over many cases where `make test` takes few.
LONG = "PERCEPT_EVIDENCE" in os.environ

"""What convinces of percept: pages, and beside each page the code that makes it.

It uses percept as its users do, and percept never imports it. It runs in a checkout only.
"""

from __future__ import annotations

import os
from pathlib import Path

# As the command `percept` does, before NumPy is imported: the matrices are a few tens wide.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def dataset(name: str) -> Path:
    """Return the path of a file of `datasets`."""
    return Path(__file__).resolve().parents[1] / "datasets" / name

"""The paper reproduced from its published numbers: every table, figure and claim.

`percept reproduce` writes it all; `judge_all(load_published())` gives the claims with their verdicts.
"""

from __future__ import annotations

from percept.reproduce.claims import Claim, Quantity, judge_all
from percept.reproduce.published import Published, Wall, load_published
from percept.reproduce.write import Written, write_reproduction

__all__ = [
    "Claim",
    "Published",
    "Quantity",
    "Wall",
    "Written",
    "judge_all",
    "load_published",
    "write_reproduction",
]

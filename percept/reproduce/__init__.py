"""The paper reproduced from its published numbers: every table, figure and claim.

`percept reproduce` writes it all; `judge_all(load_published())` gives the claims with their
verdicts.
"""

from __future__ import annotations

from percept.reproduce.judging import judge_all
from percept.reproduce.published import load_published
from percept.reproduce.write import write_reproduction

__all__ = ["judge_all", "load_published", "write_reproduction"]

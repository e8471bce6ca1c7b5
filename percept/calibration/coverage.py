"""Real coverage of every kind and method: simulate studies, refit, count."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from percept.calibration.checkpoint import Checkpoint
from percept.calibration.judge import Judgement, judge_study
from percept.calibration.plan import CoveragePlan
from percept.calibration.studies import computed
from percept.errors import UsageError
from percept.workers import InProcess, Mapper


@dataclass(frozen=True)
class Coverage:
    """How often a claim held, over simulated studies."""

    claim: str  # As `Judgement`
    kind: str  # As `Judgement`
    method: str  # As `Judgement`
    family: str  # As `Judgement`
    joint: str  # As `Judgement`
    shape: str  # As `Judgement`
    subjects: int  # Per study
    truth: str  # Distribution of the simulated users
    stated: float | None  # What is claimed: level, or confidence for kind share
    held: float  # Mean over studies of the share that held
    error: float  # Its standard error, by the scatter over studies
    studies: int  # How many


def coverage(
    plan: CoveragePlan,
    studies: int,
    *,
    mapper: Mapper | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Coverage]:
    """Simulate and judge studies, and average."""
    if studies < 2:
        raise UsageError("a standard error needs at least two studies.", key="studies", value=studies)
    kept = Checkpoint(checkpoint, plan.key, what="judged", pack=_pack, unpack=_unpack)
    judged = kept.read(studies)
    wanted = [index for index in range(studies) if index not in judged]
    judge = functools.partial(judge_study, plan)
    for index, found in computed(judge, wanted, mapper or InProcess(), name=f"coverage-{plan.key}"):
        judged[index] = found
        kept.append(index, found)
        if progress:
            progress(len(judged), studies)
    return _averaged(plan, [judged[index] for index in sorted(judged)])


def coverage_markdown(rows: list[Coverage]) -> str:
    """Write coverage as a table in Markdown: each figure with its standard error, in per cent."""
    lines = [
        "| claim | kind | method | family | joint | shape | users | n | stated | real | ± | studies |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        stated = "" if row.stated is None else f"{100 * row.stated:g} %"
        error = "–" if math.isnan(row.error) else f"{100 * row.error:.2f}"
        cells = [
            row.claim, row.kind, row.method, row.family, row.joint, row.shape, row.truth, str(row.subjects),
            stated, f"{100 * row.held:.2f} %", error, str(row.studies),
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _averaged(plan: CoveragePlan, judged: list[list[Judgement]]) -> list[Coverage]:
    groups: dict[tuple[str, str, str, str, str, str], list[float]] = {}
    for study in judged:
        for one in study:
            key = (one.claim, one.kind, one.method, one.family, one.joint, one.shape)
            groups.setdefault(key, []).append(one.held)
    rows = []
    for key, values in groups.items():
        failed = key[0] in ("withheld", "refused")
        held = np.array(values + [0.0] * (len(judged) - len(values)) if failed else values)
        stated = plan.confidence if key[1] == "share" else plan.level
        rows.append(
            Coverage(
                *key,
                subjects=plan.subjects,
                truth=plan.truth,
                stated=None if failed else stated,
                held=float(held.mean()),
                error=_standard_error(held),
                studies=held.size,
            )
        )
    return rows


def _standard_error(held: NDArray[np.float64]) -> float:
    """Return the standard error of a mean; of studies that all agree, as of one half more and one half less.

    Six studies of six that hold do not make a coverage certain.
    """
    if held.size < 2:
        return float("nan")
    if np.ptp(held) > 0:
        return float(held.std(ddof=1) / np.sqrt(held.size))
    rate = (held.sum() + 0.5) / (held.size + 1.0)
    return float(np.sqrt(rate * (1.0 - rate) / (held.size + 1.0)))


def _pack(found: list[Judgement]) -> dict[str, Any]:
    return {"judged": [asdict(one) for one in found]}


def _unpack(line: Mapping[str, Any]) -> list[Judgement]:
    return [Judgement(**one) for one in line["judged"]]

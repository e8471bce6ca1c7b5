"""What the first screen of a page says: the summary of report.json."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True, kw_only=True)
class OverviewRow:
    """One quantity of one environment; a bias is relative to the reference, or in `unit`."""

    environment: str
    parameter: str
    unit: str
    reference: float | None
    method: str
    family: str
    level: float
    estimate: float | None
    relative: bool
    bias: float | None
    bias_lower: float | None
    user_lower: float | None
    user_bias_lower: float | None
    user_lower_ratio: float | None  # Over the reference; None of differences
    bias_upper: float | None
    user_upper: float | None
    user_bias_upper: float | None
    user_upper_ratio: float | None


@dataclasses.dataclass(frozen=True)
class Overview:
    """The first table, and the sentences above it."""

    rows: tuple[OverviewRow, ...]
    sentences: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Findings:
    """The sentences, numbers and cautions of the first screen."""

    overview: Overview
    cautions: tuple[str, ...]
    paragraph: str  # Of results, to paste into a paper; empty without intervals

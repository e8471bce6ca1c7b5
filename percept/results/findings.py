"""What the first screen of a page says: the summary of report.json."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Findings:
    """The sentences and cautions of the first screen."""

    sentences: tuple[str, ...]
    cautions: tuple[str, ...]
    paragraph: str  # Of results, to paste into a paper; empty without intervals

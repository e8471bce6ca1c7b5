"""The data: what was read, and what was left out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from percept.report.sections.part import Part


def build(document: Mapping[str, Any]) -> Part:
    """Return counts, exclusions and the reader's notices."""
    data = document["data"]
    counts = [{"what": what, "place": f"/data/counts/{_escaped(what)}"} for what in data["counts"]]
    cells = [
        {"environment": cell["environment"], "parameter": cell["parameter"], "unit": cell["unit"]}
        | {"place": f"/data/cells/{index}"}
        for index, cell in enumerate(data["cells"])
    ]
    return Part("data", "Data", {"data": data, "counts": counts, "cells": cells})


def _escaped(name: str) -> str:
    return name.replace("~", "~0").replace("/", "~1")

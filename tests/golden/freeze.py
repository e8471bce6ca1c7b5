"""Make the frozen files: `python -m tests.golden.freeze [NAME ...]`.

The files are made again only where a change alters a number on purpose. The commit then says which
number and why. The Monte Carlo error of each Bayesian endpoint is not in report.json. It comes from
a run of the same seed.
"""

from __future__ import annotations

import json
import sys
from typing import Any

from tests.golden.studies import FOLDER, SEED, STUDIES, TOLERANCE, Golden, frozen_part

__all__ = ["freeze"]


def freeze(golden: Golden) -> None:
    """Write one study's file."""
    classical = golden.report(method="classical")
    numbers = frozen_part(golden, classical, golden.report())
    for name, errors in _errors(golden).items():
        numbers["endpoints"][name]["error"] = errors
    lines = [f'"skipped": {_json(numbers["skipped"])}']
    for part in ("exact", "curves", "endpoints", "estimates"):
        rows = [f"  {_json(name)}: {_json(value)}" for name, value in numbers[part].items()]
        lines.append(f'"{part}": {{\n' + ",\n".join(rows) + "\n}")
    (FOLDER / f"{golden.name}.json").write_text("{" + ",\n".join(lines) + "}\n", encoding="utf-8")


def _errors(golden: Golden) -> dict[str, list[float]]:
    """Monte Carlo error of each endpoint, as a fraction of its half-width on the model's scale."""
    run = golden.study(seed=SEED, tolerance=TOLERANCE).fit.run
    relative = dict(
        zip(run.estimates.names, run.estimates.errors / run.estimates.scale, strict=True)
    )
    found: dict[str, list[float]] = {}
    for name, error in relative.items():
        head, _, rest = name.partition(" limit of ")
        side, kind = head.split()
        parameter, _, environment = rest.partition(" in ")
        key = f"bayesian {environment} {parameter} {kind} marginal"
        if parameter == "contrast":
            key = f"bayesian contrast {kind} {environment}"
        found.setdefault(key, [0.0, 0.0])[side == "upper"] = float(error)
    return found


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False)


if __name__ == "__main__":
    wanted = sys.argv[1:] or [golden.name for golden in STUDIES]
    for golden in STUDIES:
        if golden.name in wanted:
            freeze(golden)

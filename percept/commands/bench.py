"""`percept bench`: what percept costs and how many digits it keeps, on this machine."""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from percept.commands import FORCE, JSON, Command, argument, flag, number
from percept.commands.analysis import print_json
from percept.errors import UsageError
from percept.files import refuse_foreign

__all__ = ["BENCH"]

_OUT = "benchmark"
_Arguments: TypeAlias = argparse.Namespace
#: What a part measures: a sequence of its own records.
_Rows: TypeAlias = Sequence[Any]


def _run(arguments: _Arguments) -> None:
    """Measure the parts asked for; print one table each, or write it where a folder is named."""
    parts = list(dict.fromkeys(arguments.parts))
    if arguments.stability and "digits" not in parts:
        parts.append("digits")
    if len(parts) == 1 and parts[0] in _WRITERS:
        print(_WRITERS[parts[0]](arguments))
        return
    if not parts:
        raise UsageError(f"name a part to measure: {_ALL}.")
    for part in parts:
        if part in _WRITERS:
            raise UsageError("must run alone.", value=part)
        if part not in _PARTS:
            raise UsageError(f"no such part; they are {_ALL}.", value=part)
    measured = {part: _measured(part, arguments) for part in parts}
    if arguments.json:
        print_json(measured)
    elif not arguments.out:
        for part, rows in measured.items():
            print(f"\n{part}\n{_table(rows)}")


def _table(rows: _Rows) -> str:
    import pandas as pd

    table = pd.DataFrame([dataclasses.asdict(row) for row in rows])
    return table.to_string(index=False, float_format="{:.4g}".format)


def _measured(part: str, arguments: _Arguments) -> _Rows:
    """Measure one part and, where asked, write it."""
    from percept.bench.measure import measurement, measurement_files, write_measurement

    _log(f"measuring {part}")
    if arguments.out:
        refuse_foreign(arguments.out, measurement_files(part), force=arguments.force)
    started = time.perf_counter()
    load_before = os.getloadavg()[0]
    try:
        rows = _PARTS[part](arguments)
    except ModuleNotFoundError as error:
        message = f"{part} needs {error.name}, which is not installed."
        hint = "Install percept with its extra: percept-haptics[bench]."
        raise UsageError(message, hint=hint) from error
    if arguments.out:
        document = measurement(
            part,
            rows,
            command=arguments.typed,
            loads=(load_before, os.getloadavg()[0]),
            seconds=time.perf_counter() - started,
            notes=_notes(part, rows),
        )
        path = write_measurement(document, arguments.out, force=arguments.force)
        print(path, file=sys.stderr if arguments.json else sys.stdout)
    return rows


def _notes(part: str, rows: _Rows) -> list[str]:
    """Return what follows from all rows of a part."""
    if part != "designs":
        return []
    from percept.bench.designs import summary

    return summary(rows)


def _log(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _designs(arguments: _Arguments) -> _Rows:
    from percept.bench.designs import design_costs

    peer = not arguments.no_peer
    return design_costs(
        arguments.rows, seeds=arguments.seeds, peer=peer, out=arguments.out, log=_log
    )


def _digits(arguments: _Arguments) -> _Rows:
    import mpmath  # noqa: F401 - missing, it is named before anything is worked out

    from percept.bench.digits import density_digits, moment_digits
    from percept.bench.digits_haptics import haptics_digits

    return [*moment_digits(), *density_digits(), *haptics_digits(arguments.cases)]


def _propagation(_: _Arguments) -> _Rows:
    """Measure on the simulated sessions like the published ones."""
    from percept import Scene, Study, read_sessions
    from percept.bench.propagation import study_propagation
    from reports import dataset

    sessions = read_sessions(dataset("hbfd_sessions.csv"))
    return study_propagation(Study(sessions, Scene.load(dataset("hbfd.toml"))))


def _skipping(_: _Arguments) -> _Rows:
    from percept.bench.skipping import skipping_cost

    return skipping_cost()


def _growth(_: _Arguments) -> _Rows:
    from percept.bench.growth import growth

    return growth(log=_log)


def _peers(arguments: _Arguments) -> Path:
    from percept.bench.peers.run import Plan, run_benchmark

    plan = Plan(
        arguments.engines, arguments.rows, arguments.seconds, arguments.repeats, arguments.quick
    )
    out = arguments.out or _OUT
    return run_benchmark(out, plan, command=arguments.typed, force=arguments.force, log=_log)


def _reference(arguments: _Arguments) -> Path:
    from percept.bench.peers.reference import make_references

    return make_references(arguments.out or _OUT, arguments.rows, log=_log)


_PARTS: dict[str, Callable[[_Arguments], _Rows]] = {
    "designs": _designs,
    "digits": _digits,
    "propagation": _propagation,
    "skipping": _skipping,
    "growth": _growth,
}
#: Parts that run alone and write files of their own.
_WRITERS: dict[str, Callable[[_Arguments], Path]] = {"peers": _peers, "reference": _reference}
_ALL = ", ".join((*_PARTS, *_WRITERS))

BENCH = Command(
    "Measure run time against error and the digits kept, on this machine.",
    "percept bench skipping --out benchmark",
    (
        argument("parts", "PART", f"what to measure: {_ALL}", nargs="*"),
        flag("--stability", "the same as the part digits"),
        number("--cases", "N", "haptics cases of digits (2000)", default=2000),
        number("--seeds", "N", "of designs (1 2 3)", nargs="+", default=[1, 2, 3]),
        argument("--rows", "NAME", "designs, or studies of peers (all)", nargs="+", default=()),
        flag("--no-peer", "designs without nutpie beside them"),
        JSON,
        FORCE,
        argument(
            "--out",
            "DIR",
            "write PART.json and PART.md into it as they are measured (peers: benchmark)",
        ),
        argument("--engines", "NAME", "of peers, only these", nargs="+", default=()),
        number("--seconds", "S", "of peers, begin no run of an engine later (150)", default=150.0),
        number("--repeats", "N", "of peers, rounds of whole commands (5)", default=5),
        flag("--quick", "of peers, the smallest budgets, to see that all works"),
    ),
    _run,
)

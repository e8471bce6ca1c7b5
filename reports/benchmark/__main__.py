"""`python -m reports.benchmark`: what percept costs and how many digits it keeps, here."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from percept.files import refuse_foreign
from reports import dataset
from reports.command import run

_Arguments: TypeAlias = argparse.Namespace
#: What a part measures: a sequence of its own records.
_Rows: TypeAlias = Sequence[Any]


def main(words: Sequence[str] | None = None) -> int:
    """Measure one part, write its page and print the page's path."""
    parser = argparse.ArgumentParser("python -m reports.benchmark", description=__doc__)
    parser.add_argument("part", choices=(*_PARTS, *_WRITERS), help="what to measure")
    parser.add_argument("--out", type=Path, required=True, help="folder of PART.json and PART.md")
    parser.add_argument("--force", action="store_true", help="replace also files of others")
    parser.add_argument("--cases", type=int, default=2000, help="haptics cases of digits (2000)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3], help="of designs")
    parser.add_argument("--no-peer", action="store_true", help="designs without nutpie")
    parser.add_argument("--rows", nargs="+", default=(), help="designs, or studies of peers (all)")
    parser.add_argument("--engines", nargs="+", default=(), help="of peers, only these")
    parser.add_argument("--seconds", type=float, default=150.0, help="when peers begin no new run")
    parser.add_argument("--repeats", type=int, default=5, help="of peers, rounds of commands (5)")
    parser.add_argument("--quick", action="store_true", help="of peers, the smallest budgets")
    return run(parser, _run, words)


def _run(arguments: _Arguments) -> None:
    if arguments.part in _WRITERS:
        print(_WRITERS[arguments.part](arguments))
    else:
        print(_measured(arguments))


def _measured(arguments: _Arguments) -> Path:
    """Measure a part and write it."""
    from reports.benchmark.measure import measurement, measurement_files, write_measurement

    part = arguments.part
    _log(f"measuring {part}")
    refuse_foreign(arguments.out, measurement_files(part), force=arguments.force)
    started = time.perf_counter()
    load_before = os.getloadavg()[0]
    rows = _PARTS[part](arguments)
    document = measurement(
        part,
        rows,
        command=arguments.typed,
        loads=(load_before, os.getloadavg()[0]),
        seconds=time.perf_counter() - started,
        notes=_notes(part, rows),
    )
    return write_measurement(document, arguments.out, force=arguments.force)


def _notes(part: str, rows: _Rows) -> list[str]:
    """Return what follows from all rows of a part."""
    if part != "designs":
        return []
    from reports.benchmark.designs import summary

    return summary(rows)


def _log(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _designs(arguments: _Arguments) -> _Rows:
    from reports.benchmark.designs import design_costs

    peer = not arguments.no_peer
    return design_costs(
        arguments.rows, seeds=arguments.seeds, peer=peer, out=arguments.out, log=_log
    )


def _digits(arguments: _Arguments) -> _Rows:
    from reports.benchmark.digits import density_digits, moment_digits
    from reports.benchmark.digits_haptics import haptics_digits

    return [*moment_digits(), *density_digits(), *haptics_digits(arguments.cases)]


def _propagation(_: _Arguments) -> _Rows:
    """Measure on the simulated sessions like the published ones."""
    from percept import Scene, Study, read_sessions
    from reports.benchmark.propagation import study_propagation

    sessions = read_sessions(dataset("hbfd_sessions.csv"))
    return study_propagation(Study(sessions, Scene.load(dataset("hbfd.toml"))))


def _skipping(_: _Arguments) -> _Rows:
    from reports.benchmark.skipping import skipping_cost

    return skipping_cost()


def _growth(_: _Arguments) -> _Rows:
    from reports.benchmark.growth import growth

    return growth(log=_log)


def _peers(arguments: _Arguments) -> Path:
    from reports.benchmark.peers.run import Plan, run_benchmark

    plan = Plan(
        arguments.engines, arguments.rows, arguments.seconds, arguments.repeats, arguments.quick
    )
    command = arguments.typed
    return run_benchmark(arguments.out, plan, command=command, force=arguments.force, log=_log)


def _reference(arguments: _Arguments) -> Path:
    from reports.benchmark.peers.reference import make_references

    return make_references(arguments.out, arguments.rows, log=_log)


_PARTS: dict[str, Callable[[_Arguments], _Rows]] = {
    "designs": _designs,
    "digits": _digits,
    "propagation": _propagation,
    "skipping": _skipping,
    "growth": _growth,
}
#: Parts that write files of their own.
_WRITERS: dict[str, Callable[[_Arguments], Path]] = {"peers": _peers, "reference": _reference}


if __name__ == "__main__":
    sys.exit(main())

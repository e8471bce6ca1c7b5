"""`percept bench`: what percept costs and how many digits it keeps, on this machine."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from percept.commands import Command
from percept.errors import UsageError

_OUT = "benchmark"


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "parts",
        nargs="*",
        metavar="PART",
        help=f"what to measure: {', '.join((*_PARTS, *_WRITERS))}",
    )
    parser.add_argument("--stability", action="store_true", help="the same as the part digits")
    parser.add_argument("--cases", type=int, default=2000, metavar="N", help="haptics cases of digits (2000)")
    parser.add_argument("--seeds", type=int, nargs="+", metavar="SEED", help="of designs (1 2 3)")
    parser.add_argument(
        "--rows",
        nargs="+",
        default=(),
        metavar="NAME",
        help="designs, or studies of peers (all)",
    )
    parser.add_argument(
        "--peer", action=argparse.BooleanOptionalAction, default=True, help="nutpie beside designs (yes)"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")
    parser.add_argument(
        "--out",
        metavar="DIR",
        help="write PART.json and PART.md into it as they are measured (peers: benchmark)",
    )
    peers = parser.add_argument_group(
        "peers, reference", "parts run alone, that write files: percept against other samplers (extra peers)"
    )
    peers.add_argument("--engines", nargs="+", default=(), metavar="NAME", help="only these")
    peers.add_argument(
        "--seconds", type=float, default=150.0, metavar="S", help="begin no run of an engine later (150)"
    )
    peers.add_argument("--starts", type=int, default=3, metavar="N", help="processes per engine (3)")
    peers.add_argument("--repeats", type=int, default=5, metavar="N", help="rounds of whole commands (5)")
    peers.add_argument("--quick", action="store_true", help="smallest budgets, to see that all works")


def _run(arguments: argparse.Namespace) -> None:
    """Measure the parts asked for and print one table each."""
    if len(arguments.parts) == 1 and arguments.parts[0] in _WRITERS:
        print(_WRITERS[arguments.parts[0]](arguments))
        return
    parts = list(dict.fromkeys([*arguments.parts, *(["digits"] if arguments.stability else [])]))
    for part in parts or [""]:
        if part not in _PARTS:
            raise UsageError(f"not a part that goes with others; those are {', '.join(_PARTS)}.", value=part)
    rows: dict[str, list[dict[str, Any]]] = {}
    for part in parts:
        _log(f"measuring {part}")
        rows[part] = [dataclasses.asdict(record) for record in _measured(part, arguments)]
    if arguments.json:
        print(json.dumps(rows, indent=1))
    elif not arguments.out:
        import pandas as pd

        for part, records in rows.items():
            table = pd.DataFrame(records).to_string(index=False, float_format="{:.4g}".format)
            print(f"\n{part}\n{table}")


def _measured(part: str, arguments: argparse.Namespace) -> Sequence[Any]:
    """Measure one part and, where asked, write it."""
    started, before = time.perf_counter(), os.getloadavg()[0]
    try:
        records = _PARTS[part](arguments)
    except ModuleNotFoundError as error:
        raise UsageError(
            f"{part} needs {error.name}, which is not installed.",
            hint="Install percept with its extra: percept[bench].",
        ) from error
    if arguments.out:
        document = _bench("measure", "measurement")(
            part,
            records,
            command=arguments.typed,
            loads=(before, os.getloadavg()[0]),
            seconds=time.perf_counter() - started,
            notes=_bench("designs", "summary")(records) if part == "designs" else (),
        )
        path = _bench("measure", "write_measurement")(document, arguments.out)
        print(path, file=sys.stderr if arguments.json else sys.stdout)
    return records


def _log(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _bench(module: str, name: str) -> Any:
    """Import a function of `percept.bench` when it is called for."""
    return getattr(importlib.import_module(f"percept.bench.{module}"), name)


def _digits(arguments: argparse.Namespace) -> list[Any]:
    import mpmath  # noqa: F401 - missing, it is named before anything is worked out

    parts = ("moment_digits", "tolerance_digits", "density_digits")
    rows = [row for name in parts for row in _bench("digits", name)()]
    return rows + _bench("digits_haptics", "haptics_digits")(arguments.cases)


_PARTS: dict[str, Callable[[argparse.Namespace], Sequence[Any]]] = {
    "designs": lambda given: _bench("designs", "design_costs")(
        given.rows, seeds=given.seeds or (1, 2, 3), peer=given.peer, out=given.out, log=_log
    ),
    "digits": _digits,
    "skipping": lambda _: _bench("skipping", "skipping_cost")(),
    "growth": lambda _: _bench("growth", "growth")(log=_log),
}
#: Parts run alone, which write their own files.
_WRITERS: dict[str, Callable[[argparse.Namespace], Any]] = {
    "peers": lambda given: _bench("peers.document", "run_benchmark")(
        given.out or _OUT, command=given.typed, engines=given.engines, studies=given.rows,
        seconds=given.seconds, starts=given.starts, repeats=given.repeats, quick=given.quick, log=_log,
    ),
    "reference": lambda given: _bench("peers.reference", "make_references")(
        given.out or _OUT, given.rows, log=_log
    ),
}  # fmt: skip

BENCH = Command(
    "Measure run time against error and the digits kept, on this machine.",
    "percept bench skipping --out benchmark",
    _add_arguments,
    _run,
)

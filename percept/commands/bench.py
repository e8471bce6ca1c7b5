"""`percept bench`: what percept costs and how many digits it keeps, on this machine."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from percept.commands import FORCE, JSON, Command, argument, flag, number
from percept.commands.analysis import print_json
from percept.errors import UsageError
from percept.files import refuse_foreign

_OUT = "benchmark"


def _run(arguments: argparse.Namespace) -> None:
    """Measure the parts asked for; print one table each, or write it where a folder is named."""
    parts = list(dict.fromkeys([*arguments.parts, *(["digits"] if arguments.stability else [])]))
    if len(parts) == 1 and parts[0] in _WRITERS:
        print(_WRITERS[parts[0]](arguments))
        return
    for part in parts or [""]:
        if part not in _PARTS:
            raise UsageError(
                f"not a part that goes with others; those are {', '.join(_PARTS)}.", value=part
            )
    measured = {part: _measured(part, arguments) for part in parts}
    if arguments.json:
        print_json(measured)
    elif not arguments.out:
        import pandas as pd

        for part, records in measured.items():
            table = pd.DataFrame(map(dataclasses.asdict, records))
            print(f"\n{part}\n{table.to_string(index=False, float_format='{:.4g}'.format)}")


def _measured(part: str, arguments: argparse.Namespace) -> Sequence[Any]:
    """Measure one part and, where asked, write it."""
    _log(f"measuring {part}")
    if arguments.out:
        files = _bench("measure", "measurement_files")(part)
        refuse_foreign(arguments.out, files, force=arguments.force)
    started, before = time.perf_counter(), os.getloadavg()[0]
    try:
        records = _PARTS[part](arguments)
    except ModuleNotFoundError as error:
        hint = "Install percept with its extra: percept[bench]."
        raise UsageError(
            f"{part} needs {error.name}, which is not installed.", hint=hint
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
        path = _bench("measure", "write_measurement")(
            document, arguments.out, force=arguments.force
        )
        print(path, file=sys.stderr if arguments.json else sys.stdout)
    return records


def _log(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _bench(module: str, name: str) -> Any:
    """Import a function of `percept.bench` when it is called for."""
    return getattr(importlib.import_module(f"percept.bench.{module}"), name)


def _digits(arguments: argparse.Namespace) -> list[Any]:
    import mpmath  # noqa: F401 - missing, it is named before anything is worked out

    rows = [*_bench("digits", "moment_digits")(), *_bench("digits", "density_digits")()]
    return rows + _bench("digits_haptics", "haptics_digits")(arguments.cases)


def _propagation(_: argparse.Namespace) -> Any:
    """Measure on the simulated sessions like the published ones."""
    from percept import Scene, Study, read_sessions
    from percept.reproduce.published import dataset

    study = Study(read_sessions(dataset("hbfd_sessions.csv")), Scene.load(dataset("hbfd.toml")))
    return _bench("propagation", "study_propagation")(study)


_PARTS: dict[str, Callable[[argparse.Namespace], Sequence[Any]]] = {
    "designs": lambda given: _bench("designs", "design_costs")(
        given.rows, seeds=given.seeds, peer=not given.no_peer, out=given.out, log=_log
    ),
    "digits": _digits,
    "propagation": _propagation,
    "skipping": lambda _: _bench("skipping", "skipping_cost")(),
    "growth": lambda _: _bench("growth", "growth")(log=_log),
}
#: Parts run alone, which write their own files.
_WRITERS: dict[str, Callable[[argparse.Namespace], Any]] = {
    "peers": lambda given: _bench("peers.document", "run_benchmark")(
        given.out or _OUT, command=given.typed, engines=given.engines, studies=given.rows,
        seconds=given.seconds, repeats=given.repeats, quick=given.quick, force=given.force, log=_log,
    ),
    "reference": lambda given: _bench("peers.reference", "make_references")(
        given.out or _OUT, given.rows, log=_log
    ),
}  # fmt: skip

BENCH = Command(
    "Measure run time against error and the digits kept, on this machine.",
    "percept bench skipping --out benchmark",
    (
        argument("parts", "PART", f"what to measure: {', '.join((*_PARTS, *_WRITERS))}", nargs="*"),
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

"""Measure run time against error and the digits kept, on this machine."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

EXAMPLE = "percept bench sampling --json"
_OUT = "benchmark"
#: Parts that measure simulated studies.
_SIMULATED = {
    "sampling", "propagation", "envelope", "density", "skipping", "coverage", "workers",
    "growth",
}  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "parts",
        nargs="*",
        metavar="PART",
        help=f"what to measure: {', '.join((*_PARTS, *_WRITERS))} (sampling, magnitude)",
    )
    parser.add_argument(
        "--stability",
        action="store_true",
        help="digits kept: moments, tolerance factors, density and haptics",
    )
    parser.add_argument(
        "--cases", type=int, default=2000, metavar="N", help="cases of the haptics digits (2000)"
    )
    parser.add_argument("--studies", type=int, default=200, metavar="N", help="studies of workers (200)")
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


def run(arguments: argparse.Namespace) -> int:
    """Measure the parts asked for and print one table each."""
    from percept.errors import UsageError

    if len(arguments.parts) == 1 and arguments.parts[0] in _WRITERS:
        print(_WRITERS[arguments.parts[0]](arguments))
        return 0
    parts = list(arguments.parts) or ([] if arguments.stability else ["sampling", "magnitude"])
    if arguments.stability:
        parts += ["moments", "tolerance", "density", "haptics"]
    unknown = [part for part in parts if part not in _PARTS]
    if unknown:
        raise UsageError(
            f"not a part that goes with others; those are {', '.join(_PARTS)}.", value=unknown[0]
        )
    found: dict[str, list[dict[str, Any]]] = {}
    for part in parts:
        print(f"measuring {part}", file=sys.stderr)
        begun, before = time.perf_counter(), os.getloadavg()[0]
        records = _measured(part, arguments)
        if arguments.out:
            loads, seconds = (before, os.getloadavg()[0]), time.perf_counter() - begun
            path = _write(part, records, arguments, loads, seconds)
            print(path, file=sys.stderr if arguments.json else sys.stdout)
        found[part] = [dataclasses.asdict(record) for record in records]
    if arguments.json:
        print(json.dumps(found, indent=1))
    if arguments.json or arguments.out:
        return 0
    import pandas as pd

    for part, rows in found.items():
        print(f"\n{part}\n{pd.DataFrame(rows).to_string(index=False, float_format='{:.4g}'.format)}")
    return 0


def _measured(part: str, arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.errors import UsageError

    try:
        return _PARTS[part](arguments)
    except ModuleNotFoundError as error:
        raise UsageError(
            f"{part} needs {error.name}, which is not installed.",
            hint="Install percept with its extra: percept[bench].",
        ) from error


def _write(
    part: str,
    records: Sequence[Any],
    arguments: argparse.Namespace,
    loads: tuple[float, float],
    seconds: float,
) -> Path:
    from percept.bench.measurement import measurement, write_measurement

    sizes = {"haptics": f" --cases {arguments.cases}", "workers": f" --studies {arguments.studies}"}
    command = f"percept bench {part}{sizes.get(part, '')} --out DIR"
    document = measurement(
        part, records, command=command, simulated=part in _SIMULATED, loads=loads, seconds=seconds
    )
    return write_measurement(document, arguments.out)


def _published() -> Any:
    """Return the published study's sessions under its scene."""
    from percept.reproduce.published import dataset
    from percept.scene import Scene
    from percept.sessions import read_sessions
    from percept.study import Study

    return Study(read_sessions(dataset("hbfd_sessions.csv")), Scene.load(dataset("hbfd.toml")))


def _sampling(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.sampling import sampling_cost
    from percept.reproduce.published import dataset
    from percept.scene import Scene

    return sampling_cost(dataset("hbfd_sessions.csv"), Scene.load(dataset("hbfd.toml")))


def _magnitude(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.haptics import magnitude_cost

    return [magnitude_cost()]


def _propagation(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.propagation import study_propagation

    return study_propagation(_published())


def _envelope(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.envelope import envelope_costs

    return envelope_costs(_published())


def _memory(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.propagation import propagation_memory
    from percept.haptics import Device

    return [propagation_memory(Device(1.0, 5.0))]


def _moments(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.classical import digits_kept

    return digits_kept()


def _coverage(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.classical import coverage

    return coverage()


def _tolerance(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.tolerance_digits import tolerance_digits

    return tolerance_digits()


def _density(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.density_digits import density_digits

    return density_digits()


def _haptics(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.haptics_digits import digits_kept

    return digits_kept(arguments.cases)


def _skipping(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.skipping import skipping_cost

    return skipping_cost()


def _growth(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.growth import growth

    return growth(told=_told)


def _workers(arguments: argparse.Namespace) -> Sequence[Any]:
    from percept.bench.workers import batch_costs

    return batch_costs(arguments.studies)


_PARTS: dict[str, Callable[[argparse.Namespace], Sequence[Any]]] = {
    "sampling": _sampling,
    "magnitude": _magnitude,
    "propagation": _propagation,
    "envelope": _envelope,
    "memory": _memory,
    "moments": _moments,
    "tolerance": _tolerance,
    "density": _density,
    "coverage": _coverage,
    "haptics": _haptics,
    "skipping": _skipping,
    "workers": _workers,
    "growth": _growth,
}


def _told(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _peers(arguments: argparse.Namespace) -> Path:
    from percept.bench.peers.run import run_benchmark

    return run_benchmark(
        arguments.out or _OUT, engines=arguments.engines, seconds=arguments.seconds,
        starts=arguments.starts, repeats=arguments.repeats, quick=arguments.quick, told=_told,
    )  # fmt: skip


def _reference(arguments: argparse.Namespace) -> Path:
    from percept.bench.peers.run import run_reference

    return run_reference(arguments.out or _OUT, told=_told)


_WRITERS: dict[str, Callable[[argparse.Namespace], Path]] = {"peers": _peers, "reference": _reference}

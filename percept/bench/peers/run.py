"""The two commands: the whole benchmark, and the reference it is measured against."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from percept.bench.peers.engines import ENGINES, engine


def run_benchmark(
    out: str | Path,
    *,
    engines: Sequence[str] = (),
    seconds: float = 150.0,
    starts: int = 3,
    repeats: int = 5,
    quick: bool = False,
    told: Callable[[str], None] = lambda line: None,
) -> Path:
    """Measure every engine and whole command on the published study's sessions and write the page."""
    from percept.bench.growth import growth
    from percept.bench.peers.document import build_document
    from percept.bench.peers.measure import measure
    from percept.bench.peers.reference import stored_reference
    from percept.bench.peers.whole import whole_commands
    from percept.bench.peers.write import write_benchmark
    from percept.reproduce.published import dataset

    sessions, scene = str(dataset("hbfd_sessions.csv")), str(dataset("hbfd.toml"))
    chosen = [engine(name) for name in engines] or list(ENGINES)
    reference = stored_reference(_hash(sessions))
    begun, before = time.perf_counter(), os.getloadavg()[0]
    told("whole commands")
    whole = whole_commands(sessions, scene, repeats=repeats) if repeats else []
    startups, measured = measure(
        chosen, sessions, reference, starts=starts, seconds=seconds, quick=quick, told=told
    )
    document = build_document(
        startups, measured, whole, reference, growth=growth(log=told) if repeats else [],
        command=_command(engines, seconds, starts, repeats, quick),
        loads=(before, os.getloadavg()[0]), seconds=time.perf_counter() - begun,
    )  # fmt: skip
    return write_benchmark(document, out)


def run_reference(out: str | Path, *, told: Callable[[str], None] = lambda line: None) -> Path:
    """Make the reference limits; finished runs are kept in the folder, and an interrupted call goes on."""
    from percept.bench.peers.reference import make_reference
    from percept.reproduce.published import dataset

    sessions, folder = str(dataset("hbfd_sessions.csv")), Path(out)
    found = make_reference(
        sessions, _hash(sessions), folder, command="percept bench reference --out DIR", told=told
    )
    path = folder / "reference.json"
    path.write_text(json.dumps(found.to_json()) + "\n", encoding="utf-8")
    return path


def _hash(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def _command(engines: Sequence[str], seconds: float, starts: int, repeats: int, quick: bool) -> str:
    parts = ["percept bench peers --out DIR", f"--seconds {seconds:g} --starts {starts} --repeats {repeats}"]
    parts += ["--engines " + " ".join(engines)] if engines else []
    return " ".join(parts + (["--quick"] if quick else []))

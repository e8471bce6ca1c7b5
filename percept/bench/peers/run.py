"""The two commands: the whole benchmark, and the reference it is measured against."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from percept.bench.growth import ROWS, SIZES, growth
from percept.bench.peers.document import build_document, write_benchmark
from percept.bench.peers.engines import ENGINES, engine, missing_packages
from percept.bench.peers.processes import COMMANDS, LONGEST, measure, whole_commands
from percept.bench.peers.reference import make_reference, stored_reference
from percept.errors import RefusalError
from percept.report.plain import plain
from percept.reproduce.published import dataset

_EXTRA = "pip install 'percept[peers]'"


def run_benchmark(
    out: str | Path,
    *,
    engines: Sequence[str] = (),
    seconds: float = 150.0,
    starts: int = 3,
    repeats: int = 5,
    quick: bool = False,
    log: Callable[[str], None] = lambda line: None,
) -> Path:
    """Measure every installed engine and whole command on the published design and write the page."""
    sessions, scene = str(dataset("hbfd_sessions.csv")), str(dataset("hbfd.toml"))
    chosen = [engine(name) for name in engines] or list(ENGINES)
    reference = stored_reference(_hash(sessions))
    left_out = {one.title: one.missing for one in chosen if one.missing}
    present = [one for one in chosen if not one.missing]
    for title, missing in left_out.items():
        log(f"{title}: left out, {', '.join(missing)} not installed; {_EXTRA}")
    if not present:
        raise RefusalError("none of these engines is installed.", value=", ".join(engines), hint=_EXTRA)
    begun, before = time.perf_counter(), os.getloadavg()[0]
    whole, grown = [], []
    if repeats:
        commands = {name: words for name, words in COMMANDS.items() if not quick or name not in LONGEST}
        if missing_packages(("pymc",)):
            del commands["import pymc"]
            left_out["import pymc"] = ("pymc",)
        log("whole commands")
        whole = whole_commands(sessions, scene, repeats=0 if quick else repeats, commands=commands)
    startups, measured = measure(
        present, sessions, reference, starts=starts, seconds=seconds, quick=quick, log=log
    )
    if repeats:
        smallest = {ROWS: SIZES[ROWS][:2]}
        grown = growth(rounds=1, sizes=smallest, fitted={}, log=log) if quick else growth(log=log)
    document = build_document(
        startups, measured, whole, reference, growth=grown, left_out=left_out,
        command=_command(engines, seconds, starts, repeats, quick),
        loads=(before, os.getloadavg()[0]), seconds=time.perf_counter() - begun,
    )  # fmt: skip
    return write_benchmark(document, out)


def run_reference(out: str | Path, *, log: Callable[[str], None] = lambda line: None) -> Path:
    """Make the reference limits; the folder keeps finished runs, and an interrupted call goes on."""
    sessions, folder = str(dataset("hbfd_sessions.csv")), Path(out)
    reference = make_reference(
        sessions, _hash(sessions), folder, command="percept bench reference --out DIR", log=log
    )
    (folder / "reference.json").write_text(json.dumps(plain(reference)) + "\n", encoding="utf-8")
    return folder / "reference.json"


def _hash(path: str) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def _command(engines: Sequence[str], seconds: float, starts: int, repeats: int, quick: bool) -> str:
    parts = ["percept bench peers --out DIR", f"--seconds {seconds:g} --starts {starts} --repeats {repeats}"]
    parts += ["--engines " + " ".join(engines)] if engines else []
    return " ".join(parts + (["--quick"] if quick else []))

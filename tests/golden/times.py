"""Wall and processor times of five commands on the published study: `python -m tests.golden.times`.

Commands run in turn, so that a busy spell of the machine meets all of them. Ratios to importing the
libraries compare machines better than seconds do.
"""

from __future__ import annotations

import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path

from tests import DATASETS
from tests.golden.studies import FOLDER

__all__ = ["measure"]

_TIMES = 5
_LIBRARIES = "import scipy.stats, pandas, matplotlib.pyplot"
_STUDY = [
    str(DATASETS / "hbfd_sessions.csv"),
    "--scene",
    str(DATASETS / "hbfd.toml"),
    "--seed",
    "1",
    "--quiet",
]
_COMMANDS = {
    "percept --help": ["--help"],
    "percept fit --method classical": ["fit", *_STUDY, "--method", "classical"],
    "percept fit --tolerance .02 --no-cache": ["fit", *_STUDY, "--tolerance", ".02", "--no-cache"],
    "percept fit --no-cache": ["fit", *_STUDY, "--no-cache"],
    "percept report --no-cache": ["report", *_STUDY, "--no-cache"],
}


def measure(arguments: list[str], folder: str) -> tuple[float, float]:
    """Run Python with arguments in a folder; wall and processor seconds, its children's
    included."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    paths = {"PYTHONPATH": str(FOLDER.parent.parent), "PERCEPT_CACHE": "off"}
    subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=os.environ | paths,
        check=True,
        stdout=subprocess.DEVNULL,
    )
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _all() -> dict[str, dict[str, float]]:
    commands = {_LIBRARIES: ["-c", _LIBRARIES]}
    commands |= {name: ["-m", "percept", *arguments] for name, arguments in _COMMANDS.items()}
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(_TIMES):
            for name, arguments in commands.items():
                taken[name].append(measure(arguments, folder))
    medians = {
        name: [statistics.median(column) for column in zip(*runs, strict=True)]
        for name, runs in taken.items()
    }
    own = medians[_LIBRARIES]
    return {
        name: {
            "wall": round(wall, 3),
            "processor": round(processor, 3),
            "wall ratio": round(wall / own[0], 3),
            "processor ratio": round(processor / own[1], 3),
        }
        for name, (wall, processor) in medians.items()
    }


if __name__ == "__main__":
    libraries = ("numpy", "scipy", "pandas", "emcee", "matplotlib")
    document = {
        "python": platform.python_version(),
        "libraries": {name: metadata.version(name) for name in libraries},
        "cores": os.cpu_count(),
        "load before": round(os.getloadavg()[0], 2),
        "runs": _TIMES,
        "seconds": _all(),
    }
    path: Path = FOLDER / "times.json"
    path.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")

"""What is saved by leaving out what a scene does not need: each scene in a process of its own.

Every scene is the published study less one thing.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from percept.bench.as_installed import as_installed

if TYPE_CHECKING:
    from percept.study import Study

#: Scenes by what each leaves out.
SCENES = (
    "nothing",
    "coupling",
    "device",
    "one parameter",
    "all but one environment",
    "bayesian",
    "page and figures",
)
#: Packages, of others and of ours, that some scene does without.
PACKAGES = (
    "emcee",
    "arviz_base",
    "arviz_stats",
    "xarray",
    "h5netcdf",
    "matplotlib.figure",
    "jinja2",
    "percept.inference.hierarchy",
    "percept.inference.sampling",
    "percept.boundary",
    "percept.report.figures",
)
#: What a study works out, each only when it is asked for.
STAGES = (
    "intervals",
    "fit",
    "posterior_groups",
    "regions",
    "curve_draws",
    "boundaries",
    "sensitivity",
    "coupling",
    "realism",
    "coupling_design",
    "band",
    "comparison",
)


@dataclasses.dataclass(frozen=True)
class Saving:
    """The cost of one scene."""

    without: str  # What is left out, one of `SCENES`
    seconds: float
    seconds_low: float
    seconds_high: float
    share: float  # Of the first scene's time, by default the one that leaves nothing out
    imports: tuple[str, ...]  # Of `PACKAGES`
    stages: tuple[str, ...]  # Of `STAGES`, those that gave something
    coordinates: int  # Of the hierarchical model


def skipping_cost(
    *,
    repeats: int = 3,
    tolerance: float = 0.05,
    scenes: Sequence[str] = SCENES,
    method: str = "both",
) -> tuple[Saving, ...]:
    """Run scenes, round by round, so that all see the same machine."""
    rounds = [
        {scene: work_of(scene, tolerance=tolerance, method=method) for scene in scenes}
        for _ in range(repeats)
    ]
    taken = {scene: [one[scene]["seconds"] for one in rounds] for scene in scenes}
    return tuple(
        Saving(
            without=scene,
            seconds=median(taken[scene]),
            seconds_low=min(taken[scene]),
            seconds_high=max(taken[scene]),
            share=median(taken[scene]) / median(taken[scenes[0]]),
            imports=tuple(rounds[0][scene]["imports"]),
            stages=tuple(rounds[0][scene]["stages"]),
            coordinates=rounds[0][scene]["coordinates"],
        )
        for scene in scenes
    )


def work_of(
    scene: str, *, tolerance: float = 0.05, points: int | None = None, method: str = "both"
) -> dict[str, Any]:
    """Run one scene in a fresh process."""
    command = [sys.executable, "-m", __name__, scene, "--tolerance", str(tolerance), "--method", method]
    if points is not None:
        command += ["--points", str(points)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=as_installed())
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def _main(words: Sequence[str] | None = None) -> None:
    """Do the work of one scene and print what it took as JSON."""
    parser = argparse.ArgumentParser(description=_main.__doc__)
    parser.add_argument("scene", choices=SCENES)
    parser.add_argument("--tolerance", type=float, required=True)
    parser.add_argument("--method", required=True)
    parser.add_argument("--points", type=int)
    asked = parser.parse_args(words)
    study = _study(asked.scene, asked.tolerance, asked.method, asked.points)
    with tempfile.TemporaryDirectory() as folder:
        if asked.scene == "page and figures":
            from percept.report.fit import write_fit

            write_fit(study, Path(folder) / "out")
        else:
            from percept.report.write import write_report

            write_report(study, Path(folder) / "out")
    diagnostics = study.diagnostics or {"dimension": 0}
    found = {
        "seconds": time.process_time(),
        "imports": [name for name in PACKAGES if name in sys.modules],
        # Tables are kept under a name of their own, since those asked for are copies.
        "stages": [name for name in STAGES if _worked(vars(study).get(name, vars(study).get(f"_{name}")))],
        "coordinates": diagnostics["dimension"],
    }
    sys.stdout.write(json.dumps(found) + "\n")


def _study(without: str, tolerance: float, method: str, points: int | None) -> Study:
    from percept.reproduce.published import dataset
    from percept.scene import Scene
    from percept.sessions import Sessions, read_sessions
    from percept.study import Study

    tables = Scene.load(dataset("hbfd.toml")).to_dict()
    tables["inference"] |= {
        "tolerance": tolerance,
        "method": "classical" if without == "bayesian" else method,
    }
    if points is not None:
        tables["frequency"]["points"] = points
    if without in ("coupling", "device"):
        del tables[without]
    if without == "one parameter":
        tables["inference"]["parameters"] = ["k"]
    scene = Scene.from_tables(tables)
    sessions = read_sessions(dataset("hbfd_sessions.csv"))
    if without == "all but one environment":
        table = sessions.table
        sessions = Sessions.from_frame(table[table["environment"] == sessions.environments[0]])
    return Study(sessions, scene)


def _worked(result: Any) -> bool:
    """Say whether a stage was asked for and gave something."""
    return result is not None and (not hasattr(result, "__len__") or len(result) > 0)


if __name__ == "__main__":
    _main()

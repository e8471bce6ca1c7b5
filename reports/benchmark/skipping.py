"""What a scene saves that leaves one thing out of the published study, in a process of its own."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence, Sized
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated

from reports.benchmark.measure import Printed, in_a_process, print_result

if TYPE_CHECKING:
    from percept.study import Study


#: Scenes by what each leaves out.
_SCENES = (
    "nothing",
    "coupling",
    "device",
    "one parameter",
    "all but one environment",
    "bayesian",
    "page and figures",
)
#: Packages, of others and of ours, that some scene does without.
_PACKAGES = (
    "emcee",
    "arviz_base",
    "arviz_stats",
    "xarray",
    "h5netcdf",
    "matplotlib.figure",
    "jinja2",
    "percept.inference.model",
    "percept.inference.sampling",
    "percept.boundary",
    "percept.report.figures",
)
#: What a study works out, each only when it is asked for.
STAGES = (
    "intervals",
    "fit",
    "posterior",
    "regions",
    "curve_laws",
    "boundaries",
    "other_devices",
    "coupling",
    "users",
    "verdicts",
    "coupling_map",
    "band",
)


@dataclass(frozen=True)
class Saving:
    """The cost of one scene."""

    without: Annotated[str, "What is left out."]
    seconds: Annotated[
        float, "Processor time of the whole process, imports included: median of the rounds."
    ]
    share: Annotated[float, "seconds divided by the first scene's, which leaves nothing out."]
    imports: Annotated[tuple[str, ...], "Packages imported, of those some scene does without."]
    stages: Annotated[tuple[str, ...], "What the study worked out."]
    coordinates: Annotated[int, "Of the hierarchical model; 0 without one."]


def skipping_cost(*, repeats: int = 3) -> tuple[Saving, ...]:
    """Run scenes, round by round, so that all see the same machine.

    Parameters
    ----------
    repeats : int
        Rounds.

    Returns
    -------
    tuple of Saving
        A row for each scene; the first leaves nothing out.
    """
    rounds = []
    for _ in range(repeats):
        rounds.append({scene: work_of(scene) for scene in _SCENES})
    return savings(rounds)


def savings(rounds: Sequence[Mapping[str, Printed]]) -> tuple[Saving, ...]:
    """Reduce rounds of every scene's work; the first scene leaves nothing out."""
    rows: list[Saving] = []
    for scene, work in rounds[0].items():
        seconds = median(works[scene]["seconds"] for works in rounds)
        whole = rows[0].seconds if rows else seconds
        imports = tuple(work["imports"])
        stages = tuple(work["stages"])
        rows.append(Saving(scene, seconds, seconds / whole, imports, stages, work["coordinates"]))
    return tuple(rows)


def work_of(scene: str, *, tolerance: float = 0.05, method: str = "both") -> Printed:
    """Run one scene in a fresh process; its seconds, imports, stages and coordinates."""
    return in_a_process(__name__, [scene, tolerance, method])


def _main(task: str) -> None:
    """Do the work of one scene and print what it took as JSON."""
    from percept.report import fill_fit, fit_folder

    scene, tolerance, method = json.loads(task)
    study = study_without(scene, tolerance=tolerance, method=method)
    with tempfile.TemporaryDirectory() as folder:
        if scene == "page and figures":
            with fit_folder(Path(folder) / "out") as into:
                fill_fit(into, study.results(curves=False), posterior=study.posterior)
        else:
            study.report(Path(folder) / "out")
    fit = study.fit
    work = {
        "seconds": time.process_time(),
        "imports": [name for name in _PACKAGES if name in sys.modules],
        "stages": stages_of(study),
        "coordinates": fit.run.points.shape[-1] if fit else 0,
    }
    print_result(work)


def stages_of(study: Study) -> list[str]:
    """Name what a study worked out and what is not empty."""
    parts = vars(study)
    results = {name: parts.get(name) for name in STAGES}
    results["intervals"] = parts.get("interval_rows")
    return [name for name, result in results.items() if not _empty(result)]


def study_without(
    without: str, *, tolerance: float = 0.05, method: str = "both", points: int | None = None
) -> Study:
    """Open the published study, one thing left out; `points` makes its grid coarser."""
    from percept.scene import Scene
    from percept.sessions import Sessions, read_sessions
    from percept.study import Study
    from reports import dataset

    tables = Scene.load(dataset("hbfd.toml")).to_dict()
    tables["inference"]["tolerance"] = tolerance
    tables["inference"]["method"] = "classical" if without == "bayesian" else method
    if points is not None:
        tables["frequency"]["points"] = points
    if without in ("coupling", "device"):
        del tables[without]
    if without == "one parameter":
        tables["inference"]["parameters"] = ["k"]
    scene = Scene(**tables)
    sessions = read_sessions(dataset("hbfd_sessions.csv"))
    if without == "all but one environment":
        table = sessions.table
        sessions = Sessions.from_frame(table[table["environment"] == sessions.environments[0]])
    return Study(sessions, scene)


def _empty(result: object) -> bool:
    return result is None or (isinstance(result, Sized) and len(result) == 0)


if __name__ == "__main__":
    _main(sys.argv[1])

"""Study: an analysis of sessions under a scene, as its reader asks for it."""

from __future__ import annotations

import platform
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from functools import partial
from importlib import metadata
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import pandas as pd

import percept
from percept import results
from percept.errors import RefusalError, UsageError, counted
from percept.html import fields_html
from percept.results import (
    Beside,
    Coupling,
    Diagnostics,
    Prior,
    Provenance,
    Results,
    Skipped,
    in_turn,
    plain,
)
from percept.scene import Scene
from percept.sessions import Sessions, read_sessions
from percept.study.basics import select
from percept.study.conditions import told_apart
from percept.study.data import Data, what_was_read
from percept.study.displayed import Displayed

if TYPE_CHECKING:
    from percept.inference.sampling.gate import Progress
    from percept.study.fit import RunStore


#: Libraries whose versions decide the last digits of a result.
_PACKAGES = ("numpy", "scipy", "pandas", "emcee", "arviz-base", "arviz-stats")
#: More environments than anybody tests: their contrasts and page would take hours.
_MOST_ENVIRONMENTS = 1_000
#: Parts that may skip something, in the order in which `Study.skipped` lists it.
_SKIPPING = (
    "interval_rows", "prepared", "with_reference", "_setups", "contrast_rows", "anova", "banded",
    "pairs", "psychophysics_rows", "equivalence_rows", "without_maps", "_checked",
)  # fmt: skip
_ABOUT = ["environment", "parameter", "kind", "family", "unit", "reference"]
_LIMITS = ["estimate", "lower", "upper"]


class Study(Displayed):
    """An analysis of sessions under a scene.

    Nothing is computed before it is asked for; what the scene does not need is never computed, and
    `skipped` says why.

    Parameters
    ----------
    sessions : Sessions, path, sequence of paths or DataFrame
        What the reader gave, or what `read_sessions` is to read as the scene says.
    scene : Scene, str or Path, optional
        What to analyse, or the file that says so; defaults throughout.
    progress : callable, optional
        Told the state of the sampler as it runs.
    store : RunStore, optional
        Where finished runs of the sampler are kept, such as `percept.cache.PosteriorCache`; none by
        default.

    Raises
    ------
    UsageError
        What cannot be read, or sessions that were read without what the scene says on data.
    RefusalError
        From the properties, where the data cannot carry the analysis.
    """

    def __init__(
        self,
        sessions: Sessions | str | Path | pd.DataFrame | Sequence[str | Path],
        scene: Scene | str | Path | None = None,
        *,
        progress: Callable[[Progress], None] | None = None,
        store: RunStore | None = None,
    ) -> None:
        if isinstance(scene, str | Path):
            scene = Scene.load(scene)
        scene = scene or Scene()
        if isinstance(sessions, str | Path):
            sessions = [sessions]
        if isinstance(sessions, pd.DataFrame):
            sessions = Sessions.from_frame(sessions, scene=scene)
        elif isinstance(sessions, Sequence):
            sessions = read_sessions(*sessions, scene=scene)
        elif not isinstance(sessions, Sessions):
            kind = type(sessions).__name__
            hint = "Give Sessions, files or a DataFrame."
            raise UsageError(f"a study is of sessions, not of {kind}.", hint=hint)
        sessions.options.require(scene)
        if len(sessions.environments) > _MOST_ENVIRONMENTS:
            raise RefusalError(
                f"{len(sessions.environments):,} environments are more than the"
                f" {_MOST_ENVIRONMENTS:,} that a study may have.",
                key="columns.environment",
                hint="See whether this column differs in every row; name another.",
            )
        super().__init__(Data(told_apart(sessions, scene), scene), progress, store)

    def over(self, sessions: Sessions, scene: Scene | None = None) -> Study:
        """Analyse other sessions, or under another scene, with the same progress and store."""
        return Study(sessions, scene or self.scene, progress=self.progress, store=self.store)

    @property
    def skipped(self) -> pd.DataFrame:
        """What was not computed, and why: a row each."""
        return pd.DataFrame(self.skipped_rows, columns=["what", "why"])

    @property
    def skipped_rows(self) -> tuple[Skipped, ...]:
        """What was not computed, and why."""
        return self.skipped_of(*_SKIPPING, "boundaries")

    @property
    def skipped_before_curves(self) -> tuple[Skipped, ...]:
        """What was not computed, and why, curves of laws not counted: they take time to draw."""
        return self.skipped_of(*_SKIPPING)

    @property
    def skipped_curves(self) -> tuple[Skipped, ...]:
        """Which curves of laws were not drawn, and why."""
        return self.skipped_of("boundaries")

    def summary(self, kind: str | None = "user") -> pd.DataFrame:
        """Lay the intervals out wide: a row per environment, parameter and kind.

        Parameters
        ----------
        kind : {"user", "mean", "share"} or None
            Whose intervals; None for every kind the scene asks for. Another kind is a UsageError.

        Returns
        -------
        DataFrame
            `reference`, `unit`, `family`, and per method `METHOD_estimate`, `METHOD_lower` and
            `METHOD_upper` in that unit. The family is the scene's, or the other one where it has no
            interval. Limits hold for each parameter by itself.
        """
        kinds = select("kind", kind, self.data.asked.kinds)
        cells: dict[tuple[str, str, str], dict[str, object]] = {}
        # Where the scene's family has no interval at all, the other one stands in.
        of_family = [row for row in self.interval_rows if row.family == self.data.asked.family]
        for row in (*of_family, *self.interval_rows):
            if row.joint != "marginal" or row.kind not in kinds:
                continue
            about = {name: getattr(row, name) for name in _ABOUT}
            line = cells.setdefault((row.environment, row.parameter, row.kind), about)
            if row.family == line["family"]:
                line |= {f"{row.method}_{name}": getattr(row, name) for name in _LIMITS}
        return pd.DataFrame(cells.values())

    # All of it, as a report takes it.

    @property
    def read(self) -> results.Data:
        """What was read: subjects, quantities, notices, and every cell's values."""
        return what_was_read(self.data)

    @property
    def provenance(self) -> Provenance:
        """What the results are made from: versions, seed, files and scene."""
        versions = {"percept": percept.__version__, "python": platform.python_version()}
        versions |= {package: metadata.version(package) for package in _PACKAGES}
        sources = self.sessions.sources
        files = [replace(source, name=PurePath(source.name).name) for source in sources]
        seed = self.scene.inference.seed
        return Provenance(versions, seed, tuple(files), plain(self.scene.to_dict()))

    @property
    def diagnostics(self) -> Diagnostics | None:
        """How the fit was sampled; None without one."""
        fit = self.fit
        if fit is None:
            return None
        from percept.inference.model.priors import MEANINGS

        ensembles, _, walkers, _ = fit.run.points.shape
        priors = fit.model.priors_in_force
        return Diagnostics(
            gate=fit.run.gate,
            steps=fit.run.steps,
            ensembles=ensembles,
            walkers=walkers,
            tolerance=fit.run.settings.tolerance,
            priors=tuple(Prior(name, value, MEANINGS[name]) for name, value in priors.items()),
        )

    def results(
        self,
        *,
        curves: bool = True,
        why: bool = False,
        progress: Callable[[str], None] | None = None,
        beside: Beside = in_turn,
    ) -> Results:
        """Compute everything that a report needs, and put it into records.

        Parameters
        ----------
        curves : bool
            Whether boundaries, the coupling judged by them and the band law are wanted; else they
            are absent.
        why : bool
            Whether the reasons why the methods differ are wanted; it samples the models between.
        progress : callable, optional
            Called with the name of each step.
        beside : callable
            Works out checks, verdicts and maps while the rest is computed, as
            `percept.workers.beside` does; by default all is computed in turn.

        Returns
        -------
        percept.results.Results
            As report.json holds it.

        Raises
        ------
        PerceptError
            What the study refuses.
        """
        given = {"": True, "curves": curves, "why": why}
        sources = results.parts()
        asked = [name for name, part in sources.items() if given[part.needs]]

        def work_out(names: Iterable[str]) -> dict[str, Any]:
            found = {}
            for name in names:
                part = sources[name]
                if progress and part.step:
                    progress(part.step)
                found[name] = getattr(self, part.of or name)
            return found

        # What both need: the fit, and who uses a device.
        found = work_out(["intervals"])
        if curves:
            _ = self.users, self.subjects
        of_copy = [name for name in asked if sources[name].beside]
        with beside(lambda: work_out) as begin:
            done = begin(of_copy)
            found |= work_out(name for name in asked if name not in (*found, *of_copy))
            found |= done()
        if curves:
            found["skipped"] += self.skipped_curves
        elif self.interval_rows:
            absent = Skipped("boundaries, coupling and band law", "run percept report")
            found["skipped"] += (absent,)
        return Results(**found)

    def report(self, directory: str | Path, **options: Any) -> Path:
        """Write page, JSON, tables, figures and posterior into a folder; return the page's path.

        The folder is made where it does not exist. UsageError where it cannot be written, or where
        it holds files that percept did not write: before anything is computed.
        Options go to `percept.report.report_folder` and `percept.report.fill_report`, such
        as ``formats=("pdf",)``, and `why` of `results`.
        """
        from percept.report import fill_report, report_folder

        formats = options.pop("formats", ("svg",))
        force = options.pop("force", False)
        why = options.pop("why", False)
        beside = options.pop("beside", in_turn)
        progress = options.get("progress")
        with report_folder(directory, formats=formats, force=force) as folder:
            results = partial(self.results, why=why, progress=progress, beside=beside)
            options |= {"formats": formats, "beside": beside}
            fill_report(folder, results, posterior=self.posterior_file, **options)
        return Path(directory) / "report.html"

    def decide(self, **options: Any) -> tuple[str, ...]:
        """Say what is so, how sure that is, and what to do next: a report's first sentences.

        Options go to `results`.
        """
        from percept.report.overview import decide

        return tuple(decide(self.results(**options)))

    @property
    def coupling(self) -> Coupling:
        """The coupling by the paper, Eq. 10 and its rule; RefusalError without a coupling."""
        if self.coupling_row is None:
            raise RefusalError(
                "there is no coupling.", hint="Give the scene a [device] and a [coupling]."
            )
        return self.coupling_row

    # Every plot draws on the matplotlib axes `ax`, or on a new figure without them, and returns the
    # axes. It raises UsageError for a name that the study does not have, RefusalError where there
    # is nothing to plot.

    def plot_intervals(
        self,
        parameter: str | None = None,
        *,
        kinds: Collection[str] | None = None,
        ax: Any = None,
    ) -> Any:
        """Plot intervals of a quantity over its references: the first one, or that named."""
        from percept.plots import plot_intervals

        known = self.data.parameters
        (parameter,) = select("parameter", parameter or known[0], known)
        return plot_intervals(
            self.interval_rows,
            self.read,
            parameter=parameter,
            kinds=select("kind", kinds, self.scene.inference.kinds),
            family=self.scene.inference.family,
            ax=ax,
        )

    def plot_boundary(self, environment: str, *, kind: str = "user", ax: Any = None) -> Any:
        """Plot boundaries of abs(Z_h), N·s/m, over rad/s, of one kind, by default the next user."""
        from percept.plots import plot_boundary

        (kind,) = select("kind", kind, self.scene.inference.kinds)
        boundaries = self.boundaries
        if boundaries:
            (environment,) = select("environment", environment, self.with_reference)
        return plot_boundary(
            boundaries, environment, kind, family=self.scene.inference.family, ax=ax
        )

    def plot_band(self, parameter: str | None = None, *, ax: Any = None) -> Any:
        """Plot bands and their laws against environments' impedance, or a parameter's reference."""
        from percept.plots import plot_band

        family = self.scene.inference.family
        return plot_band(self.band, self.read, parameter, family=family, ax=ax)

    def plot_coupling(self, *, ax: Any = None) -> Any:
        """Plot the paper's criterion for the coupling (Eq. 10) over omega, rad/s."""
        from percept.plots import plot_coupling

        return plot_coupling(self.coupling, ax=ax)

    def __repr__(self) -> str:
        adjusted = " and ".join(self.sessions.parameters)
        where = counted(len(self.sessions.environments), "environment")
        return f"<Study of {adjusted} in {where}, {self.sessions.form}>"

    def _repr_html_(self) -> str:
        """Say in a notebook what the study is; nothing is computed."""
        sessions = self.sessions
        asked = self.scene.inference
        names = [sessions.quantities[name].words for name in sessions.parameters]
        about = {
            "quantities": ", ".join(names),
            "environments": len(sessions.environments),
            "subjects": len(sessions.subjects) or "published limits",
            "method": f"{asked.method}, {asked.family}, level {asked.level:g}",
            "device": "none" if self.scene.device is None else "yes",
            "coupling": "none" if self.scene.coupling is None else "yes",
        }
        return fields_html(about, caption="Study")

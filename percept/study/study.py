"""Study: an analysis of sessions under a scene, as its reader asks for it."""

from __future__ import annotations

import html
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from percept.boundary.band import BandStudy
from percept.errors import RefusalError, UsageError, counted
from percept.html import fields_html
from percept.results import Band, Boundary, Coupling, IntervalRow, Rendered, Results, Verdict
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.basics import Skipped, results, select
from percept.study.conditions import told_apart
from percept.study.contrast_table import chosen_contrasts
from percept.study.intervals import KEYS
from percept.study.parts import Parts
from percept.study.results import compute, data_of, record, rows

# What imports the hierarchical model is imported where it is needed: the classical method does
# without.
if TYPE_CHECKING:
    from xarray import DataTree

    from percept.inference.sampling.gate import Progress
    from percept.study.fit import RunStore

__all__ = ["Study"]

#: More environments than anybody tests: their contrasts and page would take hours.
_MOST_ENVIRONMENTS = 1_000
_CELL = ["environment", "parameter", "kind"]
_LIMITS = ["estimate", "lower", "upper"]
_LABELS = ("environment", "kind", "method", "family", "joint", "shape", "level")
_CURVES = ("omega", "lower", "upper", "reference", "coupled")
#: Parts that the card in a notebook names once they are computed.
_KEPT = {
    "interval_rows": "intervals",
    "_fit": "fit",
    "contrast_rows": "contrasts",
    "posterior": "posterior",
    "_checked": "checks",
    "regions": "regions",
    "boundaries": "boundaries",
    "band": "band",
    "coupling": "coupling",
    "coupling_map": "coupling_map",
    "other_devices": "other_devices",
    "ladder": "ladder",
}
_CALLS = {
    "study.summary()": "both methods side by side",
    "study.plot_intervals()": "intervals over their references",
    "study.report(folder)": "the report: page, tables, figures",
    "study.skipped": "what is not computed, and why",
}


class Study:
    """An analysis of sessions under a scene.

    Nothing is computed before it is asked for; what the scene does not need is never computed, and
    `skipped` says why.

    Parameters
    ----------
    sessions : Sessions
        What the reader gave.
    scene : Scene, str or Path, optional
        What to analyse, or the file that says so; defaults throughout.
    progress : callable, optional
        Told the state of the sampler after every round.
    store : RunStore, optional
        Where finished runs of the sampler are kept, such as `percept.cache.PosteriorCache`; none by
        default.

    Raises
    ------
    UsageError
        Anything but Sessions, or sessions that were read without what the scene says on data.
    RefusalError
        From the properties, where the data cannot carry the analysis.
    """

    def __init__(
        self,
        sessions: Sessions,
        scene: Scene | str | Path | None = None,
        *,
        progress: Callable[[Progress], None] | None = None,
        store: RunStore | None = None,
    ) -> None:
        if not isinstance(sessions, Sessions):
            raise UsageError(
                f"a study is of Sessions, not of {type(sessions).__name__}.",
                hint="read_sessions reads files, Sessions.from_frame takes a DataFrame.",
            )
        if isinstance(scene, str | Path):
            scene = Scene.load(scene)
        self.scene = scene or Scene()
        sessions.options.require(self.scene)
        if len(sessions.environments) > _MOST_ENVIRONMENTS:
            raise RefusalError(
                f"{len(sessions.environments):,} environments are more than the"
                f" {_MOST_ENVIRONMENTS:,} that a study may have.",
                key="columns.environment",
                hint="See whether this column differs in every row; name another.",
            )
        self.sessions = told_apart(sessions, self.scene)
        #: What the study computes, part by part: also the fit, contrasts, checks and boundaries at
        #: other frequencies.
        self.parts = Parts(self.sessions, self.scene, progress, store)

    @property
    def intervals(self) -> pd.DataFrame:
        """Intervals of every method, kind and family, one row each, in their units; a copy."""
        return self.parts.intervals

    @property
    def interpretation(self) -> pd.DataFrame:
        """What each row of `intervals` covers, in a sentence."""
        return pd.DataFrame(results(self.parts.interval_rows), columns=[*KEYS, "covers"])

    @property
    def psychophysics(self) -> pd.DataFrame:
        """Points of equality, thresholds, spreads and reliability, one row each."""
        return pd.DataFrame(self.parts.psychophysics.rows)

    @property
    def equivalence(self) -> pd.DataFrame:
        """Whether each bias is smaller than the JND of `[study] jnd`; empty without one."""
        return pd.DataFrame(results(self.parts.psychophysics.equivalence))

    def contrast(self, asked: str) -> pd.DataFrame:
        """Contrasts of one factor, covariate or interaction, of every method.

        Parameters
        ----------
        asked : str
            A factor with two levels, such as "hand: left - right", or the name of a factor, a
            covariate or an interaction, such as "hand:load", for all that there is of it.

        Returns
        -------
        DataFrame
            A row per pair of levels (`second` against `first`), reference, parameter, `of` (bias,
            spread, interaction or slope), kind and method. Limits are ratios under the lognormal
            family; of bias under the normal one they are differences in `unit`. `environment` is
            None for the average over `references`.

        Raises
        ------
        UsageError
            A factor or a level that the model does not have.
        """
        return chosen_contrasts(self.parts.contrasts, asked)

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
        intervals = self.intervals
        asked = self.scene.inference
        kinds = select("kind", kind, asked.kinds)
        rows = intervals[(intervals["joint"] == "marginal") & intervals["kind"].isin(kinds)]
        own = rows["family"] == asked.family
        # Where the scene's family has no interval at all, the other one stands in.
        known = pd.MultiIndex.from_frame(rows[own][_CELL])
        rows = rows[own | ~pd.MultiIndex.from_frame(rows[_CELL]).isin(known)]
        table = rows.drop_duplicates(_CELL)[[*_CELL, "family", "unit", "reference"]]
        for method, found in rows.groupby("method", sort=False):
            named = found[[*_CELL, *_LIMITS]].rename(
                columns={name: f"{method}_{name}" for name in _LIMITS}
            )
            table = table.merge(named, on=_CELL, how="left")
        return table.reset_index(drop=True)

    @property
    def posterior(self) -> DataTree | None:
        """Posterior as an ArviZ DataTree, thinned to the effective size; None unless it passed."""
        return self.parts.posterior

    @property
    def boundaries(self) -> tuple[Boundary, ...]:
        """Boundaries of abs(Z_h) over the scene's frequencies; empty without device, k or b."""
        return self.parts.boundaries

    @property
    def curves(self) -> pd.DataFrame:
        """The boundaries as one tidy table: a row per curve and frequency, rad/s and N·s/m."""
        names = (*_LABELS, *_CURVES)
        tables = [
            pd.DataFrame({name: getattr(one, name) for name in names}) for one in self.boundaries
        ]
        if not tables:
            return pd.DataFrame(columns=names)
        # Without a coupling its column is empty, and still of numbers.
        return pd.concat(tables, ignore_index=True).astype({"coupled": float})

    @property
    def band(self) -> BandStudy | None:
        """Band of the environments' size and its law; None with one environment, or no size."""
        return self.parts.band

    @property
    def coupling(self) -> Coupling:
        """The coupling by the paper, Eq. 10 and its rule; RefusalError without a coupling."""
        if self.parts.coupling is None:
            skipped = self.parts.skipped_before_curves
            why = next((part.why for part in skipped if part.what.startswith("coupling")), "")
            raise RefusalError(
                f"there is no coupling: {why or 'the scene has no [device]'}.",
                hint="Give the scene a [device] and a [coupling].",
            )
        return self.parts.coupling

    @property
    def rendering(self) -> tuple[Rendered, ...]:
        """What the device renders with every passive hand, in time; empty without a device."""
        return self.parts.rendering

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether each environment feels real, directly and coupled; empty without a device."""
        return self.parts.verdicts

    @property
    def skipped(self) -> tuple[Skipped, ...]:
        """What was not computed, and why."""
        return self.parts.skipped

    def results(
        self,
        *,
        curves: bool = True,
        why: bool = False,
        progress: Callable[[str], None] | None = None,
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

        Returns
        -------
        percept.results.Results
            As report.json holds it.

        Raises
        ------
        PerceptError
            What the study refuses.
        """
        return compute(self.parts, curves=curves, why=why, progress=progress)

    def report(self, directory: str | Path, **options: Any) -> Path:
        """Write page, JSON, tables, figures and posterior into a folder; return the page's path.

        The folder is made where it does not exist. UsageError where it cannot be written, or where
        it holds files that percept did not write: before anything is computed.
        Options go to `percept.report.report_folder` and `percept.report.fill_report`, such
        as ``formats=("pdf",)``, and `why` of `results`.
        """
        # Matplotlib is slow to import.
        from percept.report import fill_report, report_folder

        formats = options.pop("formats", ("svg",))
        force = options.pop("force", False)
        why = options.pop("why", False)
        progress = options.get("progress")
        with report_folder(directory, formats=formats, force=force) as folder:
            results = self.results(why=why, progress=progress)
            fill_report(folder, results, posterior=self.parts.posterior, formats=formats, **options)
        return Path(directory) / "report.html"

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
        """Plot intervals over their references: of every parameter and kind, or those named."""
        from percept.plots import plot_intervals

        return plot_intervals(
            rows(IntervalRow, results(self.parts.interval_rows)),
            data_of(self.sessions, self.scene),
            parameters=select("parameter", parameter, self.parts.parameters),
            kinds=select("kind", kinds, self.scene.inference.kinds),
            family=self.scene.inference.family,
            ax=ax,
        )

    def plot_boundary(self, environment: str, *, kind: str | None = None, ax: Any = None) -> Any:
        """Plot boundaries of abs(Z_h), N·s/m, over rad/s, of one kind, by default the next user."""
        from percept.plots import plot_boundary

        kinds = self.scene.inference.kinds
        (kind,) = select("kind", kind or ("user" if "user" in kinds else kinds[0]), kinds)
        boundaries = self.boundaries
        if boundaries:
            (environment,) = select("environment", environment, self.parts.with_reference)
        return plot_boundary(
            boundaries, environment, kind, family=self.scene.inference.family, ax=ax
        )

    def plot_band(self, parameter: str | None = None, *, ax: Any = None) -> Any:
        """Plot bands and their laws against environments' impedance, or a parameter's reference."""
        from percept.plots import plot_band

        band = record(Band, self.band)
        data = data_of(self.sessions, self.scene)
        return plot_band(band, data, parameter, family=self.scene.inference.family, ax=ax)

    def plot_coupling(self, *, ax: Any = None) -> Any:
        """Plot the paper's criterion for the coupling (Eq. 10) over omega, rad/s."""
        from percept.plots import plot_coupling

        return plot_coupling(self.coupling, ax=ax)

    def plot_check(self, *, ax: Any = None) -> Any:
        """Plot how far each subject lies from what the others predict.

        In a model that holds, the probabilities of lying as far off are uniform. The shaded band
        holds each ordered probability of independent subjects with probability 0.99.
        """
        from percept.plots import plot_check

        checks = self.parts.checks
        loo = None if checks is None else checks.loo
        return plot_check(None if loo is None else loo.subjects, ax=ax)

    def __repr__(self) -> str:
        adjusted = " and ".join(self.sessions.parameters)
        where = counted(len(self.sessions.environments), "environment")
        return f"<Study of {adjusted} in {where}, {self.sessions.form}>"

    def _repr_html_(self) -> str:
        """Return a card: what the study is, has computed, and what to call; computes nothing."""
        sessions = self.sessions
        asked = self.scene.inference
        computed = [word for name, word in _KEPT.items() if name in vars(self.parts)]
        about = {
            "quantities": ", ".join(
                sessions.quantities[name].words for name in sessions.parameters
            ),
            "environments": len(sessions.environments),
            "subjects": len(sessions.subjects) or "published limits",
            "method": f"{asked.method}, {asked.family}, level {asked.level:g}",
            "device": "none" if self.scene.device is None else "yes",
            "coupling": "none" if self.scene.coupling is None else "yes",
            "computed": ", ".join(computed) or "nothing yet",
        }
        calls = "".join(
            f"<li><code>{html.escape(call)}</code>: {what}</li>" for call, what in _CALLS.items()
        )
        return f"{fields_html(about, caption='Study')}<ul>{calls}</ul>"

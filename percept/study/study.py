"""Study: everything an analysis can give, each part evaluated when it is first asked for."""

from __future__ import annotations

import html
from collections.abc import Callable, Collection
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from percept import haptics
from percept.errors import UsageError, counted
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.chosen import analysed, chosen
from percept.study.frequencies import thinned
from percept.study.placed import placed
from percept.study.responses import references

if TYPE_CHECKING:
    from percept.boundary.band import BandStudy
    from percept.boundary.realism import Realism
    from percept.boundary.records import Boundary
    from percept.inference.sampling.run import Progress
    from percept.study.apparatus import Apparatus
    from percept.study.bayesian import Fit, RunStore
    from percept.study.boundaries import Range
    from percept.study.coupling import CouplingStudy
    from percept.study.device_sensitivity import DeviceSensitivity
    from percept.study.model_checks import ModelChecks
    from percept.study.model_choice import ModelChoice
    from percept.study.posterior import Groups
    from percept.study.regions import Draws, Region

Array = NDArray[np.float64]
#: Frequencies of an even grid where the scene leaves their number open.
DEFAULT_POINTS = 241
# Realism starts from these and takes as many more as it needs.
_REALISM_POINTS = 80


class Study:
    """An analysis of sessions under a scene.

    Nothing is computed before it is asked for; what the scene does not need is never computed, and
    `skipped` says why.

    Parameters
    ----------
    sessions : Sessions
        What the reader gave.
    scene : Scene, optional
        What to analyse; defaults throughout.
    progress : callable, optional
        Told the state of the sampler after every round.
    store : RunStore, optional
        Where finished runs of the sampler are kept, such as `percept.cache.PosteriorCache`; none by default.

    Raises
    ------
    UsageError
        Anything but Sessions.
    RefusalError
        From the properties, where the data cannot carry the analysis.
    """

    def __init__(
        self,
        sessions: Sessions,
        scene: Scene | None = None,
        *,
        progress: Callable[[Progress], None] | None = None,
        store: RunStore | None = None,
    ) -> None:
        if not isinstance(sessions, Sessions):
            raise UsageError(
                f"a study is of Sessions, not of {type(sessions).__name__}.",
                hint="read_sessions reads files, Sessions.from_frame takes a DataFrame.",
            )
        self.sessions = sessions
        self.scene = scene or Scene()
        self._progress = progress
        self._store = store

    def over(self, sessions: Sessions) -> Study:
        """Analyse other sessions under the same scene with the same progress and store."""
        return Study(sessions, self.scene, progress=self._progress, store=self._store)

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Parameters analysed: those the scene names, or all that were adjusted."""
        return analysed(self.sessions.parameters, self.scene)

    @property
    def environments(self) -> tuple[str, ...]:
        """Environments, in order of first appearance."""
        return self.sessions.environments

    @cached_property
    def reference(self) -> dict[tuple[str, str], float]:
        """Reference per (parameter, environment), N/m or N·s/m."""
        values = references(self.sessions, self.parameters, self.environments)
        return {
            (p, e): float(values[i, j])
            for i, p in enumerate(self.parameters)
            for j, e in enumerate(self.environments)
        }

    @property
    def intervals(self) -> pd.DataFrame:
        """Intervals of every method, kind and family, one row each, in N/m and N·s/m; a copy."""
        return self._intervals.copy()

    @cached_property
    def _intervals(self) -> pd.DataFrame:
        from percept.study.interval_table import interval_table

        return interval_table(self)

    @cached_property
    def fit(self) -> Fit | None:
        """The sampled hierarchical model; None where only the classical method is asked for."""
        if self.scene.inference.method == "classical":
            return None
        from percept.study.bayesian import fit, prepare

        prepared = prepare(self.sessions, self.scene, self.parameters)
        return fit(prepared, self.scene, progress=self._progress, store=self._store)

    @cached_property
    def posterior_groups(self) -> Groups | None:
        """Posterior as named arrays, draws thinned to the effective size; None without a passed fit."""
        if self.fit is None or not self.fit.run.gate.passed:
            return None
        from percept.study.posterior import full_groups, posterior_groups, subject_density

        full = self.scene.checks is not None and subject_density(self.fit) is not None
        return (full_groups if full else posterior_groups)(self.fit, seed=self.scene.inference.seed)

    @cached_property
    def posterior(self) -> Any:
        """Posterior as an ArviZ DataTree, draws thinned to the effective size; None without a passed fit."""
        if self.posterior_groups is None:
            return None
        from percept.study.posterior import data_tree

        return data_tree(self.posterior_groups)

    @cached_property
    def checks(self) -> ModelChecks | None:
        """Checks of the hierarchical model; None without a passed fit that pools sessions."""
        if self.fit is None or not self.fit.run.gate.passed:
            return None
        from percept.study.model_checks import model_checks

        return model_checks(self.fit, self.scene, progress=self._progress)

    @cached_property
    def model_choice(self) -> ModelChoice:
        """Smaller models against the full one, by leave-one-subject-out; samples each of them."""
        from percept.study.model_choice import compare_models

        return compare_models(
            self.sessions,
            self.scene,
            self.parameters,
            progress=self._progress,
            store=self._store,
        )

    @property
    def diagnostics(self) -> dict[str, Any] | None:
        """Verdict of the gate, what it rests on, and the priors in force; None without a fit."""
        if self.fit is None:
            return None
        from percept.study.diagnostics import diagnostics

        return diagnostics(self.fit)

    @cached_property
    def device(self) -> haptics.AnyDevice | None:
        """The scene's device; None without one."""
        from percept.study.apparatus import device_of

        return device_of(self.scene)

    @cached_property
    def coupling_element(self) -> haptics.Coupling | None:
        """The scene's virtual coupling; None without one."""
        from percept.study.apparatus import coupling_of

        return coupling_of(self.scene)

    @cached_property
    def omega(self) -> Array:
        """Even grid of the scene's frequencies, rad/s: as many as it says, or `DEFAULT_POINTS`."""
        table = self.scene.frequency
        return np.geomspace(table.lower, table.upper, table.points or DEFAULT_POINTS)

    @cached_property
    def frequencies(self) -> Range:
        """Where boundaries are drawn: on the scene's own grid, or at as many points as the curves need."""
        from percept.study.boundaries import Range

        table = self.scene.frequency
        return Range(table.lower, table.upper, self.omega if table.points else None)

    @cached_property
    def placed(self) -> tuple[str, ...]:
        """Environments with a reference of every parameter, which curves and bands are drawn for."""
        return placed(self.reference, self.parameters, self.environments)

    @cached_property
    def boundaries(self) -> tuple[Boundary, ...]:
        """Boundaries of abs(Z_h) over the scene's frequencies; empty without a device or one parameter."""
        from percept.study.boundaries import JOINTS

        return self._boundaries(self.frequencies, self.placed, self.scene.inference.kinds, JOINTS)

    def boundaries_at(
        self,
        omega: ArrayLike,
        environments: Collection[str] | None = None,
        *,
        kinds: Collection[str] | None = None,
        joints: Collection[str] | None = None,
    ) -> tuple[Boundary, ...]:
        """Boundaries at frequencies of one's own.

        Parameters
        ----------
        omega : array_like, shape (M,)
            rad/s, positive, increasing, up to Nyquist, where a mass is endless, and so are all curves.
        environments : collection of str, optional
            Which environments; all by default.
        kinds, joints : collection of str, optional
            Of which kinds, and with which treatment of k and b together ("joint" for curves through draws);
            all by default.

        Returns
        -------
        tuple of Boundary

        Raises
        ------
        UsageError
            Frequencies that are none, not positive or do not increase; an environment, kind or treatment that
            the study does not have.
        """
        from percept.study.boundaries import JOINTS, Range

        return self._boundaries(
            Range.of(omega),
            chosen("environment", environments, self.placed),
            chosen("kind", kinds, self.scene.inference.kinds),
            chosen("joint treatment", joints, JOINTS),
        )

    def _boundaries(
        self,
        frequencies: Range,
        environments: Collection[str],
        kinds: Collection[str],
        joints: Collection[str],
    ) -> tuple[Boundary, ...]:
        if self.apparatus is None:
            return ()
        from percept.study.boundaries import boundaries_of

        regions = [one for one in self.regions if one.kind in kinds and one.joint in joints]
        draws = [one for one in self.curve_draws if one.kind in kinds and "joint" in joints]
        return boundaries_of(self.apparatus, environments, regions, draws, frequencies)

    @cached_property
    def apparatus(self) -> Apparatus | None:
        """Device and references that curves are drawn for; None without a device or with one parameter."""
        if self.parameters != ("k", "b"):
            return None
        return self._apparatus(
            {
                e: haptics.Environment(stiffness=self.reference["k", e], damping=self.reference["b", e])
                for e in self.placed
            }
        )

    def _apparatus(self, references: dict[str, haptics.Environment]) -> Apparatus | None:
        table = self.scene.device
        if table is None or self.device is None:
            return None
        from percept.study.apparatus import Apparatus

        return Apparatus(self.device, table.period, table.hold, references, self.coupling_element)

    @cached_property
    def regions(self) -> tuple[Region, ...]:
        """Rectangles and ellipses of (k, b) of every method, kind and joint treatment."""
        if self.parameters != ("k", "b"):
            return ()
        from percept.study.both_methods import study_regions

        return study_regions(self)

    @cached_property
    def curve_draws(self) -> tuple[Draws, ...]:
        """Draws of (k, b) of the average and the next user, by method and family.

        Empty for published limits and models without a correlation of k and b: none is invented.
        """
        if self.parameters != ("k", "b") or self.sessions.form == "summary":
            return ()
        from percept.study.both_methods import study_draws

        return study_draws(self)

    @cached_property
    def band(self) -> BandStudy | None:
        """Band of the environment's own impedance and its law; None with one parameter or environment."""
        if self.parameters != ("k", "b") or len(self.environments) < 2:
            return None
        from percept.study.both_methods import study_bands

        return study_bands(self, self.scene.frequency.read_at)

    @cached_property
    def coupling(self) -> CouplingStudy | None:
        """Stability and realism of the coupling; None without a device and a coupling."""
        apparatus = self.apparatus or self._apparatus({})
        if apparatus is None or apparatus.coupling is None:
            return None
        from percept.study.coupling import study_coupling

        return study_coupling(
            apparatus,
            self.boundaries,
            self.regions,
            ((e, coupled, found) for (e, coupled), found in self.realism.items()),
            read_at=self.scene.frequency.read_at,
        )

    @property
    def passivity(self) -> pd.DataFrame | None:
        """Whether each reference, rendered without the coupling, is passive; None without a device."""
        if self.apparatus is None:
            return None
        from percept.study.passivity import direct_passivity

        return direct_passivity(self.apparatus)

    @cached_property
    def realism(self) -> dict[tuple[str, bool], Realism]:
        """Probability that each reference feels real, without and through the coupling (True).

        Empty without a device, a passed fit, or both parameters.
        """
        fit = self.fit
        if self.apparatus is None or fit is None or not fit.run.gate.passed:
            return {}
        from percept.study.realism import study_realism

        omega = thinned(self.omega, _REALISM_POINTS)
        return {
            (e, coupled): found for e, coupled, found in study_realism(self.apparatus, fit, self.scene, omega)
        }

    @cached_property
    def coupling_design(self) -> dict[str, haptics.CouplingDesign]:
        """Couplings, by method, that are stable and realistic to the next user: for each environment and all.

        Judged by the envelope of kind user in the scene's family; empty without a device or both parameters.
        """
        if self.apparatus is None:
            return {}
        from percept.study.coupling_design import design_by_method

        return design_by_method(self.apparatus, self.regions, self.scene.inference.family, self.omega)

    @cached_property
    def sensitivity(self) -> DeviceSensitivity | None:
        """How the verdicts move with the device's mass and damping; None without a device that has them."""
        from percept.study.device_sensitivity import device_sensitivity

        return device_sensitivity(self)

    @property
    def comparison(self) -> pd.DataFrame | None:
        """The methods' intervals in equal family and kind, with reasons; a copy, None with one method."""
        return None if self._comparison is None else self._comparison.copy()

    @cached_property
    def _comparison(self) -> pd.DataFrame | None:
        if self.fit is None or self.scene.inference.method != "both" or not self.fit.run.gate.passed:
            return None
        from percept.study.comparison import compare_intervals, sample_sds

        sds = sample_sds(self.sessions, self.parameters, self.scene.inference.family)
        return compare_intervals(self.intervals, self.fit, self.scene, sds)

    @property
    def curve_comparison(self) -> pd.DataFrame:
        """Both methods' boundaries in equal environment, kind, family, joint treatment and shape; a copy."""
        return self._curve_comparison.copy()

    @cached_property
    def _curve_comparison(self) -> pd.DataFrame:
        from percept.study.comparison import compare_curves

        return compare_curves(self.boundaries)

    @cached_property
    def skipped(self) -> tuple[tuple[str, str], ...]:
        """What was not computed, and why."""
        from percept.study.skipped import skipped

        return tuple(skipped(self))

    def __repr__(self) -> str:
        adjusted = " and ".join(self.sessions.parameters)
        return (
            f"<Study of {adjusted} in {counted(len(self.environments), 'environment')}, {self.sessions.form}>"
        )

    def _repr_html_(self) -> str:
        shown = self.intervals.drop(columns="covers").to_html(index=False, escape=True, na_rep="–")
        skipped = "".join(f"<li>{html.escape(what)}: {html.escape(why)}</li>" for what, why in self.skipped)
        return f"{shown}<p>Skipped:</p><ul>{skipped}</ul>"

"""The psychophysics table, and whether biases are smaller than one JND; by both methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from percept.results import EquivalenceRow, PseLineRow, PsychophysicsRow
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.basics import References, Skipped
from percept.study.intervals import Cell
from percept.study.psychophysics.classical import absent_jnds, classical_psychophysics
from percept.study.psychophysics.equivalence import classical_equivalence

if TYPE_CHECKING:
    from percept.study.fit import Fit

__all__ = ["Psychophysics"]


@dataclass(frozen=True, eq=False)
class Psychophysics:
    """What psychophysics asks of a study, each part computed when it is first read."""

    sessions: Sessions
    scene: Scene
    cells: Sequence[Cell]  # Of the scene's family
    reference: References
    fit: Fit | None  # None unless it passed

    @cached_property
    def rows(self) -> tuple[PsychophysicsRow, ...]:
        """Points of equality, thresholds, spreads and reliability, in the scene's family."""
        whole = self.sessions, self.scene
        rows: list[PsychophysicsRow] = []
        if self.scene.inference.method != "bayesian":
            rows += classical_psychophysics(*whole, self.cells, self.reference)
        if self.fit is not None:
            # The classical method does without the model.
            from percept.study.psychophysics.posterior import posterior_psychophysics

            rows += posterior_psychophysics(self.fit, *whole, self.reference)
        return tuple(rows)

    @cached_property
    def lines(self) -> list[PseLineRow | Skipped]:
        """Points of equality over the reference, or why not; empty without the model."""
        if self.fit is None:
            return []
        from percept.study.psychophysics.lines import posterior_lines

        return list(posterior_lines(self.fit, self.scene, self.reference))

    @cached_property
    def equivalence(self) -> list[EquivalenceRow | Skipped]:
        """Whether biases are smaller than one JND, or why not told; empty without a JND."""
        rows: list[EquivalenceRow | Skipped] = []
        quantities = self.sessions.options.quantities.values()
        if not self.scene.study.jnd or not any(quantity.is_matched for quantity in quantities):
            return rows
        if self.scene.inference.method != "bayesian":
            rows += classical_equivalence(self.scene, self.cells, self.reference)
        if self.fit is not None:
            from percept.study.psychophysics.posterior_equivalence import posterior_equivalence

            rows += posterior_equivalence(self.fit, self.scene, self.reference)
        return rows

    @cached_property
    def skipped(self) -> list[Skipped]:
        """JNDs, lines and verdicts that there are none of, with the reason."""
        parameters = dict.fromkeys(cell.parameter for cell in self.cells)
        skipped = list(absent_jnds(self.sessions, self.scene, list(parameters)))
        for part in (*self.lines, *self.equivalence):
            if isinstance(part, Skipped):
                skipped.append(part)
        return skipped

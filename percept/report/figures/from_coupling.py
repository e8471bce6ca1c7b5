"""The figures of the coupling that a document gives."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from percept.errors import counted
from percept.report.figures.canvas import Drawing, Figure, grid, legend_below, panels, row_labels
from percept.report.figures.design import draw_design
from percept.report.figures.stability import draw_stability
from percept.report.select import METHOD_NAMES, METHODS, array

_LABEL = "this coupling"
_COLUMNS = 3
_TITLE_WIDTH = 38.0  # mm


def coupling_drawings(document: Mapping[str, Any]) -> list[Drawing]:
    """Return the stability criterion over ω (Fig. 4), and the map of couplings that qualify."""
    found = []
    if document["coupling"] and document["coupling"].get("bound"):
        found.append(
            Drawing(
                "stability",
                "Stability of the coupling over the angular frequency",
                "Re 1/Z_c of the coupling and the lower bound it has to stay above (Eq. 10).",
                (120.0, 80.0),
                partial(_draw_stability, document["coupling"]),
            )
        )
    if document["design"]:
        design = document["design"]
        (chosen, *_) = sorted(design["maps"], key=lambda one: METHODS.index(one["method"]), reverse=True)
        rows = -(-len(chosen["environments"]) // _COLUMNS)
        found.append(
            Drawing(
                "design",
                "Couplings that qualify, by environment",
                "Shaded: stable with this device, and inside the next user's boundary "
                f"({METHOD_NAMES[chosen['method']]}, {design['family']}, envelope), checked at "
                f"{counted(design['frequencies'], 'frequency', 'frequencies')} only."
                f"{_marks(bool(design['stable']), bool(document['provenance']['scene'].get('coupling')))}",
                (175.0, 16.0 + 52.0 * rows),
                partial(
                    _draw_design, design["stable"], chosen, document["provenance"]["scene"].get("coupling")
                ),
            )
        )
    return found


def _marks(edge: bool, used: bool) -> str:
    """Say what the line and the cross are, of those there are."""
    said = ["the line is the edge of what is stable"] * edge + ["the cross is the coupling in use"] * used
    text = ", ".join(said)
    return f" {text[0].upper()}{text[1:]}." if said else ""


def _draw_stability(coupling: Mapping[str, Any], figure: Figure) -> None:
    (ax,) = panels(figure, left=18, top=3)
    omega, binding = array(coupling["omega"]), coupling["binding_omega"]
    inside = binding is not None and omega[0] <= float(binding) <= omega[-1]
    draw_stability(
        ax,
        omega,
        array(coupling["bound"]),
        {_LABEL: array(coupling["admittance"])},
        binding={_LABEL: float(binding)} if inside else None,
    )


def _draw_design(
    edge: Mapping[str, Any] | None, chosen: Mapping[str, Any], used: Mapping[str, Any] | None, figure: Figure
) -> None:
    environments = chosen["environments"]
    axes = grid(figure, len(environments), columns=_COLUMNS, bottom=17)
    titles, _ = row_labels([one["name"] or "all together" for one in environments], most=_TITLE_WIDTH)
    for ax, one, title in zip(axes, environments, titles, strict=True):
        draw_design(
            ax,
            array(chosen["damping"]),
            [np.array(part, dtype=float).reshape(-1, 2) for part in one["intervals"]],
            stable=(array(edge["stiffness"]), array(edge["damping"])) if edge else None,
            coupling=(used["stiffness"], used["damping"]) if used else None,
        )
        ax.set_title(title, loc="left")
    for ax in axes[::_COLUMNS]:
        ax.set_ylabel("coupling damping (N·s/m)")
    richest = max(axes, key=lambda ax: len(ax.get_legend_handles_labels()[0]))
    legend_below(richest, columns=3)

"""The figures of the coupling that a document gives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from percept.report.figures.canvas import Drawing, panels
from percept.report.figures.stability import draw_stability
from percept.report.select import array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["coupling_drawings"]


def coupling_drawings(document: Mapping[str, Any]) -> list[Drawing]:
    """Return the stability criterion over ω (Fig. 4).

    Parameters
    ----------
    document : mapping

    Returns
    -------
    list of Drawing
        Empty where there is no coupling.
    """
    coupling = document["coupling"]
    if not coupling:
        return []

    def draw(figure: Figure) -> None:
        (ax,) = panels(figure, left=18, top=3)
        curve = array(coupling["admittance"])
        binding = coupling["binding_omega"]
        inside = coupling["omega"][0] <= binding <= coupling["omega"][-1]
        draw_stability(
            ax,
            array(coupling["omega"]),
            array(coupling["bound"]),
            {"this coupling": curve},
            binding={"this coupling": binding} if inside else None,
        )

    return [
        Drawing(
            "stability",
            "Stability of the coupling over the angular frequency",
            "Re 1/Z_c of the coupling and the lower bound it has to stay above (Eq. 10).",
            (120.0, 80.0),
            draw,
        )
    ]

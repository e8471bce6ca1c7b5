"""`percept zwidth`: the stiffness and damping that a device renders with every passive hand."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from percept.commands import JSON, Command, argument
from percept.commands.analysis import print_json, print_table, show
from percept.errors import RefusalError, UsageError

if TYPE_CHECKING:
    from percept.results import ZWidth


# Of an edge's points, every sixteenth is printed: nine rows.
_STEP = 16


def _zwidth(arguments: argparse.Namespace) -> None:
    """Print the edge and write its figure."""
    from percept.scene import Scene
    from percept.study.device import device_draws, device_of, loop_of
    from percept.study.rendering import z_width

    scene = Scene.load(arguments.scene)
    device = device_of(scene)
    if scene.device is None or device is None:
        hint = "Give its mass, damping and period."
        raise UsageError("there is no [device].", file=arguments.scene, hint=hint)
    width = z_width(loop_of(scene.device, device), {}, device_draws(scene))
    if arguments.json:
        print_json(width)
    else:
        _print(width)
    if arguments.out is not None:
        _draw(width, arguments.out)
        show(str(arguments.out))


def _print(width: ZWidth) -> None:
    """Print the largest stiffness of the edge, and a table of it."""
    edge = width.edge
    if edge is None:
        show(
            "The device's table does not tell: it begins late, or no `response_floor` is stated"
            " for what lies above its end."
        )
        return
    show(
        "With every passive hand, in time, directly or as a coupling with a rigid wall behind it:"
        f"\nup to {edge.stiffest:.6g} N/m (beside {edge.stiffest_damping:.4g} N·s/m), and up to"
        f" {edge.most_damping:.4g} N·s/m."
    )
    rows = {"damping, N·s/m": edge.damping[::_STEP], "stiffness, N/m": edge.stiffness[::_STEP]}
    print_table(rows, digits=6)
    if width.likely is not None:
        show(
            f"95 % of the device's posterior renders up to {width.likely.stiffest:.6g} N/m, and"
            f" up to {width.likely.most_damping:.4g} N·s/m."
        )


def _draw(width: ZWidth, path: Path) -> None:
    """Write the figure as SVG."""
    from percept.report.figures.canvas import drawn
    from percept.report.figures.couplings import stability_drawings

    drawings = stability_drawings(width, None)
    if not drawings:
        raise RefusalError(
            "the device's table does not tell what can be rendered, so there is no figure.",
            hint="State response_floor, or give mass and damping.",
        )
    path.write_bytes(drawn(drawings[0])["svg"])


ZWIDTH = Command(
    "The largest stiffness and damping that a scene's device renders with every passive hand, in"
    " time: of walls, and of couplings with a rigid wall behind them. Needs no sessions.",
    "percept zwidth scene.toml --out zwidth.svg",
    (
        argument("scene", "SCENE", "TOML file with a [device]"),
        argument("--out", "FILE", "figure to write, SVG", type=Path),
        JSON,
    ),
    _zwidth,
)

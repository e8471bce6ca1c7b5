"""`percept zwidth`: the stiffness and damping that a device renders with every passive hand."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from percept.commands import JSON, Command, argument
from percept.commands.analysis import print_json, show
from percept.errors import RefusalError, UsageError

if TYPE_CHECKING:
    from percept.results import ZWidth


# Of an edge's points, every sixteenth is printed: nine rows.
_STEP = 16


def _zwidth(arguments: argparse.Namespace) -> None:
    """Print the edge and write its figure."""
    from percept.results import plain

    width = _width(arguments.scene)
    if arguments.json:
        print_json(plain(width))
    else:
        _print(width)
    if arguments.out is not None:
        _draw(width, arguments.out)
        show(str(arguments.out))


def _width(path: str) -> ZWidth:
    """Compute the Z-width of a scene's device."""
    from percept.scene import Scene
    from percept.study.device import device_draws, device_of, loop_of
    from percept.study.rendering import z_width

    scene = Scene.load(path)
    device = device_of(scene)
    if scene.device is None or device is None:
        raise UsageError(
            "there is no [device].", file=path, hint="Give its mass, damping and period."
        )
    return z_width(loop_of(scene.device, device), {}, device_draws(scene))


def _print(width: ZWidth) -> None:
    """Print the largest stiffness of the edge, and a table of it."""
    edge = width.edge
    if edge is None:
        show(
            "The device's table does not tell: it begins late, or no `response_floor` is stated"
            " for what lies above its end."
        )
        return
    show("With every passive hand, in time, directly or as a coupling with a rigid wall behind it:")
    show(
        f"  up to {edge.stiffest:.6g} N/m (beside {edge.stiffest_damping:.4g} N·s/m), and up to"
        f" {edge.most_damping:.4g} N·s/m."
    )
    show(f"  {'damping, N·s/m':>16}{'stiffness, N/m':>18}")
    for damping, stiffness in zip(edge.damping[::_STEP], edge.stiffness[::_STEP], strict=True):
        show(f"  {damping:>16.4g}{stiffness:>18.6g}")
    if width.likely is not None:
        show(
            f"  95 % of the device's posterior renders up to {width.likely.stiffest:.6g} N/m, and"
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
    files, _ = drawn(drawings[0], ("svg",))
    try:
        path.write_bytes(files["svg"])
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}.", file=str(path)) from error


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

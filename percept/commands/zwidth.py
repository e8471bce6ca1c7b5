"""`percept zwidth`: the largest stiffness and damping that a device renders stably."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from percept.commands import JSON, Command, argument
from percept.commands.analysis import print_json, show
from percept.errors import RefusalError, UsageError

if TYPE_CHECKING:
    from percept.results import RenderedEdge, ZWidth

__all__ = ["ZWIDTH"]

# Of an edge's points, every sixteenth is printed: nine rows.
_STEP = 16
_WAYS = {
    "direct": "Rendered directly, passive with every hand (Colgate and Schenkel)",
    "coupled": "Through a coupling, a rigid wall behind it (Llewellyn)",
}


def _zwidth(arguments: argparse.Namespace) -> None:
    """Print both edges and write their figure."""
    from percept.results.plain import plain

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
    from percept.study.device import device_of, loop_of
    from percept.study.device_draws import device_draws
    from percept.study.zwidth import z_width

    scene = Scene.load(path)
    device = device_of(scene)
    if scene.device is None or device is None:
        raise UsageError(
            "there is no [device].", file=path, hint="Give its mass, damping and period."
        )
    loop = loop_of(scene.device)
    return z_width(device, scene.device.period, loop, {}, device_draws(scene))


def _print(width: ZWidth) -> None:
    """Print the largest stiffness of each edge, and a table of it."""
    for way, title in _WAYS.items():
        edge: RenderedEdge | None = getattr(width, way)
        if edge is None:
            show(f"{title}: the device's table does not tell.")
            continue
        show(f"{title}:")
        show(
            f"  up to {edge.stiffest:.6g} N/m (beside {edge.stiffest_damping:.4g} N·s/m), and up to"
            f" {edge.most_damping:.4g} N·s/m."
        )
        show(f"  {'damping, N·s/m':>16}{'stiffness, N/m':>18}")
        for damping, stiffness in zip(edge.damping[::_STEP], edge.stiffness[::_STEP], strict=True):
            show(f"  {damping:>16.4g}{stiffness:>18.6g}")
        likely: RenderedEdge | None = getattr(width, f"likely_{way}")
        if likely is not None:
            show(
                f"  95 % of the device's posterior renders up to {likely.stiffest:.6g} N/m, and up"
                f" to {likely.most_damping:.4g} N·s/m."
            )


def _draw(width: ZWidth, path: Path) -> None:
    """Write the figure as SVG."""
    from percept.report.figures.output import drawn
    from percept.report.figures.zwidth import zwidth_drawings

    drawings = zwidth_drawings(width)
    if not drawings:
        raise RefusalError(
            "there is no figure of a device known by a table.",
            hint="Leave out --out, or give mass and damping.",
        )
    files, _ = drawn(drawings[0], ("svg",))
    try:
        path.write_bytes(files["svg"])
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}.", file=str(path)) from error


ZWIDTH = Command(
    "The largest stiffness and damping that a scene's device renders stably with every passive"
    " hand: directly, and through a coupling. Needs no sessions.",
    "percept zwidth scene.toml --out zwidth.svg",
    (
        argument("scene", "SCENE", "TOML file with a [device]"),
        argument("--out", "FILE", "figure to write, SVG", type=Path),
        JSON,
    ),
    _zwidth,
)

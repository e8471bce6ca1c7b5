"""`percept identify`: a device from a log of force and motion."""

from __future__ import annotations

import argparse
import hashlib
import math
from pathlib import Path
from typing import TYPE_CHECKING

from percept.commands import JSON, QUIET, Command, argument, flag, number
from percept.commands.analysis import Working, notice, print_json, show
from percept.commands.mapping import write_new
from percept.errors import UsageError

if TYPE_CHECKING:
    from percept.identify.result import Identified, Request

__all__ = ["IDENTIFY"]

#: Digits of a digest that name a file.
_DIGEST = 16
#: What --json prints of an `Identified`.
_PRINTED = ("estimates", "covariance", "fits", "misfit", "repeats", "effective_draws", "rhat")


def _request(arguments: argparse.Namespace) -> Request:
    from percept.identify.model import Terms
    from percept.identify.result import Request

    terms = Terms(arguments.modes, arguments.spring, arguments.delay, arguments.friction)
    return Request(
        terms=terms,
        repeat=arguments.repeat,
        segment=arguments.segment,
        averages=arguments.averages,
        band=(arguments.lowest, arguments.highest),
        seed=arguments.seed,
    )


def _identify(arguments: argparse.Namespace) -> None:
    """Identify; write the page, then the device, which is refused where the log does not tell it.

    Prints the parameters.
    """
    from percept.identify.device_table import device_toml
    from percept.identify.log import read_log
    from percept.identify.page import render_identified
    from percept.identify.result import identify
    from percept.identify.spectra import TimeLog
    from percept.provenance import made_by

    log = read_log(arguments.log, arguments.quantity)
    period = arguments.period
    if period is None:
        if not isinstance(log, TimeLog):
            raise UsageError("A response does not tell the sampling period.", hint="Give --period.")
        period = log.step
    with Working("identifying the device", shown=not arguments.quiet):
        found = identify(log, _request(arguments))
        name = Path(arguments.log).name
        made = made_by(arguments.typed, ("numpy", "scipy", "emcee"))
        page = Path(arguments.out).with_suffix(".html")
        write_new(str(page), render_identified(found, name, made))
    if not found.fits and not arguments.quiet:
        notice(
            f"the device does not explain the log: its misfit is {found.misfit:.3g}, and noise"
            " alone leaves 1. Its intervals are too narrow. Try --modes, --spring, --delay or"
            " --friction."
        )
    if arguments.json:
        print_json({name: getattr(found, name) for name in _PRINTED})
    else:
        show(_table(found))
    digest = hashlib.sha256(Path(arguments.log).read_bytes()).hexdigest()[:_DIGEST]
    source = f"{arguments.typed}; {name} has sha256 {digest}; percept {made.versions['percept']}"
    write_new(arguments.out, device_toml(found, period, source))
    if not arguments.json:
        show(f"{arguments.out}\n{page}")


def _table(found: Identified) -> str:
    """Write the parameters, a line each."""
    lines = []
    for estimate in found.estimates:
        line = f"{estimate.name:<18}not identifiable: {estimate.not_identifiable}"
        if estimate.value is not None:
            limits = f"{estimate.lower:.5g} to {estimate.upper:.5g}"
            line = f"{estimate.name:<18}{estimate.value:.5g} {estimate.unit} (95 %: {limits})"
        lines.append(line)
    return "\n".join(lines)


IDENTIFY = Command(
    "Estimate mass, damping and more of a device from a log of force and motion, and write them as"
    " the [device] of a scene, with their uncertainty and a page.",
    "percept identify log.csv --repeat 1.024 --modes 1 --out device.toml",
    (
        argument("log", "LOG", "CSV: time, force, velocity or position; or a frequency response"),
        argument("--out", "FILE", "TOML file to write, with a page beside it", required=True),
        number("--repeat", "S", "period of the excitation, s; without it the log is segmented"),
        number("--segment", "S", "length of a segment, s (a sixteenth of the log)"),
        number("--averages", "N", "averages behind a response and its coherence"),
        argument(
            "--quantity",
            None,
            "what a response is (impedance)",
            default="impedance",
            choices=(
                "impedance",
                "mobility",
                "dynamic stiffness",
                "receptance",
                "apparent mass",
                "accelerance",
            ),
        ),
        number("--modes", "N", "flexible modes (0)", default=0),
        flag("--spring", "with a spring to ground"),
        flag("--delay", "with a delay of the log's force"),
        flag("--friction", "with Coulomb friction"),
        number("--lowest", "W", "lowest frequency used, rad/s (0)", default=0.0),
        number("--highest", "W", "highest frequency used, rad/s (inf)", default=math.inf),
        number("--period", "S", "sampling period of the control loop, s (the log's step)"),
        number("--seed", "N", "seed of the sampler (1)", default=1),
        JSON,
        QUIET,
    ),
    _identify,
)

"""Predict intervals and the boundary of an environment nobody tested, or test how well that goes."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from percept.commands.analysis import add_analysis_arguments, open_study, tell_error
from percept.commands.progress import Working

if TYPE_CHECKING:
    from percept.study import Study

EXAMPLE = "percept predict sessions.csv --k 15000 --b 12 --scene scene.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_analysis_arguments(parser)
    parser.add_argument("--k", type=float, metavar="N/m", help="stiffness of the untested environment")
    parser.add_argument("--b", type=float, metavar="N·s/m", help="damping of the untested environment")
    parser.add_argument(
        "--leave-one-out",
        action="store_true",
        help="instead predict each tested environment from the others, and compare",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        help="with --leave-one-out: write leave_one_out.json and leave_one_out.md there",
    )
    parser.add_argument("--json", action="store_true", help="print as JSON, with the boundaries")


def run(arguments: argparse.Namespace) -> int:
    """Print how far the environment lies from the tested ones, its intervals, and what was left out."""
    from percept.errors import UsageError
    from percept.report.plain import dumps, plain
    from percept.study.prediction import predict

    if arguments.leave_one_out and (arguments.k is not None or arguments.b is not None):
        raise UsageError("--leave-one-out predicts the tested environments; --k and --b name another.")
    if arguments.out and not arguments.leave_one_out:
        raise UsageError("--out goes with --leave-one-out.")
    with Working("predicting", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        if arguments.leave_one_out:
            return _left_out(study, arguments)
        found = predict(study, stiffness=arguments.k, damping=arguments.b)
    tell_error(study)
    if arguments.json:
        said = {"sentence": found.sentence, "extrapolates": found.extrapolates}
        print(dumps({**said, **plain(found)}), end="")
        return 0
    print(found.sentence)
    columns = ["parameter", "reference", "kind", "lower", "upper", "estimate", "unit", "monte_carlo"]
    print(found.intervals[columns].to_string(index=False, float_format="{:.6g}".format))
    for row in found.intervals.drop_duplicates("kind").to_dict("records"):
        print(f"{row['kind']}: {row['covers'].replace(', in ' + row['unit'], '')}")
    worst, asked = float(found.intervals["monte_carlo"].max()), study.scene.inference.tolerance
    if worst > asked:
        print(
            f"percept: these limits have Monte Carlo errors of up to {worst:.2%} of a half-width, more than "
            f"the {asked:.2%} that the fit was asked for: ask for a smaller tolerance.",
            file=sys.stderr,
        )
    if found.boundaries:
        print(f"{len(found.boundaries)} boundaries of abs(Z_h) were drawn too: see --json.")
    return 0


def _left_out(study: Study, arguments: argparse.Namespace) -> int:
    from percept.files import filled_folder
    from percept.report.left_out import left_out_document, left_out_markdown
    from percept.report.plain import dumps
    from percept.study.left_out import leave_one_environment_out

    document = left_out_document(study, leave_one_environment_out(study))
    if arguments.out:
        page = "leave_one_out.md"
        with filled_folder(arguments.out, last=page) as folder:
            (folder / "leave_one_out.json").write_text(dumps(document), encoding="utf-8")
            (folder / page).write_text(left_out_markdown(document), encoding="utf-8")
        print(Path(arguments.out) / page)
    else:
        print(dumps(document) if arguments.json else left_out_markdown(document), end="")
    return 0

"""`percept predict`: an environment nobody tested."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from percept.commands import Command
from percept.commands.analysis import (
    Working,
    add_analysis_arguments,
    in_words_of,
    open_study,
    print_json,
    tell_error,
)
from percept.errors import UsageError

if TYPE_CHECKING:
    from percept.study import Study

_COLUMNS = ["parameter", "reference", "kind", "lower", "upper", "estimate", "unit", "monte_carlo"]


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    add_analysis_arguments(parser)
    parser.add_argument("--k", type=float, metavar="N/m", help="stiffness of the untested environment")
    parser.add_argument("--b", type=float, metavar="N·s/m", help="damping of the untested environment")
    parser.add_argument(
        "--at", nargs="+", default=[], metavar="NAME=X", help="references of other quantities, in their units"
    )
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


def _run(arguments: argparse.Namespace) -> None:
    """Print how far the environment lies from the tested ones, its intervals, and what was left out."""
    from percept.report.plain import plain
    from percept.study.prediction import predict

    if arguments.leave_one_out and (arguments.k is not None or arguments.b is not None or arguments.at):
        raise UsageError("--leave-one-out predicts the tested environments; --k and --b name another.")
    if arguments.out and not arguments.leave_one_out:
        raise UsageError("--out goes with --leave-one-out.")
    with Working("predicting", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        if arguments.leave_one_out:
            _left_out(study, arguments, progress)
            return
        prediction = predict(
            study, stiffness=arguments.k, damping=arguments.b, at=references_of(arguments.at)
        )
    tell_error(study)
    if arguments.json:
        said = {"sentence": prediction.sentence, "extrapolates": prediction.extrapolates}
        print_json({**said, **plain(prediction)})
        return
    say = in_words_of(study.scene)
    print(say(prediction.sentence))
    print(prediction.intervals[_COLUMNS].to_string(index=False, float_format="{:.6g}".format))
    for row in prediction.intervals.drop_duplicates("kind").to_dict("records"):
        print(say(f"{row['kind']}: {row['covers'].replace(', in ' + row['unit'], '')}"))
    worst, asked = float(prediction.intervals["monte_carlo"].max()), study.scene.inference.tolerance
    if worst > asked:
        print(
            f"percept: these limits have Monte Carlo errors of up to {worst:.2%} of a half-width, more than "
            f"the fit's {asked:.2%}. Ask for a smaller tolerance.",
            file=sys.stderr,
        )
    if prediction.boundaries:
        print(f"{len(prediction.boundaries)} boundaries of abs(Z_h) were drawn too: see --json.")


def references_of(texts: Sequence[str]) -> dict[str, float]:
    """Read references such as "duration=500"."""
    found = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            found[name] = float(number)
        except ValueError:
            raise UsageError(
                "a reference is written NAME=X, as in duration=500.", key="at", value=text
            ) from None
    return found


def _left_out(study: Study, arguments: argparse.Namespace, progress: Working) -> None:
    from percept.files import filled_folder
    from percept.provenance import made_by
    from percept.report.plain import dumps
    from percept.report.tables import left_out_document, left_out_markdown
    from percept.study.prediction import leave_one_environment_out

    document = left_out_document(study, leave_one_environment_out(study))
    progress.stop()
    page = f"{left_out_markdown(document)}\n{made_by(arguments.typed).sentence}\n"
    texts = {"leave_one_out.json": dumps(document), "leave_one_out.md": page}
    if not arguments.out:
        print(texts["leave_one_out.json" if arguments.json else "leave_one_out.md"], end="")
        return
    with filled_folder(arguments.out, last="leave_one_out.md") as folder:
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
    print(Path(arguments.out) / "leave_one_out.md")


PREDICT = Command(
    "Predict intervals and the boundary of an environment nobody tested, or test how well that goes.",
    "percept predict sessions.csv --k 15000 --b 12 --scene scene.toml",
    _add_arguments,
    _run,
)

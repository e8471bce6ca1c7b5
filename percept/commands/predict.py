"""`percept predict`: an environment nobody tested."""

from __future__ import annotations

import argparse
import sys

from percept.commands import JSON, Command, argument, number
from percept.commands.analysis import (
    STUDY,
    Working,
    in_words_of,
    open_study,
    print_json,
    show,
    tell_error,
)

_COLUMNS = ["parameter", "reference", "kind", "lower", "upper", "estimate", "unit", "monte_carlo"]


def _run(arguments: argparse.Namespace) -> None:
    """Print how far the environment lies from the tested ones, its intervals, and what was left out."""
    from percept.results.plain import plain
    from percept.study.prediction import predict

    with Working("predicting", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
        at = dict(arguments.at)
        prediction = predict(study, stiffness=arguments.k, damping=arguments.b, at=at)
    tell_error(study)
    if arguments.json:
        said = {"sentence": prediction.sentence, "extrapolates": prediction.extrapolates}
        print_json({**said, **plain(prediction)})
        return
    say = in_words_of(study.scene)
    print(say(prediction.sentence))
    show(prediction.intervals[_COLUMNS].to_string(index=False, float_format="{:.6g}".format))
    for row in prediction.intervals.drop_duplicates("kind").to_dict("records"):
        print(say(f"{row['kind']}: {row['covers'].replace(', in ' + row['unit'], '')}"))
    worst, asked = float(prediction.intervals["monte_carlo"].max()), study.scene.inference.tolerance
    if worst > asked:
        print(
            f"percept: these limits have Monte Carlo errors of up to {worst:.2%} of a half-width,"
            f" more than the fit's {asked:.2%}. Ask for a smaller tolerance.",
            file=sys.stderr,
        )
    if prediction.boundaries:
        print(f"{len(prediction.boundaries)} boundaries of abs(Z_h) were drawn too: see --json.")


def reference(text: str) -> tuple[str, float]:
    """Read a reference such as "duration=500"."""
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        message = f"{text!r}: a reference is written NAME=X, as in duration=500"
        raise argparse.ArgumentTypeError(message) from None


PREDICT = Command(
    "Predict intervals and the boundary of an environment nobody tested.",
    "percept predict sessions.csv --k 15000 --b 12 --scene scene.toml",
    (
        *STUDY,
        number("--k", "N/m", "stiffness of the untested environment"),
        number("--b", "N·s/m", "damping of the untested environment"),
        argument(
            "--at",
            "NAME=X",
            "other references, in their units",
            type=reference,
            nargs="+",
            default=[],
        ),
        JSON,
    ),
    _run,
)

"""`percept predict`: an environment nobody tested."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from percept.commands import JSON, Command, argument, number
from percept.commands.analysis import (
    STUDY,
    Working,
    in_words_of,
    open_study,
    print_json,
    tell_error,
)
from percept.errors import UsageError

_COLUMNS = ["parameter", "reference", "kind", "lower", "upper", "estimate", "unit", "monte_carlo"]


def _run(arguments: argparse.Namespace) -> None:
    """Print how far the environment lies from the tested ones, its intervals, and what was left out."""
    from percept.report.plain import plain
    from percept.study.prediction import predict

    with Working("predicting", shown=not arguments.quiet) as progress:
        study = open_study(arguments, progress)
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
        name, _, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise UsageError(
                "a reference is written NAME=X, as in duration=500.", key="at", value=text
            ) from None
    return found


PREDICT = Command(
    "Predict intervals and the boundary of an environment nobody tested.",
    "percept predict sessions.csv --k 15000 --b 12 --scene scene.toml",
    (
        *STUDY,
        number("--k", "N/m", "stiffness of the untested environment"),
        number("--b", "N·s/m", "damping of the untested environment"),
        argument("--at", "NAME=X", "references of other quantities, in their units", nargs="+", default=[]),
        JSON,
    ),
    _run,
)

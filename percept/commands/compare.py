"""Compare the two methods on one study, or two studies, groups of subjects or devices."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from percept.commands.analysis import add_analysis_arguments, open_study
from percept.commands.progress import SamplerProgress

if TYPE_CHECKING:
    from percept.study import Study

EXAMPLE = "percept compare study_a.csv study_b.csv --scene scene.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    add_analysis_arguments(parser)
    parser.add_argument(
        "--other-scene", metavar="FILE", help="scene of the second study, such as another device"
    )
    parser.add_argument("--by", metavar="COLUMN", help="compare the first two groups of this column")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print the methods' comparison for one path, the difference of the studies for two."""
    with SamplerProgress(shown=not arguments.quiet) as progress:
        pair = _pair(arguments, progress)
        if pair is None:
            return _methods(open_study(arguments, progress), as_json=arguments.json)
        from percept.study.pairs import compare_studies

        found = compare_studies(*pair)
    if arguments.json:
        _print_json({"intervals": found.intervals, "differences": found.differences, "curves": found.curves})
        return 0
    unit = "ratio B/A" if pair[0].scene.inference.family == "lognormal" else "difference B - A"
    print(f"Average users, {unit}; spread between users, ratio B/A:")
    print(found.differences.to_string(index=False, float_format="{:.6g}".format))
    if len(found.curves):
        worst = found.curves.sort_values("area_upper", ascending=False).head(10)
        print("Boundaries that moved most, log(B/A):")
        print(worst.to_string(index=False, float_format="{:.4g}".format))
    return 0


def _pair(arguments: argparse.Namespace, progress: SamplerProgress) -> tuple[Study, Study] | None:
    from percept.errors import UsageError
    from percept.study import Study
    from percept.study.pairs import split_by

    paths = arguments.sessions
    if arguments.by:
        study = open_study(arguments, progress)
        first, second, *_ = split_by(study.sessions, arguments.by).values()
        return Study(first, study.scene, progress=progress), Study(second, study.scene, progress=progress)
    if len(paths) == 1 and not arguments.other_scene:
        return None
    if len(paths) > 2:
        raise UsageError("compare takes one or two studies; put the files of a study in a folder.")
    scenes = (arguments.scene, arguments.other_scene or arguments.scene)
    both = [
        open_study(argparse.Namespace(**{**vars(arguments), "sessions": [path], "scene": scene}), progress)
        for path, scene in zip((paths[0], paths[-1]), scenes, strict=True)
    ]
    return both[0], both[1]


def _methods(study: Study, *, as_json: bool) -> int:
    from percept.errors import RefusalError

    table = study.comparison
    if table is None:
        why = "; ".join(f"{what}: {reason}" for what, reason in study.skipped)
        raise RefusalError("there is only one method to compare.", hint=why)
    if as_json:
        _print_json({"comparison": table, "curves": study.curve_comparison})
    else:
        print(table.to_string(index=False, float_format="{:.4g}".format))
    return 0


def _print_json(parts: dict[str, Any]) -> None:
    from percept.report.plain import dumps, plain

    print(dumps(plain(parts)), end="")

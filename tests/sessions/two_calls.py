"""Raw public data sets, each in two calls: a scene proposed and filled in, then the page.

The data sets are not part of the repository: FOLDER holds them under the names in `SETS`.

    python -m tests.sessions.two_calls FOLDER --out DIR
"""

import argparse
import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from percept.cli import main
from percept.provenance import made_by


@dataclass(frozen=True)
class Filled:
    """What an analyst writes into the scene that percept proposes."""

    references: dict  # By environment; "*" for all others
    unit: str = ""
    more: str = ""  # A further line of the quantity's table


#: What no file says is made up: the references of reaction times, ratings and scores.
SETS = {
    "michelson.rds": Filled({"*": 734.5}, "km/s"),
    "roomwidth.rds": Filled({"metres": 13.1, "feet": 43.0}),
    "sleepstudy.rds": Filled({"*": 250.0}, "ms"),
    "ergoStool.rds": Filled({"*": 10.0}),
    "Machines.rds": Filled({"*": 60.0}),
    "OBrienKaiser.rds": Filled({"*": 5.0}),
    "MusicTime.csv": Filled({"*": 45.0}, "s"),
    "AudioVisual.csv": Filled({"*": 200.0}, "ms"),
    "tinting.csv": Filled({"*": 50.0}, "ms"),
    "appletaste.csv": Filled({"*": 80.0}),
    "CushnyPeebles.csv": Filled({"*": 2.0}),
    "gravity.csv": Filled({"*": 77.0}),
    "rm_anova_wide.csv": Filled({"*": 4.0}),
    "mixed_anova.csv": Filled({"*": 5.0}),
    "EstimationData": Filled({"*": 50.0}, more="limits = [0.0, 100.0]"),
    "uxf": Filled({"*": 1.0}, "N"),
    "psychopy_adjustment.csv": Filled({}),
    "sleepstudy_eu.csv": Filled({"*": 250.0}, "ms"),
    "sleepstudy.mat": Filled({"*": 250.0}, "ms"),
    "sleepstudy73.mat": Filled({"*": 250.0}, "ms"),
}
REFERENCE = re.compile(r'^# ("(?:[^"\\]|\\.)*") = \{ (\w+)_ref = "\?" \}', re.MULTILINE)


def filled_in(scene, filled):
    """The text of a proposed scene with what the analyst knows."""

    def reference(match):
        value = filled.references.get(json.loads(match[1]), filled.references.get("*"))
        return f"{match[1]} = {{ {match[2]}_ref = {value} }}"

    proposed, mark, template = scene.partition("# Every other key")
    proposed = REFERENCE.sub(reference, proposed.replace("# [environments]", "[environments]"))
    if filled.unit:
        proposed = proposed.replace('unit = ""', f'unit = "{filled.unit}"', 1)
    if filled.more:
        proposed = proposed.replace("\n\n[columns]", f"\n{filled.more}\n\n[columns]", 1)
    return proposed + mark + template


def worst_limit(document):
    """The largest relative difference of a classical limit of the mean or next user to SciPy's."""
    values = {
        (cell["environment"], cell["parameter"]): cell["values"]
        for cell in document["data"]["cells"]
    }
    worst, pairs = 0.0, 0
    for row in document["intervals"]:
        kind = (row["method"], row["family"], row["joint"])
        if kind != ("classical", "normal", "marginal") or row["kind"] == "share":
            continue
        sample = np.array(values[row["environment"], row["parameter"]])
        scale = stats.sem(sample)
        if row["kind"] == "user":
            scale = np.std(sample, ddof=1) * np.sqrt(1 + 1 / len(sample))
        expected = stats.t.interval(row["level"], len(sample) - 1, np.mean(sample), scale)
        off = np.abs(np.array([row["lower"], row["upper"]]) / expected - 1)
        worst, pairs = max(worst, float(off.max())), pairs + 1
    return worst, pairs


def two_calls(data, name, filled, out):
    """A row of the table."""
    folder = out / name.replace(".", "_")
    folder.mkdir(parents=True)
    scene = folder / "scene.toml"
    path = str(data / name)
    if main(["new", str(scene), "--from", path]):
        return f"| `{name}` | refused at the first call | | | |"
    scene.write_text(filled_in(scene.read_text(), filled))
    results = str(folder / "results")
    call = ["report", path, "--scene", str(scene), "--out", results, "--method", "classical"]
    if main(call):
        return f"| `{name}` | refused at the second call | | | |"
    document = json.loads(Path(results, "report.json").read_text())
    worst, pairs = worst_limit(document)
    read = document["data"]
    sizes = f"{read['subjects']} | {len(read['environments'])} | {read['rows']}"
    return f"| `{name}` | {sizes} | {worst:.0e} of {pairs} |"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    table = [
        two_calls(arguments.data, name, filled, arguments.out)
        for name, filled in SETS.items()
        if (arguments.data / name).exists()
    ]
    print("\n".join(table))
    command = "python -m tests.sessions.two_calls FOLDER --out DIR"
    print(made_by(command, ("numpy", "scipy", "pandas")).sentence)

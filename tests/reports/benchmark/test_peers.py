"""Engines, references and times to an error; whole commands in processes of their own."""

import json

import numpy as np
import pytest

from percept.errors import RefusalError
from reports.benchmark.__main__ import main
from reports.benchmark.commands import IMPORTS, command_costs
from reports.benchmark.peers import STUDIES, PeerCost, Reference, study_of, summary, time_to


def test_studies_are_what_their_descriptions_say():
    for name, about in STUDIES.items():
        statistics = study_of(name).trials.statistics
        subjects, environments = len(statistics.subjects), len(statistics.environments)
        assert about.startswith(f"{subjects} subjects, {environments} environments")
        assert statistics.repeats == ("3 trials" in about)
        assert statistics.parameters == (("k",) if "k alone" in about else ("k", "b"))


@pytest.mark.parametrize("sd", [0.1, 0.3])
def test_pooled_runs_are_averaged_and_their_errors_divided(sd):
    rng = np.random.default_rng(5)
    rows = [
        {"value": rng.normal(1.0, sd, (3, 2, 10)), "error": np.full((3, 2, 10), 0.1)}
        for _ in range(25)
    ]
    found = Reference.pooled(rows)
    assert found.error == pytest.approx(np.full((3, 2, 10), 0.02), rel=1e-12)
    # 60 means of 25 runs; 60 · 24 degrees of freedom behind the scatter.
    square = np.mean(((found.value - 1.0) / (sd / 5)) ** 2)
    assert square == pytest.approx(1.0, abs=5 * np.sqrt(2 / 60))
    assert found.scatter == pytest.approx(sd / 0.1, rel=5 * np.sqrt(0.5 / (60 * 24)))


def row(engine, size, seconds, error):
    return PeerCost("published", engine, size, 5, seconds, seconds, seconds, error, 1.0, 1.0)


def test_the_summary_gives_times_to_one_per_cent():
    ours = [row("percept", 0.1, 0.5, 0.02), row("percept", 0.02, 1.0, 0.008)]
    theirs = [row("nutpie", 250, 10.0, 0.04), row("nutpie", 1000, 30.0, 0.02)]
    assert time_to(0.01, ours) == (1.0, False)
    assert time_to(0.01, theirs) == (120.0, True)
    (line,) = summary([*ours, *theirs])
    assert line.endswith("to an error of 1 %: percept 1 s, nutpie 120 s (extrapolated).")


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["--engines", "stan"], 2, "there are percept, emcee, nutpie"),
        (["--rows", "nobody's"], 2, "there are published, published-k"),
    ],
)
def test_wrong_names_are_refused(tmp_path, capsys, words, code, message):
    assert main(["peers", *words, "--out", str(tmp_path)]) == code
    assert message in capsys.readouterr().err


def test_commands_take_turns_and_are_timed(tmp_path):
    note = (
        f"import os, sys; open({str(tmp_path / 'log')!r}, 'a').write(sys.argv[1] +"
        " os.environ['PERCEPT_CACHE'] + ' ')"
    )
    work = note + "; sum(range(6_000_000))"
    commands = {IMPORTS: ("-c", note, "a"), "report": ("-c", work, "b")}
    light, heavy = command_costs(2, commands)
    assert (tmp_path / "log").read_text() == "aoff boff " * 3
    # Both start an interpreter; only one of them works.
    assert heavy.processor_s > light.processor_s
    assert heavy.processor_ratio > light.processor_ratio == 1.0
    assert heavy.promised == (4.0, 5.0)


def test_a_command_that_fails_is_named():
    with pytest.raises(RefusalError, match="-c import no_such_library failed: ModuleNotFoundError"):
        command_costs(1, {IMPORTS: ("-c", "import no_such_library")})


@pytest.mark.evidence
def test_engines_are_measured_against_a_reference_that_is_kept(tmp_path, capsys):
    """emcee's stretch moves are far too short here: an error that is shown, not agreement."""
    kept = study_of("published-k")
    from reports.benchmark.peers import percept_run

    fitted = percept_run(kept, 0.05, 1)
    run = {"value": fitted.value.tolist(), "error": fitted.error.tolist()}
    lines = [json.dumps({"plan": "published-k 0.005", "index": index} | run) for index in range(30)]
    (tmp_path / "finished.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = ["--engines", "percept", "--rows", "published-k", "--seconds", "0"]
    assert main(["peers", *words, "--out", str(tmp_path)]) == 0
    (found,) = json.loads((tmp_path / "peers.json").read_text(encoding="utf-8"))["rows"]
    assert (found["engine"], found["size"], found["repeats"]) == ("percept", 0.1, 1)
    assert 0.0 < found["error"] < 0.2

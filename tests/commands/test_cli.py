import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from percept.cli import COMMANDS, GROUPS, build_parser, main
from percept.errors import UsageError
from tests import DATASETS
from tests.documents import with_rows
from tests.unmixed import unmixed_sessions

SESSIONS = str(DATASETS / "hbfd_sessions.csv")
HEADER = "subject,environment,k_ref,b_ref,k_adj,b_adj\n"
ROWS = [
    "S1,A,10,1,9,1.1",
    "S1,B,100,2,95,2.2",
    "S2,A,10,1,11,0.8",
    "S2,B,100,2,99,1.7",
    "S3,A,10,1,8,1.3",
]


def write(tmp_path, lines, header=HEADER):
    path = tmp_path / "study.csv"
    path.write_text(header + "\n".join(lines) + "\n", encoding="utf-8")
    return str(path)


def refused(arguments, capsys):
    code = main(arguments)
    return code, capsys.readouterr().err


@pytest.mark.parametrize(
    ("lines", "header", "code", "expected"),
    [
        (
            [row.rsplit(",", 1)[0] for row in ROWS],
            HEADER.replace(",b_adj", "").replace("k_adj", "k_set"),
            2,
            ["study.csv", "k_adj"],
        ),
        ([*ROWS, "S3,B,100,2,abc,2.0"], HEADER, 2, ["study.csv", "7", "k_adj", "abc"]),
        (ROWS[:2], HEADER, 1, ["at least two subjects", "S1"]),
        ([*ROWS, ROWS[1]], HEADER, 2, ["study.csv", "S1", "B"]),
    ],
    ids=["missing column", "text in a number", "one subject", "two rows for one cell"],
)
def test_bad_input_says_where_and_leaves_nothing(tmp_path, capsys, lines, header, code, expected):
    out = tmp_path / "out"
    found, message = refused(["report", write(tmp_path, lines, header), "--out", str(out)], capsys)
    assert found == code
    for part in expected:
        assert part in message
    assert not out.exists()
    assert [path.name for path in tmp_path.iterdir()] == ["study.csv"]


def test_what_no_logarithm_is_of_costs_the_model_one_environment(tmp_path, capsys):
    out = tmp_path / "out"
    path = write(tmp_path, [*ROWS, "S3,B,100,2,-4,2.0"])
    words = ["report", path, "--tolerance", "0.3", "--out", str(out)]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert (
        "warning: The hierarchical model leaves out B: zero or negative values have no logarithm"
        in printed
    )
    assert "There are no Bayesian intervals" not in printed
    assert printed.splitlines()[-1] == str(out / "report.html")


def test_names_reach_the_terminal_as_text(tmp_path, capsys):
    path = tmp_path / "a\x1b[2J\u202e.csv"
    path.write_text("subject,environment,k_ref,k_adj\n1,a,10,x\n")
    _, message = refused(["fit", str(path)], capsys)
    assert r"a\x1b[2J\u202e.csv:2" in message
    _, message = refused(["fit", str(tmp_path / "b\x1b.csv")], capsys)
    assert r"b\x1b.csv: there is no such file" in message
    assert "\x1b" not in message


def test_a_locale_of_ascii_loses_no_line():
    command = [sys.executable, "-m", "percept", "predict", "--help"]
    ran = subprocess.run(
        command,
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
        capture_output=True,
        check=True,
        text=True,
    )
    assert r"N\xb7s/m" in ran.stdout


def test_fit_writes_the_intervals_it_prints(tmp_path, capsys):
    out = tmp_path / "out"
    code = main(["fit", SESSIONS, "--method", "classical", "--out", str(out), "--json"])
    printed = with_rows(capsys.readouterr().out)
    assert code == 0
    assert printed == with_rows((out / "fit.json").read_text(encoding="utf-8"))
    row = next(r for r in printed["intervals"] if r["environment"] == "VE4" and r["kind"] == "mean")
    assert f"{row['lower']:.0f} {row['upper']:.0f}" == "23316 24968"


def test_report_ends_with_the_page_and_keeps_what_was_there(tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    report = ["report", SESSIONS, "--method", "classical", "--family", "normal", "--out", str(out)]
    assert main(report) == 2
    assert "--force" in capsys.readouterr().err
    code = main([*report, "--force"])
    *said, last = capsys.readouterr().out.strip().splitlines()
    assert code == 0
    assert (out / "notes.txt").read_text() == "mine"
    assert Path(last) == out / "report.html"
    summary = json.loads((out / "report.json").read_text(encoding="utf-8"))["summary"]
    warnings = [f"warning: {sentence}" for sentence in summary["cautions"]]
    assert said == [*summary["sentences"], *warnings]
    assert said[0].startswith("Users set stiffness ")
    assert "VE5" in Path(last).read_text(encoding="utf-8")
    assert (out / "notes.txt").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_fit_prints_the_methods_side_by_side(tmp_path, capsys):
    """Sixteen environments have 48 rows, of which 30 are printed."""
    rows = [f"S{s},E{e:02},{10 * e},{11 * e + s * 0.3 * e}" for e in range(1, 17) for s in range(3)]
    path = write(tmp_path, rows, "subject,environment,k_ref,k_adj\n")
    words = ["fit", path, "--method", "classical", "--quiet", "--out", str(tmp_path / "out")]
    assert main(words) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].split() == [
        "environment",
        "parameter",
        "kind",
        "family",
        "unit",
        "reference",
        "classical_lower",
        "classical_upper",
    ]
    assert [line.split()[0] for line in printed[1:31]] == [
        f"E{e:02}" for e in range(1, 11) for _ in range(3)
    ]
    assert printed[31] == "These are 30 of 48 rows; fit.json has all."
    assert printed[32].startswith("Left out: ")
    document = with_rows((tmp_path / "out" / "fit.json").read_text(encoding="utf-8"))
    (row,) = (
        row
        for row in document["intervals"]
        if (row["environment"], row["kind"], row["family"]) == ("E01", "mean", "lognormal")
    )
    assert printed[1].split()[-2:] == [f"{row['lower']:.6g}", f"{row['upper']:.6g}"]


def test_the_study_s_words_are_the_terminal_s(tmp_path, capsys):
    rows = [
        f"{s},{e},{x},{x + 10 * s}" for e, x in (("short", 400), ("long", 800)) for s in (1, 2, 3)
    ]
    path = write(tmp_path, rows, "subject,environment,duration_ref,duration_adj\n")
    scene = tmp_path / "scene.toml"
    scene.write_text(
        '[quantities]\nduration = { unit = "ms" }\n[study]\nenvironment = "standard"\nsubject ='
        ' "listener"\n'
    )
    words = [path, "--scene", str(scene)]
    classical = ["--method", "classical", "--out", str(tmp_path / "out")]
    for command in (["fit", *words, *classical], ["report", *words, *classical]):
        assert main(command) == 0
        printed = capsys.readouterr().out
        assert "standard" in printed
        assert "environment" not in printed
        assert "subject" not in printed
    assert "warning: 3 listeners are few" in printed


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help_with_an_example(command, capsys):
    with pytest.raises(SystemExit) as stopped:
        build_parser().parse_args([command, "--help"])
    assert stopped.value.code == 0
    text = capsys.readouterr().out
    assert f"percept {command}" in text.split("example:")[1]


def test_percept_alone_prints_its_commands_in_groups(capsys):
    assert main([]) == 0
    alone = capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["--help"])
    assert capsys.readouterr().out == alone
    for group, lines in GROUPS.items():
        listed = alone.partition(f"\n{group}:\n")[2].partition("\n\n")[0].splitlines()
        assert [line.split(maxsplit=1) for line in listed] == [
            [name, line] for name, (_, line) in lines.items()
        ]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["repotr", SESSIONS],
            "there is no command 'repotr'. Did you mean report? See percept --help.",
        ),
        (["frobnicate"], "there is no command 'frobnicate'. See percept --help."),
        (
            [SESSIONS],
            f"there is no command {SESSIONS!r}. To analyse it, run percept report {SESSIONS}.",
        ),
        (
            ["fit", SESSIONS, "--sceen", "s"],
            "there is no option --sceen. Did you mean --scene? See",
        ),
        (
            ["--versoin"],
            "there is no option --versoin. Did you mean --version? See percept --help.",
        ),
        (
            ["doctor", "it"],
            "value 'it': there is one argument too many. See percept doctor --help.",
        ),
    ],
    ids=["command", "nothing like it", "a file", "option", "option before a command", "argument"],
)
def test_a_slip_is_told_with_what_is_like_it(words, said, capsys):
    assert main(words) == 2
    assert capsys.readouterr().err.startswith(f"percept: {said}")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--method", "baysian"], "argument --method: invalid choice: 'baysian' (choose from "),
        (["--seed", "1.5"], "argument --seed: invalid int value: '1.5'. See percept fit --help."),
        ([], "the following arguments are required: PATH. See percept fit --help."),
    ],
    ids=["choice", "whole number", "missing"],
)  # fmt: skip
def test_a_wrong_value_of_an_option_is_told_in_plain_words(words, said, capsys):
    paths = [SESSIONS] if words else []
    with pytest.raises(SystemExit) as stopped:
        main(["fit", *paths, *words])
    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith(f"percept fit: {said}")


@pytest.mark.parametrize(
    ("words", "like"),
    [(["help"], ["--help"]), (["help", "fit"], ["fit", "--help"]), (["-V"], ["--version"])],
    ids=["help", "help of a command", "version"],
)
def test_what_other_commands_understand_percept_does_too(words, like, capsys):
    printed = []
    for spelling in (words, like):
        with pytest.raises(SystemExit) as stopped:
            main(spelling)
        assert stopped.value.code == 0
        printed.append(capsys.readouterr().out)
    assert printed[0] == printed[1]


def heed_interrupts():
    """A job started in the background ignores interrupts, and its children inherit that."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.parametrize(
    ("command", "said"),
    [("batch", "keeps what is finished and goes on"), ("validate", "starts again from the data")],
)
def test_an_interrupted_command_says_how_to_go_on(command, said, tmp_path):
    """A real interrupt, sent while the command reads a pipe that nobody writes to."""
    pipe = tmp_path / "sessions.csv"
    os.mkfifo(pipe)
    words = [sys.executable, "-m", "percept", command, str(pipe)]
    if command == "batch":
        words += ["--workers", "1", "--out", str(tmp_path / "out")]
    with (
        subprocess.Popen(
            words, stderr=subprocess.PIPE, text=True, preexec_fn=heed_interrupts
        ) as process,
        pipe.open("w"),  # opens once the command reads
    ):
        process.send_signal(signal.SIGINT)
        assert process.stderr.read() == f"percept: interrupted. The same command {said}.\n"
    assert process.returncode == 130


def in_shell(line):
    """A line of a shell, `percept` being this one, and what it gives."""
    line = f'percept() {{ "{sys.executable}" -m percept "$@"; }}; {line}'
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("closed", "command"), [("2>&-", "new"), ("<&- >&- 2>&-", f"fit '{SESSIONS}' --out")]
)
def test_streams_that_the_caller_closed_cost_nothing_but_what_they_would_show(
    tmp_path, closed, command
):
    method = "--method classical" if command != "new" else ""
    ran = in_shell(f"percept {command} '{tmp_path}/made.toml' {method} {closed}")
    assert (ran.returncode, ran.stderr) == (0, "")
    assert (tmp_path / "made.toml").exists()
    assert ran.stdout.count("made.toml") == (closed == "2>&-")
    refused = in_shell(f"percept nothing {closed}")
    assert (refused.returncode, refused.stdout) == (2, "")


@pytest.mark.parametrize(
    "line",
    ["percept doctor | true; exit ${PIPESTATUS[0]}",
     "percept nothing 2>&1 | true; exit ${PIPESTATUS[0]}"],
)  # fmt: skip
def test_output_that_nobody_reads_ends_quietly_as_a_shell_tells_it(line):
    ran = in_shell(line)
    assert (ran.returncode, ran.stdout, ran.stderr) == (141, "", "")


def imported_by(*codes):
    """Modules that a process has imported after each piece of code."""
    script = "import sys\n"
    for code in codes:
        script += f"{code}\nprint('modules', *sys.modules)\n"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return [set(line.split()) for line in run.stdout.splitlines() if line.startswith("modules ")]


SLOW = {"scipy.stats", "arviz_base", "arviz_stats", "emcee", "matplotlib"}


def test_help_imports_no_numerics():
    (modules,) = imported_by("from percept.cli import build_parser; build_parser().format_help()")
    assert not modules & {"numpy", "pandas", "scipy", "pydantic", *SLOW}


def test_what_samples_nothing_imports_no_slow_statistics_and_a_classical_fit_no_sampler(tmp_path):
    commands = [
        ["validate", SESSIONS],
        ["new", str(tmp_path / "scene.toml")],
        ["new", str(tmp_path / "mapped.toml"), "--from", SESSIONS],
        ["plan", "--sd", "0.2", "--half-width", "0.1"],
    ]
    fit = ["fit", SESSIONS, "--method", "classical", "--out", str(tmp_path / "out")]
    light, fitting = imported_by(
        f"from percept.cli import main\nfor words in {commands!r}: assert main(words) == 0",
        f"assert main({fit!r}) == 0",
    )
    assert not light & SLOW
    unwanted = {"xarray", "jinja2", "rich", "scipy.interpolate", "scipy.optimize", *SLOW}
    assert not fitting & unwanted - {"scipy.stats"}


def test_a_device_that_cannot_be_read_is_said_before_anything_is_sampled(tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text('[device]\nresponse = "zd.csv"\nperiod = 0.001\n')
    out = tmp_path / "out"
    study = str(DATASETS / "hbfd_sessions.csv")
    words = ["fit", study, "--scene", str(scene), "--no-cache", "--out", str(out)]
    assert main(words) == 2
    assert f"{tmp_path / 'zd.csv'}: cannot be read" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.evidence
def test_a_report_in_the_folder_of_the_sessions_is_no_session(tmp_path, capsys):
    (tmp_path / "sessions.csv").write_bytes(Path(SESSIONS).read_bytes())
    words = ["report", str(tmp_path), "--method", "classical", "--out", str(tmp_path / "report")]
    assert main(words) == 0
    assert any((tmp_path / "report" / "tables").glob("*.csv"))
    capsys.readouterr()
    assert main(words) == 0
    assert "report: a folder of results is not read" in capsys.readouterr().err


def test_a_report_says_that_the_bayesian_numbers_are_withheld(tmp_path, capsys):
    scene = tmp_path / "hasty.toml"
    scene.write_text("[inference]\ntolerance = 0.01\nmost_steps = 200\n")
    sessions = tmp_path / "unmixed.csv"
    unmixed_sessions().to_csv(sessions, index=False)
    words = ["--scene", str(scene), "--out", str(tmp_path / "out"), "--quiet"]
    assert main(["report", str(sessions), *words]) == 1
    captured = capsys.readouterr()
    assert captured.out.strip() == str(tmp_path / "out" / "report.html")
    assert captured.err.startswith("percept: Bayesian intervals are withheld: ")
    simpler = '[model] common_spread = true or [inference] parameters = ["k"] or ["b"].'
    assert f"A model with fewer scales mixes faster: {simpler}" in captured.err
    assert re.search(
        r"slowest quantity, (lower|upper) (mean|user|share) limit of [kb] in VE\d+; 10 are"
        r" needed\. "
        r"most_steps = \d+ gives it more \(now 200\)\.",
        captured.err,
    )


def test_an_error_above_the_tolerance_is_a_warning_and_no_failure(tmp_path, capsys):
    scene = tmp_path / "hasty.toml"
    scene.write_text("[inference]\ntolerance = 0.0001\nmost_steps = 200\n")
    sessions = tmp_path / "one.csv"
    table = pd.read_csv(SESSIONS, dtype={"subject": str}).drop(columns="source")
    table[table["environment"] == "VE2"].to_csv(sessions, index=False)
    words = [str(sessions), "--scene", str(scene), "--quiet"]
    assert main(["fit", *words, "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().err
    assert told.startswith("percept: The Monte Carlo error reached is ")
    assert "0.01 % was requested. A larger most_steps (now 200) lowers it." in told
    document = with_rows((tmp_path / "out" / "fit.json").read_text(encoding="utf-8"))
    assert {row["method"] for row in document["intervals"]} == {"classical", "bayesian"}
    gate = document["diagnostics"]["gate"]
    assert gate["passed"]
    assert not gate["tolerance_met"]
    assert gate["rhat"] < 1.01
    assert gate["error_reached"] in told


@pytest.mark.parametrize("before", [True, False], ids=["before the command", "after it"])
def test_debug_shows_the_traceback(before):
    command = ["validate", "nowhere.csv", "--scene", "nowhere.toml"]
    with pytest.raises(UsageError, match="nowhere"):
        main(["--debug", *command] if before else [*command, "--debug"])


def test_without_debug_an_error_is_one_line(capsys):
    assert main(["validate", "nowhere.csv", "--scene", "nowhere.toml"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert message.startswith("percept: nowhere.toml")


def test_fit_says_which_intervals_are_left_out(tmp_path, capsys):
    path = write(tmp_path, ["S1,A,10,1,-9,1.1", "S2,A,10,1,9,1.2", "S3,A,10,1,7,1.0"])
    assert main(["fit", path, "--method", "classical", "--out", str(tmp_path / "out")]) == 0
    left = [line for line in capsys.readouterr().out.splitlines() if line.startswith("Left out: ")]
    assert (
        len([line for line in left if "classical lognormal intervals of stiffness in A" in line])
        == 1
    )
    assert not any("classical normal" in line for line in left)


def test_of_many_notices_the_first_are_said(tmp_path, capsys):
    folder = tmp_path / "study"
    folder.mkdir()
    for number in range(12):
        extra = "abcdefghijkl"[number]
        rows = "\n".join(
            f"S{number},{e},{k},1,{k * (1.01 + 0.01 * number)},1.1,x"
            for e, k in (("A", 10), ("B", 99))
        )
        (folder / f"s{number}.csv").write_text(
            HEADER.replace("\n", f",extra_{extra}\n") + rows + "\n", encoding="utf-8"
        )
    assert main(["fit", str(folder), "--method", "classical", "--out", str(tmp_path / "out")]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 11
    assert lines[0].endswith("columns not used: 'extra_a'")
    assert lines[-1] == "and 2 more notices: see percept validate"

import json

import pytest

from percept.cli import main
from percept.planning import plan_contrast, plan_equivalent, plan_mean, plan_share, plan_user
from tests.study.within import crossed, frame


@pytest.mark.parametrize(
    ("words", "plan"),
    [
        (
            "--kind mean --half-width 0.1 --sd 0.2 --family lognormal --level 0.9",
            plan_mean(0.1, sd=0.2, family="lognormal", level=0.9),
        ),
        ("--kind user --ratio 1.3 --assurance 0.9", plan_user(1.3, assurance=0.9)),
        (
            "--kind share --ratio 1.4 --share 0.9 --confidence 0.8",
            plan_share(1.4, share=0.9, confidence=0.8),
        ),
    ],
)
def test_options_reach_the_plan_of_their_kind(words, plan, capsys):
    assert main(["plan", *words.split()]) == 0
    assert capsys.readouterr().out == f"{plan.covers}\n"
    assert main(["plan", *words.split(), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == vars(plan)


def test_a_contrast_is_planned_by_stated_sds(capsys):
    words = "plan --kind contrast --difference 0.1 --sd 0.2 --other-sd 0.3 --family lognormal"
    assert main([*words.split(), "--level", "0.95", "--assurance", "0.9"]) == 0
    asked = {"level": 0.95, "assurance": 0.9, "family": "lognormal"}
    plan = plan_contrast(0.1, sd=0.2, other_sd=0.3, **asked)
    assert capsys.readouterr().out == f"{plan.covers}\n"


def test_an_equivalence_is_planned_by_its_flag(capsys):
    words = (
        "plan --kind equivalent --jnd 0.2 --sd 0.2 --bias 0.05 --family lognormal --decision 0.9"
    )
    assert main([*words.split(), "--assurance", "0.9"]) == 0
    plan = plan_equivalent(0.2, sd=0.2, bias=0.05, decision=0.9, assurance=0.9, family="lognormal")
    assert capsys.readouterr().out == f"{plan.covers}\n"
    assert main(["plan", "--kind", "equivalent", "--sd", "0.2"]) == 2
    assert "kind equivalent needs --jnd" in capsys.readouterr().err


def test_a_contrast_is_planned_by_a_pilot_study(tmp_path, capsys):
    data = tmp_path / "pilot.csv"
    frame().to_csv(data, index=False)
    words = [
        "plan",
        str(data),
        "--kind",
        "contrast",
        "--by",
        "hand",
        "--difference",
        "0.1",
        "--level",
        "0.95",
        "--quiet",
    ]
    assert main([*words, "--json"]) == 0
    (pilot,) = json.loads(capsys.readouterr().out)["plans"]
    assert main(words) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith(f"stiffness, right against left: With {pilot['plan']['n']} subjects, a")
    assert second == (
        f"  If the true SDs are at their upper 80 % limits, it takes {pilot['cautious']['n']}."
    )
    table = frame()
    table.loc[table["hand"] == "right", "k_adj"] = 1.2 * table["k_ref"]
    table.loc[table["hand"] == "left", "k_adj"] = table["k_ref"]
    table.to_csv(data, index=False)
    assert main(words) == 1
    assert "the pilot gives no SD of a contrast" in capsys.readouterr().err


def test_groups_of_a_pilot_study(tmp_path, capsys):
    data = tmp_path / "pilot.csv"
    table = crossed().query("hand == 'left' and load == 'low'")
    table.to_csv(data, index=False)
    words = [
        "plan",
        str(data),
        "--kind",
        "contrast",
        "--by",
        "group",
        "--difference",
        "0.1",
        "--quiet",
    ]
    assert main(words) == 0
    assert "expert against novice: With" in capsys.readouterr().out


def undecided(tmp_path, method):
    """Write a study of a wall that needs more subjects, and return the words that plan them."""
    rows = ["510,1.9", "470,2.4", "560,1.7", "520,2.6", "450,2.1"]
    lines = [f"S{i},soft,500,2,{row}" for i, row in enumerate(rows)]
    head = "subject,environment,k_ref,b_ref,k_adj,b_adj"
    data = tmp_path / "walls.csv"
    data.write_text("\n".join([head, *lines, ""]))
    scene = tmp_path / "scene.toml"
    device = "[device]\nmass = 0.5\ndamping = 5.0\nperiod = 0.001\n"
    scene.write_text(f"coupling = {{ stiffness = 3e3, damping = 20.0 }}\n{device}")
    return ["plan", str(data), "--scene", str(scene), "--method", method, "--kind", "verdicts"]


def test_undecided_verdicts_come_with_the_subjects_that_decide_them(tmp_path, capsys):
    words = undecided(tmp_path, "classical")
    assert main([*words, "--quiet", "--json"]) == 0
    (direct, coupled) = json.loads(capsys.readouterr().out)["verdicts"]
    assert main([*words, "--quiet"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("soft, directly: ")
    assert coupled["outcome"] == "too little data"
    more = coupled["more"]["subjects"]
    assert printed[1].startswith(
        f"soft, through the coupling: too little data; about {more} more subject"
    )
    assert direct["outcome"] in printed[0]
    (tmp_path / "scene.toml").write_text("")
    assert main([*words, "--quiet"]) == 1
    assert "there is no verdict to decide" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--kind mean --sd 1", "kind mean needs --half-width"),
        ("--kind user", "kind user needs --ratio"),
        ("--kind mean", "kind mean needs --half-width and --sd."),
        ("--kind user --ratio 1.1 --sd 3", "kind user has no use for --sd."),
        ("--kind share --ratio 1.1 --level 0.9", "kind share has no use for --level."),
        ("--kind share --ratio 0.9", "ratio must be above 1"),
        ("--kind verdicts", "kind verdicts needs the sessions of a study."),
        ("walls.csv --kind user --ratio 1.1", "sessions are for --kind verdicts and for --by."),
        ("--kind contrast --sd 1", "kind contrast needs --difference."),
        ("--kind mean --half-width 1 --sd 1 --other-sd 1", "kind mean has no use for --other-sd."),
        ("--by hand --difference 0.1", "--by is for --kind contrast."),
        ("--kind contrast --by hand --difference 0.1", "--by needs the sessions of a pilot study"),
    ],
)
def test_options_of_another_kind_are_refused(words, message, capsys):
    assert main(["plan", *words.split()]) == 2
    assert message in capsys.readouterr().err

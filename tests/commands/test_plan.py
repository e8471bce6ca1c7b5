import json

import pytest

from percept.cli import main
from percept.planning import plan_mean, plan_share, plan_user


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
    assert (printed["n"], printed["share"], printed["covers"]) == (plan.n, plan.share, plan.covers)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--kind mean --sd 1", "kind mean needs --half-width"),
        ("--kind user", "kind user needs --ratio"),
        ("--kind mean", "kind mean needs --half-width and --sd."),
        ("--kind user --ratio 1.1 --sd 3", "kind user has no use for --sd."),
        ("--kind share --ratio 1.1 --level 0.9", "kind share has no use for --level."),
        ("--kind share --ratio 0.9", "ratio must be above 1"),
    ],
)
def test_options_of_another_kind_are_refused(words, message, capsys):
    assert main(["plan", *words.split()]) == 2
    assert message in capsys.readouterr().err

"""Unknown column names: a mapping is proposed, written, and followed only where the user says
so."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest
from scipy import stats

from percept.cli import main
from percept.sessions import propose_columns

PLACES = {"soft": 300.0, "hard": 900.0}


def study(tmp_path, head="id,condition,stiffness standard [N/mm],stiffness final [N/mm],rt"):
    rows = [
        f"{p},{c},{k / 1000},{k * (1 + (p + r / 3) / 50) / 1000:.6f},0.{p}"
        for p in range(1, 6)
        for c, k in PLACES.items()
        for r in (0, 1)
    ]
    path = tmp_path / "s.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


def fit(path, *more):
    return main(
        [
            "fit",
            str(path),
            "--method",
            "classical",
            "--quiet",
            "--out",
            str(path.parent / "out"),
            *more,
        ]
    )


def test_nothing_is_read_under_a_mapping_that_nobody_accepted(tmp_path, capsys):
    path = study(tmp_path)
    assert fit(path) == 2
    said = capsys.readouterr().err
    assert f"{path}: the columns have other names. This is what percept would make of them:" in said
    assert 'subject = "id"  # 5 different: 1, 2, 3, 4 …' in said
    assert 'environment = "condition"  # 2 different: soft, hard' in said
    assert (
        'k_ref = { name = "stiffness standard [N/mm]", unit = "N/mm" }  # 2 different: 0.3, 0.9'
        in said
    )
    assert (
        'trial = "order"  # 10 rows of 20 repeat a subject and environment, without numbers' in said
    )
    assert '# not used: "rt": ' in said
    assert "Add --accept to go on with it, or --write-scene scene.toml to write it too." in said
    assert not (tmp_path / "out").exists()


def test_an_accepted_mapping_is_followed_and_said(tmp_path, capsys):
    path = study(tmp_path)
    assert fit(path, "--accept") == 0
    assert "notice: columns are read as follows" in capsys.readouterr().err
    found = json.loads((tmp_path / "out" / "fit.json").read_text())["intervals"]
    plain = study(tmp_path, "subject,environment,k_ref,k_adj,rt")
    scene = tmp_path / "own.toml"
    scene.write_text(
        '[columns]\nk_ref = { name = "k_ref", unit = "N/mm" }\nk_adj = { name = "k_adj", unit ='
        ' "N/mm" }\n[sessions]\ntrial = "order"\n'
    )
    assert fit(plain, "--scene", str(scene)) == 0
    assert json.loads((tmp_path / "out" / "fit.json").read_text())["intervals"] == found


def test_an_accepted_quantity_stands_alone(tmp_path):
    path = tmp_path / "s.csv"
    rows = [f"{p},{ms},{ms + 10 * p}" for p in range(1, 6) for ms in (400, 800)]
    path.write_text("\n".join(["Participant ID,standard (ms),response (ms)", *rows]) + "\n")
    assert fit(path, "--accept") == 0
    document = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert list(document["provenance"]["scene"]["quantities"]) == ["duration"]


def test_a_written_mapping_is_a_scene_and_the_command_goes_on(tmp_path, capsys):
    path, scene = study(tmp_path), tmp_path / "scene.toml"
    assert fit(path, "--write-scene", str(scene)) == 0
    assert f"It is written to {scene}." in capsys.readouterr().err
    found = json.loads((tmp_path / "out" / "fit.json").read_text())["intervals"]
    assert fit(path, "--scene", str(scene)) == 0
    assert json.loads((tmp_path / "out" / "fit.json").read_text())["intervals"] == found
    assert fit(path, "--write-scene", str(scene)) == 2
    assert "already there" in capsys.readouterr().err


def test_keys_of_a_scene_that_lacks_a_mapping_stay(tmp_path, capsys):
    path, own, scene = study(tmp_path), tmp_path / "own.toml", tmp_path / "scene.toml"
    own.write_text(
        "coupling = { stiffness = 2e4, damping = 50.0 }\n[inference]\nlevel = 0.9\n"
        '[columns]\nk_adj = { name = "stiffness final [N/mm]", unit = "N/m" }\n'
        'k_ref = { name = "stiffness standard [N/mm]", unit = "N/m" }\n'
    )
    assert fit(path, "--scene", str(own), "--write-scene", str(scene)) == 0
    tables = tomllib.loads(scene.read_text())
    assert tables["coupling"] == {"stiffness": 2e4, "damping": 50.0}
    assert tables["inference"] == {"level": 0.9}
    # A column that the scene declares keeps its own unit, whatever the name of the column says.
    assert tables["columns"]["k_adj"]["unit"] == "N/m"
    assert tables["columns"]["subject"] == "id"
    document = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert {interval["level"] for interval in document["intervals"]} == {0.9}
    assert max(interval["upper"] for interval in document["intervals"]) < 5.0


def test_a_scene_is_written_from_data_alone(tmp_path, capsys):
    path, scene = study(tmp_path), tmp_path / "scene.toml"
    assert main(["new", str(scene), "--from", str(path)]) == 0
    said = capsys.readouterr()
    assert said.out == f"{scene}\n"
    text = scene.read_text()
    proposal, _, then = said.err.strip().rpartition("\n")
    assert text.startswith(proposal)
    assert then.startswith(f"percept: Look through it. Then: percept report {path} --scene {scene}")
    assert '# not used: "rt": ' in text
    assert "# It holds 5 subjects and 2 environments: 10 cells with 2 trials each." in text
    # Every other table of a scene stands below, to be switched on.
    assert "\n#: [device]" in text
    assert "\n#: [frequency]" in text
    assert text.count("\n[columns]") == text.count("\n[sessions]") == 1
    assert fit(path, "--scene", str(scene)) == 0


def test_a_scene_written_from_data_says_what_it_lacks(tmp_path, capsys):
    path, scene = tmp_path / "s.csv", tmp_path / "scene.toml"
    rows = [f"{s},{kind},{50 + s + t * 3.5}" for s in range(9) for t, kind in enumerate("abc")]
    path.write_text("\n".join(["person,condition,estimate", *rows]) + "\n")
    assert main(["new", str(scene), "--from", str(path)]) == 0
    lacks = (
        "response_ref is missing: fill it in, or uncomment the lines for means where nothing was"
    )
    assert f"{lacks} matched. Then: percept report " in capsys.readouterr().err
    lines = scene.read_text().splitlines()
    start = lines.index("# [environments]")
    lines[start : start + 4] = [line.removeprefix("# ") for line in lines[start : start + 4]]
    scene.write_text("\n".join(lines).replace('response_ref = "?"', "response_ref = 55.0"))
    assert fit(path, "--scene", str(scene)) == 0


def test_what_is_not_found_is_not_made_up(tmp_path, capsys):
    path = tmp_path / "s.csv"
    path.write_text("participant,colour,match\n1,red,3\n2,red,4\n")
    assert fit(path, "--accept") == 2
    said = capsys.readouterr().err
    assert "response_ref is missing: fill it in, or uncomment the lines for means" in said
    assert '# environment = ""  # one condition: no column seems to tell several apart' in said
    path.write_text("subject,environment,k_ref,k_adj\n1,a,10,x\n2,a,10,11\n")
    assert fit(path, "--accept") == 2
    assert "s.csv:2, column 'k_adj', value 'x': not a number." in capsys.readouterr().err
    path.write_text("a,b\n1,2\n")
    assert fit(path, "--accept") == 2
    assert "there is no column for subject and environment and k_adj" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("head", "mapped"),
    [
        (
            "Participant ID,standard (ms),reproduced_ms",
            ("Participant ID", "standard (ms)", "reproduced_ms"),
        ),
        (
            "subj,stimulus_duration,response_duration",
            ("subj", "stimulus_duration", "response_duration"),
        ),
        ("pp,reference,match", ("pp", "reference", "match")),
        ("subject_nr,target,estimate", ("subject_nr", "target", "estimate")),
        ("ppid,referenceValue,finalValue", ("ppid", "referenceValue", "finalValue")),
        (
            "Participant Private ID,Standard,Response",
            ("Participant Private ID", "Standard", "Response"),
        ),
    ],
)
def test_names_of_studies_and_of_tools_are_known(tmp_path, head, mapped):
    path = tmp_path / "s.csv"
    path.write_text(f"{head},rt\n1,300,310,0.5\n1,600,620,0.6\n2,300,290,0.5\n2,600,580,0.7\n")
    proposal = propose_columns(path)
    assert proposal.missing == ()
    name = {"standard (ms)": "duration", "stimulus_duration": "duration"}.get(mapped[1], "response")
    for canonical, column in zip(("subject", f"{name}_ref", f"{name}_adj"), mapped, strict=True):
        assert f'\n{canonical} = "{column}"' in proposal.text
    assert f'\nenvironment = "{mapped[1]}"' in proposal.text
    assert f"[quantities.{name}]" in proposal.text


def mapping_of(tmp_path, head, rows):
    path = tmp_path / "s.csv"
    path.write_text("\n".join([head, *rows]) + "\n")
    return propose_columns(path)


def test_a_proposal_says_how_many_rows_it_was_tried_on(tmp_path):
    rows = [f"{p},{r},{r + p / 10}" for p in range(1, 3000) for r in (300, 600)]
    proposal = mapping_of(tmp_path, "pp,reference,match", [*rows, "3000,300,"])
    assert "# Tried on the whole file: 5999 rows give 5998 adjustments." in proposal.text
    assert 'subject = "pp"  # 1 to 3000' in proposal.text
    late = mapping_of(tmp_path, "pp,reference,match", [*rows, "3000,300,abc"])
    assert (late.refused.row, late.refused.value) == (6000, "abc")


def test_columns_that_the_file_refutes_are_not_proposed(tmp_path):
    rows = [f"{p},{r},{r + p / 10},{p / 7:.4f}" for p in range(1, 9) for r in (300, 300, 600)]
    proposal = mapping_of(tmp_path, "id,reference,match,rep_err", rows)
    assert proposal.refused is None
    assert "trial" not in proposal.guessed
    assert 'trial = "order"' in proposal.text
    # Whole numbers that do not number trials are found when the file is read.
    rows = [f"{p},{r},{r + p / 10},5" for p in range(1, 9) for r in (300, 300, 600)]
    proposal = mapping_of(tmp_path, "id,reference,match,repeat", rows)
    assert proposal.refused is None
    assert '# not used: "repeat"' in proposal.text


def test_moments_are_no_references(tmp_path):
    rows = [f"{p},A,{p * 1.7 + t},{p + t}" for p in range(1, 9) for t in range(3)]
    proposal = mapping_of(tmp_path, "participant,condition,stimulus.started,response", rows)
    assert proposal.missing == ("response_ref",)
    # Nor are numbers that differ in every row, whatever their name.
    rows = [f"{p},{p * 1.7 + t * 0.1:.3f},{p * 1.7 + t}" for p in range(1, 30) for t in range(3)]
    proposal = mapping_of(tmp_path, "participant,stimulus_seen,response", rows)
    assert proposal.missing == ("response_ref",)


def test_a_whole_name_of_an_id_goes_before_a_part(tmp_path):
    rows = [f"{t},{p},{r},{r + p / 10}" for p in range(1, 9) for t, r in enumerate((300, 600), 1)]
    proposal = mapping_of(tmp_path, "sub_trial,id,reference,match", rows)
    assert 'subject = "id"' in proposal.text
    assert 'trial = "sub_trial"' in proposal.text


def test_a_mapping_that_fails_is_not_shown(tmp_path, capsys):
    path = study(tmp_path)
    path.write_text(path.read_text() + "6,hard,0.9,abc,0.6\n")
    assert fit(path, "--accept") == 2
    said = capsys.readouterr().err
    assert "This is what percept would make of them" not in said
    assert "percept tried a mapping of its own. Under it: " in said
    assert "value 'abc': not a number." in said


def test_without_a_mapping_the_way_out_names_quantities(tmp_path, capsys):
    path = tmp_path / "s.csv"
    path.write_text("a,b\n1,2\n")
    assert fit(path) == 2
    assert (
        "[quantities] names what people adjusted beside stiffness and damping."
        in capsys.readouterr().err
    )


def test_a_table_among_others_is_found_in_a_folder(tmp_path):
    (tmp_path / "a.csv").write_text("time,x\n1,2\n")
    (tmp_path / "b.csv").write_text("pp,reference,match\n1,10,11\n")
    assert "b.csv" in propose_columns(tmp_path).text.splitlines()[0]


def test_one_call_from_a_folder_gives_the_limits_of_scipy(tmp_path):
    rng = np.random.default_rng(6)
    means = []
    for subject in range(6):
        matches = np.round(0.5 * rng.lognormal(0, 0.1, 8), 6)
        means.append(matches.mean())
        rows = [f"{trial} {0.5} {match} none" for trial, match in enumerate(matches)]
        folder = tmp_path / "data" / f"S{subject}"
        folder.mkdir(parents=True)
        text = "\n".join(["Trial test_lum match_lum adaptor", *rows])
        (folder / f"contour_S{subject}_1.csv").write_text(text + "\n")
    assert fit(tmp_path / "data", "--accept") == 0
    document = json.loads((tmp_path / "out" / "fit.json").read_text())
    (interval,) = [
        row
        for row in document["intervals"]
        if (row["kind"], row["family"], row["joint"]) == ("mean", "normal", "marginal")
    ]
    expected = stats.t.interval(0.99, 5, np.mean(means), stats.sem(means))
    np.testing.assert_allclose([interval["lower"], interval["upper"]], expected, rtol=1e-12)

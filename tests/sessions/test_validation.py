"""What `percept validate` is told."""

from __future__ import annotations

import json

from percept import Scene
from percept.sessions import (
    format_validation,
    validate,
)
from tests import DATASETS

HEAD = "subject,environment,k_ref,k_adj\n"


def test_what_was_read(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text(HEAD + "001,a,10,11\n1,a,10,12\n1,b,10,\n")
    record = validate(file)
    text = format_validation(record)
    assert record.exit_code == 0
    assert f"{file}: 3 rows, sha256 {record.sessions.sources[0].sha256}" in text
    assert (
        f"notice: subjects '001' ({file}:2), '1' ({file}:3) look alike and are kept apart" in text
    )
    assert f"left out: {file}:4: subject 1, environment b: no adjustment" in text
    assert text.endswith("read without problems")
    parsed = json.loads(json.dumps(record.to_dict()))
    assert parsed["counts"]["observations"] == 2
    assert parsed["exclusions"][0]["row"] == 4


def test_what_was_understood_is_a_line_per_environment(tmp_path):
    """References in the units they are kept in, subjects, and the fewest and most trials of one."""
    file = tmp_path / "f.csv"
    file.write_text(
        "subject,environment,k_ref,b_ref,k_adj,b_adj,trial\n"
        "1,soft,0.5,2,0.4,2,1\n1,soft,0.5,2,0.4,2,2\n2,soft,0.5,2,0.6,2,1\n1,hard,20,,19,,1\n2,hard,20,,21,,1\n"
    )
    record = validate(
        file,
        scene=Scene(
            columns={
                "k_ref": {"name": "k_ref", "unit": "N/mm"},
                "k_adj": {"name": "k_adj", "unit": "N/mm"},
            }
        ),
    )
    lines = [" ".join(line.split()) for line in format_validation(record).splitlines()]
    at = lines.index("environment k_ref (N/m) b_ref (N·s/m) subjects trials per subject")
    assert lines[at + 1 : at + 3] == ["soft 500 2 2 1 to 2", "hard 20000 – 2 1"]
    found = json.loads(json.dumps(record.to_dict()))
    assert found["environments"][0] == {
        "environment": "soft", "k_ref (N/m)": 500.0, "b_ref (N·s/m)": 2.0, "subjects": 2,
        "trials per subject": "1 to 2",
    }  # fmt: skip


def test_a_published_table_is_understood_too():
    text = format_validation(validate(DATASETS / "hbfd_table1.csv"))
    line = next(line for line in text.splitlines() if line.split()[:1] == ["VE2"])
    assert line.split() == ["VE2", "1000", "1", "10", "published"]


def test_a_conflict_is_one_line(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text(HEAD + "1,a,10,9\n2,a,12,9\n3,a,12,9\n1,b,10,9\n2,b,11,9\n3,b,10,9\n")
    lines = format_validation(validate(file)).splitlines()
    assert len(lines) == 3
    assert lines[0].startswith(
        f"{file}:3, column 'k_ref', value 12.0: environment 'a' has the reference 10.0 in an"
        " earlier row, and another in 2 rows, here the first. "
    )
    assert lines[1].startswith(
        f"{file}:6, column 'k_ref', value 11.0: environment 'b' has the reference 10.0 in an"
        " earlier row, and another in 1 row, here the first. "
    )
    assert 'tells the environments apart: environment = "…" in [columns].' in lines[0]
    assert lines[2] == "2 problems"


def test_one_subject_is_no_study(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text(HEAD + "1,a,10,11\n")
    record = validate(file)
    assert record.exit_code == 1
    assert "there is one subject" in format_validation(record)


def test_unknown_names_lead_to_a_scene(tmp_path, monkeypatch):
    (tmp_path / "my data").mkdir()
    for name in ("a", "b"):
        (tmp_path / "my data" / f"{name}.csv").write_text("who,what,how\n1,2,3\n")
    monkeypatch.chdir(tmp_path)
    record = validate("my data/a.csv", "my data/b.csv")
    line = "Or run: percept new scene.toml --from 'my data/a.csv' 'my data/b.csv'"
    assert [problem.hint.endswith(line) for problem in record.problems] == [True, True]
    found = validate("my data").problems
    assert found[0].hint.endswith("Or run: percept new scene.toml --from 'my data'")

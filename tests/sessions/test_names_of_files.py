"""What names of files and folders say, and what lacks in a scene is asked for once."""

from __future__ import annotations

import pytest

from percept.errors import UsageError
from percept.sessions import read_sessions
from percept.sessions.options import ReadOptions
from percept.sessions.paths import ids_from_name


@pytest.mark.parametrize(
    ("pattern", "path", "subject"),
    [
        ("{subject}/*", "all/S10/contour_S10_1.csv", "S10"),
        ("*/{subject}/*/*", "walls/P01/S001/trial_results.csv", "P01"),
        ("walls_{subject}_*", "walls_ann_run_2.csv.gz", "ann"),
        ("{subject}", "x/ann.csv", "ann"),
    ],
)
def test_patterns_reach_over_folders_and_have_stars(pattern, path, subject):
    assert ids_from_name(path, pattern, file=path) == {"subject": subject}


def test_a_pattern_of_more_folders_than_there_are_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("environment,k_ref,k_adj\nx,10,11\n")
    options = ReadOptions(sessions={"filename": "no/{subject}/*"})
    with pytest.raises(ValueError, match=r"the name does not fit the pattern 'no/\{subject\}/\*'"):
        read_sessions(tmp_path / "a.csv", scene=options)


def test_a_companion_without_declared_columns_is_left_out(tmp_path):
    for subject in ("P01", "P02"):
        folder = tmp_path / subject
        folder.mkdir()
        rows = [f"{subject},{t},{20 + t % 2},{21.5 + t / 8}" for t in range(1, 25)]
        text = "\n".join(["ppid,trial_num,wall,feel", *rows]) + "\n"
        (folder / "trial_results.csv").write_text(text)
        (folder / "participant_details.csv").write_text(f"ppid,age\n{subject},30\n")
    columns = {"environment": "wall", "feel_ref": "wall", "feel_adj": "feel"}
    scene = ReadOptions(quantities={"feel": {"unit": "N"}}, columns=columns)
    sessions = read_sessions(tmp_path, scene=scene)
    assert sessions.subjects == ("P01", "P02")
    (notice,) = [n.text for n in sessions.notices if n.text.startswith("left out: ")]
    assert notice.endswith(" (and 1 more like this)")


def test_a_tracker_without_a_column_that_is_declared_is_left_out(tmp_path):
    (tmp_path / "trial_results.csv").write_text("ppid,wall,k_ref,k_adj\n1,a,10,11\n2,a,10,9\n")
    (tmp_path / "hand_T001.csv").write_text("time,pos_x\n0.01,1\n")
    scene = ReadOptions(columns={"environment": "wall"})
    assert read_sessions(tmp_path, scene=scene).subjects == ("1", "2")


def test_notices_of_many_files_are_one_with_their_number(tmp_path):
    for subject in range(1, 31):
        lines = [f"{subject},a,10,{10 + trial},{trial}" for trial in range(subject)]
        head = "subject,environment,k_ref,k_adj,x\n"
        (tmp_path / f"s{subject:02d}.csv").write_text(head + "\n".join(lines) + "\n")
    sessions = read_sessions(tmp_path, scene=ReadOptions(sessions={"keep": "last"}))
    unused, kept = sessions.notices
    assert unused.text == "columns not used: 'x' (and 29 more like this)"
    # Their numbers differ: the first file's stand there.
    assert kept.text.startswith('keep = "last" leaves out 0 of 1 rows')
    assert kept.text.endswith(" (and 29 more like this)")


def test_a_column_of_an_undeclared_quantity_says_how_to_declare_it():
    with pytest.raises(UsageError) as caught:
        ReadOptions.from_mapping({"columns": {"rt_adj": "rt"}})
    assert "there is no quantity 'rt'. Declare it in the scene: [quantities.rt]" in str(
        caught.value
    )
    assert "k_adj" not in str(caught.value)


def test_lacking_references_are_asked_for_once_as_lines_of_a_scene(tmp_path):
    path = tmp_path / "s.csv"
    rows = [f"{s},{e},{500 + s}" for s in (1, 2, 3) for e in ("soft", "hard")]
    path.write_text("\n".join(["subject,environment,k_adj", *rows]) + "\n")
    scene = ReadOptions.from_mapping({"environments": {"other": {"k_ref": 1.0}}})
    with pytest.raises(UsageError) as caught:
        read_sessions(path, scene=scene)
    assert str(caught.value).count("no reference") == 1
    assert '[environments]\n"soft" = { k_ref = "?" }\n"hard" = { k_ref = "?" }' in str(caught.value)

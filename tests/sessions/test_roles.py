"""Parts of columns are judged from their cells; names alone neither make nor break a mapping."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from percept.errors import UsageError
from percept.sessions import propose_columns, read_sessions
from percept.sessions.options import ReadOptions
from percept.sessions.paths import ids_from_name
from percept.sessions.records import shown

REFERENCES = (20, 40, 80, 160)


def trials(seed=1, subjects=12, trials_each=24):
    """Simulated rows: clock, subject, number of the trial, latency, reference, match."""
    rng = np.random.default_rng(seed)
    clock = 5000.0
    for subject in range(1, subjects + 1):
        bias = rng.normal(0, 0.1)
        for trial in range(1, trials_each + 1):
            reference = REFERENCES[rng.integers(len(REFERENCES))]
            clock += rng.gamma(5, 2)
            match = reference * np.exp(bias + rng.normal(0, 0.12))
            latency = rng.gamma(5, 0.3)
            yield clock, subject, trial, latency, reference, match


def proposal_of(tmp_path, head, rows, name="s.csv"):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("\n".join([head, *rows]) + "\n")
    return propose_columns(path)


def written(rows):
    return [f"{c:.3f},{s},{t},{w:.3f},{r},{m:.2f}" for c, s, t, w, r, m in rows]


def test_columns_without_a_telling_name_are_judged_by_their_cells(tmp_path):
    proposal = proposal_of(tmp_path, "c1,c2,c3,c4,c5,c6", written(trials()))
    assert proposal.refused is None
    assert proposal.missing == ()
    for line in ('subject = "c2"', 'environment = "c5"', 'c6_ref = "c5"', 'c6_adj = "c6"'):
        assert f"\n{line}  # " in proposal.text
    for name in ("c1", "c3", "c4"):
        assert f'# not used: "{name}"' in proposal.text


def test_names_that_mislead_are_overruled_by_the_cells(tmp_path):
    # What is called a reference is a latency, and has nothing to do with what was set.
    head = "when,who,count,target,shown,set"
    proposal = proposal_of(tmp_path, head, written(trials()))
    assert 'set_ref = "shown"' in proposal.text
    assert '# not used: "target"' in proposal.text


def test_a_reference_beats_a_level_that_only_numbers_it(tmp_path):
    levels = {reference: rank for rank, reference in enumerate(REFERENCES, 1)}
    rows = [f"{s},{levels[r]},{r},{m:.2f}" for _, s, _, _, r, m in trials()]
    proposal = proposal_of(tmp_path, "NSub,DurLevel,curDur,repDur", rows)
    assert 'dur_ref = "curDur"' in proposal.text


def test_two_estimates_share_the_reference_they_go_with(tmp_path):
    rows = [f"{s},{19 + s % 5},{r},{m:.2f},{m * 1.1:.1f}" for _, s, _, _, r, m in trials()]
    proposal = proposal_of(tmp_path, "ID,Age,Beep,Button_Estimate_,Written_Estimate_", rows)
    assert proposal.missing == ()
    assert 'button_ref = "Beep"' in proposal.text
    assert 'written_ref = "Beep"' in proposal.text


def test_a_doubtful_choice_names_the_others_with_three_values(tmp_path):
    rows = [f"P{s},Q{s},{r},{m:.2f}" for _, s, _, _, r, m in trials()]
    proposal = proposal_of(tmp_path, "person,respondent,reference,match", rows)
    assert 'subject = "person"' in proposal.text
    assert '\n# or "respondent": Q1, Q2, Q3 …\n' in proposal.text


def test_what_the_proposal_gives_stands_under_it(tmp_path):
    rows = [f"{s},{r},{m:.2f}" for _, s, _, _, r, m in trials()]
    rows[5] = rows[5].rpartition(",")[0] + ",100000"
    *_, before, warning = proposal_of(tmp_path, "vp,reference,match", rows).text.splitlines()
    assert before.startswith("# It holds 12 subjects and 4 environments: 48 cells with 2 to ")
    assert warning.startswith("# warning: ")
    assert warning.endswith("mistyped?")


def test_subjects_are_found_in_the_names_of_folders(tmp_path):
    for subject in ("S1", "S2", "S10"):
        rows = [f"{r},{m:.2f}" for *_, r, m in trials(int(subject[1:]), subjects=1)]
        proposal_of(tmp_path, "reference,match", rows, f"{subject}/contour_{subject}_1.csv")
    proposal = propose_columns(tmp_path)
    assert 'filename = "{subject}/*"' in proposal.text
    assert proposal.missing == ()
    assert proposal.refused is None
    assert "It holds 3 subjects and 4 environments" in proposal.text


def test_subjects_are_found_in_the_names_of_files(tmp_path):
    for subject in ("ann", "ben"):
        for block in (1, 2):
            seed = block + 2 * (subject == "ann")
            rows = [f"{r},{m:.2f}" for *_, r, m in trials(seed, subjects=1)]
            name = f"walls_{subject}_run-{block}.csv"
            proposal_of(tmp_path, "reference,match", rows, name)
    proposal = propose_columns(tmp_path)
    assert 'filename = "walls_{subject}_run-*"' in proposal.text
    assert "It holds 2 subjects" in proposal.text


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


def test_references_that_no_column_holds_are_asked_for(tmp_path):
    rng = np.random.default_rng(2)
    rows = [
        f"{t},{kind},{rng.normal(50, 9):.1f},{s}" for s in range(9) for t, kind in enumerate("cab")
    ]
    proposal = proposal_of(tmp_path, "trial,testType,estimate,subnum", rows)
    assert proposal.missing == ("response_ref",)
    assert 'environment = "testType"' in proposal.text
    assert '\n# "c" = { response_ref = "?" }\n' in proposal.text


def test_values_without_a_logarithm_ask_for_the_normal_family(tmp_path):
    rows = [f"{s},{r - 80},{m - 80:.2f}" for _, s, _, _, r, m in trials()]
    proposal = proposal_of(tmp_path, "person,reference,match", rows)
    assert '\nfamily = "normal"  # ' in proposal.text
    assert "\nscale = { response = " in proposal.text


def test_a_companion_without_declared_columns_is_left_out(tmp_path):
    for subject in ("P01", "P02"):
        folder = tmp_path / subject
        folder.mkdir()
        rows = [f"{subject},{t},{r},{m:.2f}" for _, _, t, _, r, m in trials(int(subject[1:]), 1)]
        proposal_of(tmp_path, "ppid,trial_num,wall,feel", rows, f"{subject}/trial_results.csv")
        (folder / "participant_details.csv").write_text(f"ppid,age\n{subject},30\n")
    columns = {"environment": "wall", "feel_ref": "wall", "feel_adj": "feel"}
    scene = ReadOptions(quantities={"feel": {"unit": "N"}}, columns=columns)
    sessions = read_sessions(tmp_path, scene=scene)
    assert sessions.subjects == ("P01", "P02")
    (notice,) = [n.text for n in sessions.notices if n.text.startswith("left out: ")]
    assert notice.endswith(" (and 1 more like this)")


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


def test_long_names_stay_different_in_a_list():
    names = [f"{'the wall of the first condition ' * 3}{end}" for end in ("left", "right")]
    listed = shown(names)
    assert "…" in listed
    assert listed.count("left") == listed.count("right") == 1


def test_a_response_time_is_no_second_response(tmp_path):
    rows = [f"{s},{r},{m:.2f},{w:.3f},{m - w:.2f}" for _, s, _, w, r, m in trials()]
    head = "observer,test_lum,match_lum,response_time,match_initial"
    proposal = proposal_of(tmp_path, head, rows)
    assert proposal.missing == ()
    assert 'lum_ref = "test_lum"' in proposal.text
    assert 'lum_adj = "match_lum"' in proposal.text
    assert '# not used: "response_time"' in proposal.text
    assert '# not used: "match_initial"' in proposal.text


def test_a_row_for_each_subject_is_a_wide_table(tmp_path):
    rng = np.random.default_rng(4)
    rows = [",".join(f"{k * rng.lognormal(0, 0.2):.1f}" for k in REFERENCES) for _ in range(9)]
    proposal = proposal_of(tmp_path, "wall_soft,wall_mid,wall_hard,wall_rigid", rows)
    assert proposal.missing == ("response_ref",)
    assert 'response_adj = "wall_{environment}"' in proposal.text
    assert 'subject = "row"  # no column holds an id' in proposal.text
    assert '\n# "soft" = { response_ref = "?" }\n' in proposal.text
    # An id that stands in each row once is taken.
    rows = [f"{7 * number},{row}" for number, row in enumerate(rows, 1)]
    proposal = proposal_of(tmp_path, "Part_ID,wall_soft,wall_mid,wall_hard,wall_rigid", rows)
    assert 'subject = "Part_ID"' in proposal.text


def test_references_that_are_missing_stop_no_trial_of_the_rest(tmp_path):
    rows = [
        f"{s},{m},{40 + 3 * s + i}" for i, m in enumerate(("calm", "upbeat")) for s in range(1, 9)
    ]
    proposal = proposal_of(tmp_path, "kind,Music,TimeGuess", rows)
    # Its numbers may name subjects, so that no row is taken for one.
    assert proposal.missing == ("subject", "time_ref")
    proposal = proposal_of(tmp_path, "Subject,Music,TimeGuess", rows)
    assert proposal.missing == ("time_ref",)
    assert 'environment = "Music"' in proposal.text
    assert '# "calm" = { time_ref = "?" }' in proposal.text
    assert "with medians in place of missing references: 16 rows give 16" in proposal.text
    assert "16 cells with 1 trial each." in proposal.text
    # Nobody left a reference that nobody knows.
    assert "warning" not in proposal.text


def test_a_study_of_one_condition_has_one_reference_to_fill_in(tmp_path):
    rows = [f"{s},{run},{800 + 13 * s - run}" for s in range(1, 6) for run in range(1, 21)]
    proposal = proposal_of(tmp_path, "Expt,Run,Speed", rows)
    assert proposal.missing == ("speed_ref",)
    for line in ('subject = "Expt"', 'trial = "Run"', 'speed_adj = "Speed"'):
        assert f"\n{line}  # " in proposal.text
    assert '# "all" = { speed_ref = "?" }' in proposal.text
    filled = proposal.text.replace("# [environments]", "[environments]")
    scene = filled.replace('# "all" = { speed_ref = "?" }', '"all" = { speed_ref = 792.5 }')
    options = ReadOptions.from_mapping(tomllib.loads(scene))
    assert read_sessions(tmp_path / "s.csv", scene=options).environments == ("all",)


def test_answers_without_any_id_are_a_subject_a_row(tmp_path):
    # Each group is sorted, so that answers stay for a run of rows, as ids do.
    rows = [f"metres,{8 + i // 3}" for i in range(44)] + [f"feet,{24 + i // 2}" for i in range(69)]
    proposal = proposal_of(tmp_path, "unit,width", rows)
    for line in ('environment = "unit"', 'width_adj = "width"', 'subject = "row"'):
        assert f"\n{line}  # " in proposal.text
    assert "113 subjects and 2 environments" in proposal.text


def test_a_second_factor_is_offered_beside_the_first(tmp_path):
    rows = [
        f"{s},{tint},{target},{20.5 + 3 * s + i + j}"
        for s in range(1, 9)
        for i, tint in enumerate(("no", "lo", "hi"))
        for j, target in enumerate(("hicon", "locon"))
    ]
    proposal = proposal_of(tmp_path, "id,tint,target,time_seen", rows)
    assert '# "target" is crossed with it: hicon, locon. Now its values are pooled' in proposal.text
    assert '# To tell them apart: environment = ["tint", "target"]' in proposal.text
    assert '# or, as a factor: [study] factor = "target"' in proposal.text


def test_columns_in_order_are_no_moments_where_a_row_is_a_subject(tmp_path):
    rows = [f'"{s}",{5 + (s * 7) % 5},{2.1 + 0.7 * s}' for s in range(1, 12)]
    proposal = proposal_of(tmp_path, '"",Control,Drug', rows)
    assert "a row per subject: 2 columns" in proposal.text
    assert '"Drug" = {}  # such as { response_ref = 3.5 }' in proposal.text


def test_decibels_are_proposed_as_amplitudes(tmp_path):
    rows = [
        f"{s},{r},{r + 3 - 0.7 * s + 0.1 * t}"
        for s in range(1, 9)
        for r in (40, 60, 80)
        for t in (0, 1)
    ]
    proposal = proposal_of(tmp_path, "subject,standard_dB,match_dB", rows)
    assert proposal.refused is None
    assert proposal.missing == ()
    for name in ("standard", "match"):
        assert f'{{ name = "{name}_dB", response = "log", scale = 0.05 }}' in proposal.text
    assert 'unit = ""  # an amplitude, read from decibels' in proposal.text
    options = ReadOptions.from_mapping(tomllib.loads(proposal.text))
    sessions = read_sessions(tmp_path / "s.csv", scene=options)
    np.testing.assert_allclose(sessions.table["level_ref"].iloc[:3], [1e2, 1e2, 1e3], rtol=1e-12)
    first = sessions.table["level_adj"].iloc[0]
    np.testing.assert_allclose(20 * np.log10(first), 42.3, rtol=1e-12)
    assert sessions.warnings == ()


def test_two_measures_in_a_wide_table_are_two_quantities(tmp_path):
    rows = [
        f"{'ABC'[s % 3]},{3 + s % 3},{2 + s % 4},{1 + s % 3},{12 + s % 5},{11 + s % 7},{13 + s % 4}"
        for s in range(24)
    ]
    proposal = proposal_of(tmp_path, "group,wl1,wl2,wl3,se1,se2,se3", rows)
    assert '\nwl_adj = "wl{environment}"  # a row per subject: 3 columns' in proposal.text
    assert '\nse_adj = "se{environment}"  # a row per subject: 3 columns' in proposal.text
    assert proposal.missing == ("wl_ref", "se_ref")
    assert "24 subjects and 3 environments" in proposal.text


def test_groups_are_no_subjects_and_numbered_columns_stay_together(tmp_path):
    # The first column of a series counts up by chance.
    rows = [
        f"{'ABCD'[s // 4]},{1 + s % 4},{4 - s % 4},{8 + s % 3},{9 + s % 4},{12 - s % 3}"
        for s in range(16)
    ]
    proposal = proposal_of(tmp_path, "Group,V1,V2,V3,V4,V5", rows)
    assert 'response_adj = "{environment}"  # a row per subject: 5 columns' in proposal.text
    assert 'subject = "row"' in proposal.text


def test_a_reaction_time_is_the_response_where_nothing_else_is(tmp_path):
    rows = [
        f"{p},{'ab'[p % 2]},{1 + p // 4},{t + 1},{('con', 'inc')[(t + p) % 2]},{int(t % 7 > 0)},"
        f"{0.5 + 0.013 * ((7 * t + 3 * p) % 23)}"
        for p in range(1, 13)
        for t in range(20)
    ]
    proposal = proposal_of(tmp_path, "pno,condition,study,trialnum,congruency,acc,rt", rows)
    for line in ("subject", "pno"), ("environment", "congruency"), ("trial", "trialnum"):
        assert f'\n{line[0]} = "{line[1]}"  # ' in proposal.text
    assert '\nrt_adj = "rt"  # ' in proposal.text


def test_a_dose_may_be_the_condition_and_an_animal_the_subject(tmp_path):
    rows = [
        f"{5 + 3 * d + r + 0.5 * t},{6.25 * 2**d},{'CM'[t]}{r},{('Control', 'MDL')[t]},R{r}"
        for t in (0, 1)
        for r in range(1, 6)
        for d in range(6)
    ]
    proposal = proposal_of(tmp_path, "BPchange,Dose,Run,Treatment,Animal", rows)
    assert '\nsubject = "Animal"  # ' in proposal.text
    assert '\nbpchange_adj = "BPchange"  # ' in proposal.text
    assert '# To tell them apart: environment = ["Dose", "Treatment"]' in proposal.text


def test_a_side_is_the_condition_and_numbers_of_dogs_are_subjects(tmp_path):
    rows = [
        f"{dog},{side},{day},{1040.8 + 5 * dog + day + 3 * (side == 'L')}"
        for dog in range(1, 11)
        for side in "RL"
        for day in (0, 1, 2, 4, 6)[: 2 + dog % 4]
    ]
    proposal = proposal_of(tmp_path, "Dog,Side,day,pixel", rows)
    for line in ("subject", "Dog"), ("environment", "Side"), ("pixel_adj", "pixel"):
        assert f'\n{line[0]} = "{line[1]}"  # ' in proposal.text


def test_a_rating_of_few_values_is_the_response_and_ids_of_others_are_not(tmp_path):
    rows = [
        f"{s},{1000 + (37 * s + 11 * i) % 90},{2 * (s % 3)},{i % 2},{1 + (s * 3 + i * i) % 5}"
        for s in range(1, 41)
        for i in range(10)
    ]
    proposal = proposal_of(tmp_path, "s,d,studage,service,y", rows)
    for line in ("subject", "s"), ("environment", "service"), ("y_adj", "y"):
        assert f'\n{line[0]} = "{line[1]}"  # ' in proposal.text


def test_a_reference_that_nobody_filled_in_is_refused_and_a_true_zero_is_not():
    given = {"environments": {"a": {"k_ref": "?"}}}
    with pytest.raises(UsageError, match=r"is not filled in: .* a reference of zero is 0\.0"):
        ReadOptions.from_mapping(given)
    given["environments"]["a"]["k_ref"] = 0.0
    assert ReadOptions.from_mapping(given).environments["a"]["k_ref"] == 0.0


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


def test_kinds_of_files_in_a_folder_are_named(tmp_path):
    for s in range(1, 7):
        rows = [f"{s},{c},{50 + s + t}" for t, c in enumerate("abc")]
        (tmp_path / f"s{s}.csv").write_text("\n".join(["subject,condition,estimate", *rows]))
    for s in (1, 2):
        (tmp_path / f"q{s}.csv").write_text("item,answer\nhow,fine\n")
    text = propose_columns(tmp_path).text
    assert "# There are 2 kinds of files, by their columns. This is of 6 files:" in text
    assert "# not of 2 files such as 'q1.csv':" in text
    assert "item" in text
    assert "[sessions.files] include" in text


def test_without_a_response_the_proposal_says_what_to_write(tmp_path):
    rows = [f"{s},{c}" for s in range(1, 9) for c in "abc"]
    text = proposal_of(tmp_path, "subject,condition", rows).text
    assert "NAME" not in text
    assert "# [quantities.rt]" in text
    assert '# rt_adj = "rt"' in text

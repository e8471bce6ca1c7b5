import pytest

from percept import Scene
from percept.batch import StudySource, sources
from percept.errors import UsageError
from tests.batch.conftest import study_text


def source(path, scene=None, **changes):
    return StudySource(str(path), scene or Scene(), changes)


def test_a_folder_goes_with_the_files_below_it_and_a_scene_of_its_own(tmp_path):
    (tmp_path / "lab" / "day1").mkdir(parents=True)
    (tmp_path / "lab" / "day1" / "s.csv").write_text(study_text(1).replace("S", "A"))
    (tmp_path / "lab" / "t.csv").write_text(study_text(2))
    (tmp_path / "lab" / "scene.toml").write_text("[inference]\nlevel = 0.9\nseed = 4\n")
    study = (
        source(tmp_path / "lab", Scene().with_inference(level=0.5), seed=7, level=None).read().study
    )
    assert sorted(study.sessions.subjects) == ["A0", "A1", "A2", "S0", "S1", "S2"]
    assert (study.scene.inference.level, study.scene.inference.seed) == (0.9, 7)


def test_everything_the_rows_depend_on_is_in_the_key(tmp_path, monkeypatch):
    path, other = tmp_path / "s.csv", tmp_path / "t.csv"
    path.write_text(study_text(1))
    other.write_text(study_text(1))
    key = source(path).key()
    assert source(path).key() == key
    others = [
        source(path, seed=2).key(),
        source(path, Scene().with_inference(level=0.9)).key(),
        source(other).key(),
    ]
    path.write_text(study_text(1) + " ")
    others.append(source(path).key())
    path.write_text(study_text(1))
    monkeypatch.setattr("percept.batch.numbers_version", lambda *parts: "other")
    others.append(source(path).key())
    assert len({key, *others}) == 6


def test_what_cannot_be_read_names_the_path(tmp_path):
    with pytest.raises(UsageError, match=r"nowhere\.csv: there is no such file"):
        source(tmp_path / "nowhere.csv").key()
    (tmp_path / "scene.toml").write_text("[inference]\nlevel = 2\n")
    with pytest.raises(UsageError, match=r"scene.toml, inference.level = 2"):
        source(tmp_path).key()


def test_no_study_and_standard_input_are_wrong_usage():
    with pytest.raises(UsageError, match="no study was given"):
        sources([])
    # One study of all these files would be another one.
    with pytest.raises(UsageError, match=r"'lab/\*.csv': a batch takes paths, not patterns"):
        sources(["lab/*.csv"])
    assert [one.path for one in sources(["a", "b", "a"])] == ["a", "b"]

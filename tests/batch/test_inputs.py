import pytest

from percept import Scene
from percept.batch import StudySource, sources
from percept.errors import UsageError
from tests.batch.conftest import study_text


def source(path, scene=None, **changes):
    return StudySource(str(path), scene or Scene(), changes)


def test_a_file_goes_with_its_bytes_and_its_own_name(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text(study_text(1))
    files = source(path).read()
    assert files.files == (("s.csv", path.read_bytes()),)
    assert files.root + files.files[0][0] == str(path)


def test_a_folder_goes_with_the_files_below_it_and_a_scene_of_its_own(tmp_path):
    (tmp_path / "lab" / "day1").mkdir(parents=True)
    (tmp_path / "lab" / "day1" / "s.csv").write_text("a")
    (tmp_path / "lab" / "t.csv").write_text("b")
    (tmp_path / "lab" / "scene.toml").write_text("[inference]\nlevel = 0.9\nseed = 4\n")
    files = source(tmp_path / "lab", Scene().with_inference(level=0.5), seed=7, level=None).read()
    assert dict(files.files) == {"day1/s.csv": b"a", "t.csv": b"b"}
    assert all((tmp_path / "lab" / name).read_bytes() == data for name, data in files.files)
    assert files.root == f"{tmp_path / 'lab'}/"
    assert files.scene["inference"]["level"] == 0.9
    assert files.scene["inference"]["seed"] == 7


def test_each_match_of_a_pattern_is_a_study_as_a_shell_would_have_it(tmp_path):
    for day in ("b", "a"):
        (tmp_path / day).mkdir()
        (tmp_path / day / "s.csv").write_text(day)
    paths = [str(tmp_path / day / "s.csv") for day in ("a", "b")]
    assert [one.path for one in sources([str(tmp_path / "*" / "s.csv"), paths[0]])] == paths
    (tmp_path / "x*").mkdir()
    assert [one.path for one in sources([str(tmp_path / "x*")])] == [str(tmp_path / "x*")]
    (tmp_path / "notes.md").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "res").mkdir()
    for name in ("batch.parquet", "s.csv"):
        (tmp_path / "res" / name).write_text("")
    assert [one.path for one in sources([str(tmp_path / "?*")])] == [
        str(tmp_path / day) for day in ("a", "b")
    ]
    with pytest.raises(UsageError, match="no table and no folder of tables fits the pattern"):
        sources([str(tmp_path / "nowhere*")])


def test_everything_the_rows_depend_on_is_in_the_key(tmp_path, monkeypatch):
    path, other = tmp_path / "s.csv", tmp_path / "t.csv"
    path.write_text(study_text(1))
    other.write_text(study_text(1))
    key = source(path).read().key
    assert source(path).read().key == key
    others = [
        source(path, seed=2).read().key,
        source(path, Scene().with_inference(level=0.9)).read().key,
        source(other).read().key,
    ]
    path.write_text(study_text(1) + " ")
    others.append(source(path).read().key)
    path.write_text(study_text(1))
    monkeypatch.setattr("percept.batch.numbers_version", lambda *parts: "other")
    others.append(source(path).read().key)
    assert len({key, *others}) == 6


def test_what_cannot_be_read_names_the_path(tmp_path):
    with pytest.raises(UsageError, match=r"nowhere\.csv: there is no such file"):
        source(tmp_path / "nowhere.csv").read()
    (tmp_path / "scene.toml").write_text("[inference]\nlevel = 2\n")
    with pytest.raises(UsageError, match=r"scene.toml, inference.level = 2"):
        source(tmp_path).read()


def test_no_study_and_standard_input_are_wrong_usage():
    with pytest.raises(UsageError, match="no study was given"):
        sources([])
    with pytest.raises(UsageError, match="standard input"):
        sources(["a.csv", "-"])
    assert [one.path for one in sources(["a", "b", "a"])] == ["a", "b"]

import dataclasses
import tomllib
from importlib import resources

import numpy as np
import pytest
from scipy import stats

from percept.cli import main
from percept.inference.model.priors import Priors
from percept.scene import FrequencyTable, InferenceTable, ModelTable, ReportTable, Scene
from percept.sessions.options import canonical_columns
from tests.documents import with_rows

# Two keys describe the device in another way, and two belong together.
INSTEAD = ("mass", "damping", "modes", "delay_seconds", "posterior")


def switched_on(text):
    """The file with every optional key in use, but for one of two that exclude each other."""
    assert text.count('#: trial = "order"') == 1
    return text.replace('#: trial = "order"', '# trial = "order"').replace("#: ", "")


def written(tmp_path):
    path = tmp_path / "scene.toml"
    assert main(["new", str(path)]) == 0
    return path


def test_the_file_is_a_scene_of_defaults(tmp_path, capsys):
    path = written(tmp_path)
    scene = Scene.load(path)
    assert capsys.readouterr().out == f"{path}\n"
    assert scene.frequency == FrequencyTable()
    assert scene.inference == InferenceTable()
    assert scene.model == ModelTable()
    assert scene.report == ReportTable()
    # An invented device or coupling would be judged as if it were the user's.
    assert scene.device is None
    assert scene.coupling is None


def test_every_key_of_every_table_is_there(tmp_path):
    tables = tomllib.loads(switched_on(written(tmp_path).read_text(encoding="utf-8")))
    assert set(tables) == set(Scene.model_fields)
    for name in ("device", "coupling", "frequency", "inference", "model", "study", "report"):
        annotation = Scene.model_fields[name].annotation
        model = next(
            (part for part in getattr(annotation, "__args__", ()) if part is not type(None)),
            annotation,
        )
        assert set(tables[name]) == set(model.model_fields), name
    assert tables["model"]["priors"] == pytest.approx(dataclasses.asdict(Priors()), rel=1e-15)
    assert set(tables["columns"]) == set(canonical_columns(("k", "b")))


def test_every_optional_key_is_understood(tmp_path):
    path = written(tmp_path)
    tables = tomllib.loads(switched_on(path.read_text(encoding="utf-8")))
    for key in INSTEAD:
        del tables["device"][key]
    scene = Scene(**tables)
    assert scene.device.response == "zd.csv"
    assert scene.report.subtitle == "Ten people, five walls"
    assert {*tables["sessions"], "trial"} == type(scene.sessions).model_fields.keys()
    assert scene.columns["subject"].name == "participant"
    assert scene.sessions.exclude[0].above == 1e5
    assert scene.environments["A"] == {"k_ref": 1000.0, "b_ref": 1.0, "m_ref": 0.0}
    assert scene.quantities["duration"].unit == "ms"


def test_one_line_makes_it_the_scene_of_another_quantity(tmp_path):
    path = written(tmp_path)
    text = path.read_text(encoding="utf-8")
    (line,) = [line for line in text.splitlines() if line.startswith("#: duration =")]
    path.write_text(text.replace(line, line.removeprefix("#: ")), encoding="utf-8")
    assert set(Scene.load(path).quantities) == {"duration"}


def test_a_file_that_is_there_stays(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    path.write_text("mine")
    assert main(["new", str(path)]) == 2
    error = capsys.readouterr().err
    assert "scene.toml" in error
    assert "already there" in error
    assert path.read_text() == "mine"


def test_a_folder_that_is_not_there_is_named(tmp_path, capsys):
    assert main(["new", str(tmp_path / "nowhere" / "scene.toml")]) == 2
    assert "nowhere" in capsys.readouterr().err


def test_the_template_is_part_of_the_package():
    assert resources.files("percept.commands").joinpath("scene.toml").is_file()


def matches(tmp_path, unit):
    """A file with names of its own, of six people who match two lengths."""
    path = tmp_path / "my lengths.csv"
    rows = [f"{p},{w},{r},{r + p / 10}" for p in range(6) for w, r in (("a", 10), ("b", 20))]
    path.write_text("\n".join([f"pid,cond,true {unit},resp {unit}", *rows]) + "\n")
    return path


def test_a_scene_from_data_says_what_is_left_and_what_comes_next(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    data = matches(tmp_path, "")
    assert main(["new", str(path), "--from", str(data)]) == 0
    said = capsys.readouterr()
    assert said.out == f"{path}\n"
    next_command = f"percept report '{data}' --scene {path} --out results"
    last = said.err.splitlines()[-1]
    assert last == f'percept: 1 line to edit: replace each "?". Then run: {next_command}'
    assert said.err.startswith(path.read_text())
    assert main(["validate", str(data), "--scene", str(path)]) == 2
    assert "quantities.response.unit = '?': is not filled in." in capsys.readouterr().err


def test_a_scene_from_data_that_lacks_nothing_is_followed(tmp_path, capsys):
    path = tmp_path / "scene.toml"
    data = matches(tmp_path, "[mm]")
    command = ["fit", str(data), "--method", "classical", "--out", str(tmp_path / "fit")]
    assert main(command) == 2
    assert f"percept new scene.toml --from '{data}'" in capsys.readouterr().err
    assert main(["new", str(path), "--from", str(data)]) == 0
    assert "percept: Look through it. Then run: percept report" in capsys.readouterr().err
    assert main([*command, "--scene", str(path)]) == 0
    intervals = with_rows((tmp_path / "fit" / "fit.json").read_text())["intervals"]
    (mean,) = [
        own
        for own in intervals
        if own["environment"] == "a"
        and (own["kind"], own["family"], own["joint"]) == ("mean", "normal", "marginal")
    ]
    settings = [10 + p / 10 for p in range(6)]
    expected = stats.t.interval(0.99, 5, np.mean(settings), stats.sem(settings))
    np.testing.assert_allclose([mean["lower"], mean["upper"]], expected, rtol=1e-12)

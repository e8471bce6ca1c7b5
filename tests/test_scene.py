"""Scenes: what is refused is named with file, table and key."""

import math

import pytest

from percept.errors import UsageError
from percept.scene import Scene


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "[devic]\n",
            "devic: there is no such key; there are quantities, columns, environments, sessions,",
        ),
        (
            "[inference]\nlevle = 0.9\n",
            "inference.levle = 0.9: there is no such key; there are level, share",
        ),
        ("[inference]\nlevle = 0.9\n", "most_steps. Did you mean level?"),
        ("[devic]\n", "Did you mean device?"),
        ("[model.priors]\ntau_scal = 1\n", "Did you mean tau_scale?"),
        ("[environments.A]\nk_rf = 1\n", "Did you mean k_ref?"),
        (
            "[device]\nmass = 1\ndamping = -2\nperiod = 1e-3\n",
            "device.damping = -2: must be 0 or more.",
        ),
        (
            "[device]\nmass = 1\ndamping = 2\nperiod = 0.0\n",
            "device.period = 0.0: must be above 0.",
        ),
        (
            "[inference]\nmost_steps = 200.5\n",
            "inference.most_steps = 200.5: must be a whole number.",
        ),
        (
            "[device]\nmass = 1\ndamping = 2\nperiod = 1e-3\nmodes = [{ weight = 1 }]\n",
            "device.modes.0.weight = 1: there is no such key; there are mass, stiffness, damping.",
        ),
        (
            (
                "[device]\nmass = 1\ndamping = 2\nperiod = 1e-3\nmodes = [{ mass = 1, stiffness ="
                " 1, x = 2 }]\n"
            ),
            "device.modes.0.x = 2: there is no such key; there are mass, stiffness, damping.",
        ),
        ("[device]\nmass = 1\n", "device.period: is missing."),
        (
            "[device]\nmass = true\ndamping = 2\nperiod = 1e-3\n",
            "device.mass = True: must be a number.",
        ),
        ('[model]\nweber = "yes"\n', "model.weber = 'yes': must be true or false."),
        (
            '[device]\nmass = 1\ndamping = 2\nresponse = "zd.csv"\nperiod = 1e-3\n',
            "device: a measured response holds mass, damping, stiffness and modes: give one",
        ),
        (
            "[inference]\nlevel = 99\n",
            "inference.level = 99: must lie between 0 and 1; 99 percent is written 0.99.",
        ),
        (
            "[inference]\ndecision = 0.5\n",
            "inference.decision = 0.5: must be above 0.5.",
        ),
        (
            "[inference]\ndecision = 1.0\n",
            "inference.decision = 1.0: must be below 1.",
        ),
        (
            '[inference]\nfamily = "log"\n',
            "inference.family = 'log': must be 'lognormal' or 'normal'.",
        ),
        ("[frequency]\nlower = 5\nupper = 1\n", "frequency: lower, 5, must be below upper, 1."),
        (
            "[device]\nmass = 1\ndamping = 2\nperiod = 0.05\n",
            (
                "frequency.upper = 100.0: does not lie below the Nyquist frequency, 62.8319 rad/s"
                " at a period of 0.05 s. Set upper of [frequency] below that"
            ),
        ),
        (
            '[model]\npooling = "none"\n',
            'model: pooling = "none" and prior = "reference" go together.',
        ),
        (
            '[model]\npooling = "none"\nprior = "reference"\nresolution = { k = 1.0 }\n',
            'model: resolution goes with pooling = "partial".',
        ),
        (
            "[model.priors]\ntau = 1\n",
            "model.priors.tau = 1.0: there is no such key; there are alpha_sd,",
        ),
        (
            '[model.priors]\ntau_scale = "2"\n',
            "model.priors.tau_scale = '2': must be a number.",
        ),
        (
            "[model.priors]\ntau_scale = true\n",
            "model.priors.tau_scale = True: must be a number.",
        ),
        ("[device]\nmass = 1\nperiod = 1e-3\n", "device: give mass and damping, or response."),
        (
            '[device]\nmass = 1\nresponse = "zd.csv"\nperiod = 1e-3\n',
            "device: a measured response holds mass, damping, stiffness and modes: give one",
        ),
        (
            "[model.priors]\ntau_scale = -3\n",
            "a prior scale must be positive. Leave it out of the scene",
        ),
        (
            "[inference]\nkinds = []\n",
            "inference.kinds = []: give at least one, or leave the key out.",
        ),
        ('[inference]\nparameters = ["k", "k"]\n', "k stands there twice."),
        (
            "x =\n",
            (
                "is not TOML: Invalid value (at line 1, column 4). Text stands in quotes, and"
                " numbers begin with"
            ),
        ),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, said):
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError) as caught:
        Scene.load(path)
    assert caught.value.file == str(path)
    assert said in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(UsageError, match=r"nowhere\.toml: cannot be read: No such file"):
        Scene.load(tmp_path / "nowhere.toml")


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        (
            {"columns": {"stiff": "k"}},
            "columns.stiff: there is no such key; there are subject, session,",
        ),
        (
            {"sessions": {"comma": ","}},
            "sessions.comma = ',': there is no such key; there are decimal, delimiter",
        ),
        ({"sessions": {"decimal": "x"}}, "sessions.decimal = 'x': must be '.' or ','."),
        (
            {"environments": {"A": {"k": 3}}},
            "environments.A.k: there is no such key; there are k_ref, b_ref, m_ref.",
        ),
        ({"environments": {"A": 3}}, "environments.A = 3: must be a table."),
        (
            {"columns": {"b_ref": {"name": "b", "unit": "N/m"}}},
            "columns.b_ref.unit = 'N/m': not a unit of damp",
        ),
    ],
)
def test_how_sessions_are_read_is_checked_with_the_scene(tables, said):
    with pytest.raises(UsageError) as caught:
        Scene(**tables)
    assert str(caught.value).startswith(said)


def test_a_scene_of_its_own_tables_is_the_same():
    tables = {
        "columns": {"k_adj": "final", "b_adj": {"name": "b", "unit": "N·s/mm"}},
        "sessions": {"decimal": ",", "exclude": [{"column": "rt", "above": 60}], "groups": "hand"},
        "environments": {"A": {"k_ref": 10}},
    }
    scene = Scene(**tables)
    assert Scene(**scene.to_dict()) == scene


def test_replacing_a_setting_keeps_the_rest_and_checks_it():
    scene = Scene(inference={"level": 0.9, "seed": 4}, sessions={"decimal": ","})
    changed = scene.with_inference(level=0.95, tolerance=None)
    assert (changed.inference.level, changed.inference.seed, changed.sessions.decimal) == (
        0.95,
        4,
        ",",
    )
    assert scene.inference.level == 0.9
    with pytest.raises(UsageError, match=r"inference\.tolerance = 2"):
        scene.with_inference(tolerance=2)


def test_the_share_held_is_that_of_verdicts_unless_given():
    assert Scene(inference={"level": 0.9}).inference.share == 0.99
    assert Scene(verdict={"central": 0.9}).inference.share == 0.9
    assert Scene(verdict={"central": 0.9}, inference={"share": 0.8}).inference.share == 0.8


def test_what_is_none_or_left_out_is_not_handed_on():
    plain = Scene().to_dict()
    assert "device" not in plain
    assert "parameters" not in plain["inference"]
    assert Scene(**plain) == Scene()


def test_frequencies_end_below_nyquist():
    device = {"mass": 1.0, "damping": 5.0, "period": 1e-3}
    scene = Scene(device=device, frequency={"upper": 3141.592})
    for upper in (math.pi / 1e-3, math.nextafter(math.pi / 1e-3, 0.0), 3141.6):
        with pytest.raises(UsageError, match="not lie below the Nyquist frequency"):
            scene.with_tables(frequency={"upper": upper})
    # Without a device nothing is sampled.
    assert Scene(frequency={"upper": 3141.6}).frequency.upper == 3141.6


def test_stiffness_comes_first_and_the_average_user():
    scene = Scene(inference={"parameters": ["b", "k"], "kinds": ["share", "mean"]})
    assert scene.inference.parameters == ("k", "b")
    assert scene.inference.kinds == ("mean", "share")


@pytest.mark.parametrize(
    ("lower", "upper", "at"),
    [(0.1, 100.0, 10.0), (10.0, 20.0, 10.0), (1.0, 4.0, 2.0), (20.0, 80.0, 40.0)],
)
def test_single_values_are_read_where_the_curves_are(lower, upper, at):
    scene = Scene(frequency={"lower": lower, "upper": upper})
    assert scene.frequency.read_at == pytest.approx(at, rel=1e-15)


def test_a_path_is_told_how_a_file_is_read():
    with pytest.raises(
        UsageError, match=r"a scene's file is read by Scene\.load\('scene\.toml'\)\."
    ):
        Scene("scene.toml")


def test_keyword_arguments_are_refused_as_tables_are():
    with pytest.raises(
        UsageError, match=r"inference\.tolerence = 0\.1: there is no such key; there are"
    ):
        Scene(inference={"tolerence": 0.1})
    with pytest.raises(
        UsageError, match="self: there is no such key; there are quantities, columns"
    ):
        Scene(self={})
    with pytest.raises(
        UsageError, match=r"frequency\.upper = 4000\.0: does not lie below the Nyquist frequency"
    ):
        Scene(device={"mass": 0.1, "damping": 0.1, "period": 1e-3}, frequency={"upper": 4000.0})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[inference]\nlevel = 1e-300", "inference.level = 1e-300: must be 1e-06 or more."),
        (
            "[frequency]\nlower = 1e-300",
            "frequency.lower = 1e-300: must be between 1e-100 and 1e+100 in size.",
        ),
        ("[frequency]\nlower = 1e-10", "frequency.lower = 1e-10: must be 1e-09 or more."),
        (
            "[coupling]\nstiffness = 1e300\ndamping = 1.0",
            "coupling.stiffness = 1e+300: must be between 1e-100 and 1e+100 in size.",
        ),
        ("x = " + "[" * 5000 + "]" * 5000, "is not TOML: "),
        ("x = " + "{a = " * 5000 + "1" + "}" * 5000, "is not TOML: "),
        ("x = " + "9" * 5000, "is not TOML: "),
        (
            "[inference]\nlevel = " + "9" * 4000,
            f"inference.level = {'9' * 200}…: must be a number.",
        ),
        ("[inference]\nseed = 0x" + "f" * 5000, f"inference.seed = 0x{'f' * 198}…: must be"),
    ],
    ids=["level", "lower", "exact", "stiffness", "lists", "tables", "digits", "clipped", "hex"],
)
def test_hostile_numbers_and_nesting_are_refused(tmp_path, text, said):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(UsageError) as caught:
        Scene.load(path)
    assert said in str(caught.value)
    assert len(str(caught.value)) < 500

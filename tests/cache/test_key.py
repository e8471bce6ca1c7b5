from importlib import metadata

import numpy as np
import pytest

from percept import Scene, Study, read_sessions
from percept.cache import digest, numbers_version
from percept.inference.model.priors import MEANINGS

HEADER = "subject,environment,k_ref,b_ref,trial,k_adj,b_adj\n"


def sessions_file(folder, change=0.0, *, extra=""):
    rng = np.random.default_rng(3)
    rows = []
    for subject in range(4):
        for name, k, b in (("A", 100.0, 1.0), ("B", 1000.0, 9.0)):
            for trial in (1, 2):
                k_adj, b_adj = k * np.exp(rng.normal(0, 0.1)), b * np.exp(rng.normal(0, 0.2))
                if subject == 2 and name == "B" and trial == 2:
                    k_adj += change
                rows.append(
                    f"S{subject},{name},{k},{b},{trial},{k_adj!r},{b_adj!r}".replace(
                        "np.float64", ""
                    )
                )
    path = folder / "study.csv"
    text = HEADER + "\n".join(rows).replace("(", "").replace(")", "") + "\n" + extra
    path.write_text(text)
    return path


def question(path, **model):
    """What a study's fit asks a store, taken from the study itself."""
    asked = []

    class Listening:
        def find(self, question):
            asked.append(digest(*question))
            raise StopIteration

    inference = model.pop("inference", {})
    scene = Scene(inference={"tolerance": 0.2, **inference}, model=model)
    with pytest.raises(StopIteration):
        _ = Study(read_sessions(path), scene, store=Listening()).fit
    return asked[0]


@pytest.fixture(scope="module")
def key(tmp_path_factory):
    return question(sessions_file(tmp_path_factory.mktemp("key")))


def test_equal_questions_have_equal_keys(tmp_path, key):
    """In any process: in test_command one finds what another has kept."""
    assert question(sessions_file(tmp_path)) == key


@pytest.mark.parametrize(
    "changed",
    [
        {"inference": {"seed": 2}},
        {"inference": {"tolerance": 0.1}},
        {"inference": {"level": 0.95}},
        {"inference": {"confidence": 0.9}},
        {"inference": {"kinds": ["mean"]}},
        {"inference": {"family": "normal"}},
        {"inference": {"parameters": ["k"]}},
        {"inference": {"most_steps": 400}},
        *({"priors": {name: 0.4}} for name in MEANINGS),
        {"weber": True},
        {"common_spread": True},
        {"subject_effect": False},
        {"pooling": "none", "prior": "reference"},
    ],
    ids=str,
)
def test_every_setting_that_moves_a_number_moves_the_key(tmp_path, key, changed):
    assert question(sessions_file(tmp_path), **changed) != key


def test_the_last_bit_of_one_adjustment_moves_the_key(tmp_path, key):
    assert question(sessions_file(tmp_path, change=1e-9)) != key


def test_what_moves_no_number_leaves_the_key(tmp_path, key):
    path = sessions_file(tmp_path)
    text = path.read_text()
    path.write_text(text.replace(",", ";"))
    assert question(path) == key
    # A step that no cell has a use for.
    assert question(path, resolution={"k": 1.0}) == key


@pytest.mark.parametrize(
    "value",
    [len, object(), np.array([None]), Study],
    ids=["function", "object", "objects", "class"],
)
def test_what_has_no_plain_value_has_no_digest(value):
    with pytest.raises(TypeError, match="has no digest"):
        digest(value)


def test_the_version_names_the_packages_and_follows_the_code(tmp_path):
    version = numbers_version("inference")
    for package in ("numpy", "scipy", "emcee"):
        assert f"{package}': '{metadata.version(package)}'" in version
    assert numbers_version("inference", "study") != version

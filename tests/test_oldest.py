from pathlib import Path

import pytest

from tests.oldest import oldest

HEAD = (
    '[project]\ndependencies = ["numpy>=2.0"{more}]\n[project.optional-dependencies]\ncluster ='
    " []\n"
)
HEAD += 'tables = ["a_b.c[x,y]>=1.2,<2"]\ntest = ["pytest >= 8"]\n'


def test_lower_bounds_of_dependencies_and_the_extras_under_test():
    assert oldest(HEAD.format(more="")) == ["a_b.c==1.2", "numpy==2.0", "pytest==8"]


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (', "scipy"', "'scipy' has no lower bound"),
        (', "a_b.c>=1"', "a_b.c has two lower bounds, 1 and 1.2"),
    ],
)
def test_what_cannot_be_held_is_said(more, message):
    with pytest.raises(ValueError, match=message):
        oldest(HEAD.format(more=more))


def test_our_own_bounds_are_all_there():
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    names = {line.split("==")[0] for line in oldest(text)}
    assert {"numpy", "scipy", "emcee", "dask", "pyarrow", "pytest"} <= names

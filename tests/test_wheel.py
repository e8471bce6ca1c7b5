"""The wheel that is built from this tree."""

import subprocess
import sys
import zipfile

import pytest

from tests import DATASETS


@pytest.mark.evidence
def test_a_wheel_holds_the_package_and_nothing_else(tmp_path):
    """pip fetches what builds it, which takes a network."""
    words = ["wheel", "--quiet", "--no-deps", "--wheel-dir", str(tmp_path), str(DATASETS.parent)]
    subprocess.run([sys.executable, "-m", "pip", *words], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    folders = {name.partition("/")[0] for name in names}
    metadata = {folder for folder in folders if folder.endswith(".dist-info")}
    assert folders - metadata == {"percept"}
    assert "percept/datasets/hbfd.toml" in names

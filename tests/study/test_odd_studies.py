"""Random odd studies, each taken to a page or a refusal with Python's warnings as errors."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

DEVICE = """
[device]
mass = 1.0
damping = 5.0
period = 0.001
[coupling]
stiffness = 50e3
damping = 100.0
"""
#: Seconds that a study may take.
LIMIT = 90.0


def odd_study(seed):
    """A study's table and scene: 2 to 6 subjects, SDs of the logarithms from 1e-4 to 3."""
    rng = np.random.default_rng(seed)
    subjects = rng.integers(2, 7)
    environments = rng.integers(1, 5)
    trials = rng.integers(1, 5)
    log_sd = 10.0 ** rng.uniform(-4.0, np.log10(3.0))
    missing = rng.choice([0.0, 0.2], p=[0.7, 0.3])
    levels = ("left", "right") if rng.random() < 0.3 else ("",)
    device = DEVICE if rng.random() < 0.5 else ""
    family = rng.choice(["lognormal", "normal"])
    rows = []
    for subject in range(subjects):
        effect = rng.normal(0.0, log_sd, 2)
        for environment in range(environments):
            reference = np.array([100.0, 1.0]) * 10.0**environment
            for level in levels:
                cell = effect + rng.normal(0.0, log_sd, 2)
                for trial in range(1, trials + 1):
                    settings = reference * np.exp(cell + rng.normal(0.0, 0.5 * log_sd, 2))
                    if rng.random() >= missing:
                        names = [f"S{subject}", f"VE{environment}", level, trial]
                        rows.append([*names, *reference, *settings])
    columns = ["subject", "environment", "hand", "trial", "k_ref", "b_ref", "k_adj", "b_adj"]
    table = pd.DataFrame(rows, columns=columns)
    factor = '[study]\nfactor = "hand"\n'
    if len(levels) == 1:
        table = table.drop(columns="hand")
        factor = ""
    return table, f'{factor}[inference]\nfamily = "{family}"\n{device}'


@pytest.mark.evidence
@pytest.mark.parametrize("seed", range(1, 81))
def test_an_odd_study_ends_in_a_page_or_a_refusal(seed, tmp_path):
    table, scene = odd_study(seed)
    table.to_csv(tmp_path / "odd.csv", index=False)
    (tmp_path / "scene.toml").write_text(scene, encoding="utf-8")
    percept = [sys.executable, "-W", "error", "-m", "percept", "report", "odd.csv"]
    done = subprocess.run(
        [*percept, "--scene", "scene.toml", "--out", "out", "--seed", "1", "--quiet"],
        cwd=tmp_path,
        # The package is found from here, not from the study's folder.
        env=os.environ | {"PYTHONPATH": str(Path.cwd())},
        timeout=LIMIT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Traceback" not in done.stderr
    if done.returncode == 0:
        assert (tmp_path / "out" / "report.html").stat().st_size > 0
    else:
        # A refusal names what is wrong, of the analysis (1) or of the file (2), and leaves no page.
        assert done.returncode in (1, 2)
        assert "percept: " in done.stderr
        assert not (tmp_path / "out" / "report.html").exists()

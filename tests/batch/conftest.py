import numpy as np
import pytest

HEADER = "subject,environment,k_ref,b_ref,k_adj,b_adj\n"


def study_text(seed, *, subjects=3, noise=0.15):
    """A small study: stiffness and damping in one environment."""
    rng = np.random.default_rng(seed)
    rows = []
    for subject in range(subjects):
        k, b = 1000 * np.exp(rng.normal(0, noise)), 5 * np.exp(rng.normal(0, noise))
        rows.append(f"S{subject},VE1,1000,5,{k:.6g},{b:.6g}")
    return HEADER + "\n".join(rows) + "\n"


@pytest.fixture
def studies(tmp_path):
    """Paths of four sound studies, one with text in a number, one without a value, one that is
    not there."""
    folder = tmp_path / "studies"
    folder.mkdir()
    for i in range(4):
        (folder / f"s{i}.csv").write_text(study_text(i))
    (folder / "text.csv").write_text(HEADER + "S1,VE1,1000,5,much,4\nS2,VE1,1000,5,900,4\n")
    (folder / "empty.csv").write_text(HEADER + "S1,VE1,1000,5,,\nS2,VE1,1000,5,,\n")
    return [
        str(folder / name)
        for name in ("s0.csv", "s1.csv", "text.csv", "s2.csv", "empty.csv", "s3.csv")
    ] + [str(folder / "missing.csv")]

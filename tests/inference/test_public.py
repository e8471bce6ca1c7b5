import json
import subprocess
import sys

import percept.inference

NAMES = [
    "Interval",
    "Moments",
    "check_normality",
    "prediction_interval",
    "t_interval",
    "tolerance_factor",
    "tolerance_interval",
]


def test_the_public_names():
    assert percept.inference.__all__ == NAMES
    assert {getattr(percept.inference, name).__name__ for name in NAMES} == set(NAMES)


def test_an_interval_imports_no_sampler_no_table_and_no_plot():
    program = (
        "import json, sys; from percept.inference import t_interval, tolerance_interval;"
        "t_interval([1.0, 2.0, 4.0]); tolerance_interval([1.0, 2.0, 4.0]);"
        "print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"
    )
    output = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout
    loaded = set(json.loads(output))
    assert {"numpy", "scipy"} <= loaded
    assert not loaded & {"emcee", "arviz_base", "arviz_stats", "pandas", "matplotlib", "xarray"}

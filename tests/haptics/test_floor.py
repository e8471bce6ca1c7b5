"""The haptics module stands on numpy alone, and its public names are fixed."""

import subprocess
import sys

import percept.haptics

PUBLIC = """
Coupling Device Environment Loop Mode TabulatedDevice VelocityFilter
absolute_stability can_render corner_curves coupling_impedance device_impedance effective_impedance
environment_impedance hold magnitude_envelope max_coupling_stiffness needed_damping
perceived_impedance
required_damping required_damping_at stability_margin
"""


def test_public_names_are_these():
    assert percept.haptics.__all__ == PUBLIC.split()


def test_imports_numpy_only():
    code = (
        "import sys; before = set(sys.modules); import percept.haptics;"
        "print(*sorted({name.split('.')[0] for name in set(sys.modules) - before}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) - set(sys.stdlib_module_names) == {"percept", "numpy"}


def test_brings_no_other_part_of_percept():
    code = (
        "import sys, percept.haptics; print(*(n for n in sys.modules if n.startswith('percept.')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    parts = {name.split(".")[1] for name in done.stdout.split()}
    assert parts == {"haptics", "html", "errors", "minima", "roots"}

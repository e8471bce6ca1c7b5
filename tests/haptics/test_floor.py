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


def test_imports_numpy_and_no_other_part_of_percept():
    code = "import sys; before = set(sys.modules); import percept.haptics;"
    code += "print(*(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    names = [name.split(".") for name in done.stdout.split()]
    packages = {first for first, *_ in names} - set(sys.stdlib_module_names)
    assert packages == {"percept", "numpy"}
    parts = {rest[0] for first, *rest in names if first == "percept" and rest}
    assert parts == {"haptics", "html", "errors", "minima", "roots"}

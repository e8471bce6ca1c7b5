"""The public names of haptics are fixed."""

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

"""Coverage over simulated logs; `reports/coverage/devices.md` holds 1,000 of each device."""

import pytest

import tests
from tests.identify.coverage import LOGS, MOST_ERRORS, calibration, coverage
from tests.identify.simulated import DEVICES

#: Logs of each device in `make test`.
FEW = 40


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("name", DEVICES)
def test_regions_of_mass_and_damping_cover(name):
    found = coverage(name, LOGS if tests.LONG else FEW)
    assert abs(found.deviation) < MOST_ERRORS


@pytest.mark.evidence(reduced=True)
def test_stability_is_as_probable_as_it_says():
    for found in calibration(LOGS if tests.LONG else 5 * FEW):
        assert abs(found.deviation) < MOST_ERRORS, found.name

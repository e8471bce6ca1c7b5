"""Whether a device can render its references directly and stay passive."""

from __future__ import annotations

import pandas as pd

from percept import haptics
from percept.study.apparatus import Apparatus

_COLUMNS = ["environment", "needed_colgate", "needed_paper", "device_damping", "passive"]


def direct_passivity(apparatus: Apparatus) -> pd.DataFrame:
    """Judge one-port passivity of every reference without a coupling."""
    device = apparatus.device
    rows = []
    if isinstance(device, haptics.Device):
        for name, environment in apparatus.references.items():
            colgate = float(haptics.passivity_damping(environment, apparatus.period, model="colgate"))
            paper = float(haptics.passivity_damping(environment, apparatus.period, model="tustin"))
            rows.append((name, colgate, paper, device.damping, bool(device.damping > colgate)))
    return pd.DataFrame(rows, columns=_COLUMNS)

"""What a measurement says of the machine it was made on."""

from __future__ import annotations

import os
import platform
from typing import Any


def machine(loads: tuple[float, float], seconds: float) -> dict[str, Any]:
    """Describe this machine."""
    return {
        "processors": os.cpu_count(), "python": platform.python_version(), "system": platform.system(),
        "architecture": platform.machine(), "load_before": loads[0], "load_after": loads[1],
        "seconds": seconds,
    }  # fmt: skip

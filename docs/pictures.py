"""Draw the pictures of README and docs, with fixed seeds: python docs/pictures.py."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from percept.cli import main
from percept.inference import prediction_interval, t_interval, tolerance_factor, tolerance_interval

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
_NAMES = {
    "mean": "mean: the average user",
    "user": "user: the next user",
    "share": "share: 90 % of users",
}
_COLOURS = {"mean": "#0063a6", "user": "#c44900", "share": "#00784d"}
_MISS = "#b00020"
_LEVEL = 0.90  # Low enough that a picture of 20 studies shows some that miss


def _intervals(values: np.ndarray) -> dict[str, tuple[float, float]]:
    rows = {
        "mean": t_interval(values, level=_LEVEL),
        "user": prediction_interval(values, level=_LEVEL),
        "share": tolerance_interval(values, share=_LEVEL, confidence=_LEVEL),
    }
    return {kind: (row.lower, row.upper) for kind, row in rows.items()}


def kinds(figure: Figure) -> None:
    """Draw one study's users and the three intervals made of them."""
    rng = np.random.default_rng(4)
    users = rng.normal(1.0, 0.15, 10)
    ax = figure.add_subplot()
    ax.plot(users, np.full(10, 3), "o", color="#333", markersize=5, alpha=0.7)
    for y, (kind, (lower, upper)) in enumerate(reversed(_intervals(users).items())):
        ax.plot([lower, upper], [y, y], linewidth=6, color=_COLOURS[kind], solid_capstyle="butt")
    ax.axvline(1.0, color="#333", linestyle="--", linewidth=1)
    ax.set_yticks(range(4), [*reversed(_NAMES.values()), "ten users"])
    ax.set_ylim(-0.6, 3.6)
    ax.set_xlabel("adjusted / reference")


def _kept(kind: str, lower: float, upper: float, next_user: float) -> bool:
    if kind == "mean":
        return lower <= 1.0 <= upper
    if kind == "user":
        return lower <= next_user <= upper
    content = stats.norm.cdf(upper, 1.0, 0.15) - stats.norm.cdf(lower, 1.0, 0.15)
    return bool(content >= _LEVEL)


def studies(figure: Figure) -> None:
    """Draw the same 20 studies three times, each with one kind of interval and what it promises."""
    rng = np.random.default_rng(29)
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    for row in range(20):
        users, next_user = rng.normal(1.0, 0.15, 10), rng.normal(1.0, 0.15)
        for ax, (kind, (lower, upper)) in zip(axes, _intervals(users).items(), strict=True):
            colour = _COLOURS[kind] if _kept(kind, lower, upper, next_user) else _MISS
            ax.plot([lower, upper], [row, row], linewidth=2, color=colour)
            if kind == "user":
                ax.plot(next_user, row, "o", color=colour, markersize=3.5)
    half = stats.norm.isf((1 - _LEVEL) / 2) * 0.15
    for ax, kind in zip(axes, _NAMES, strict=True):
        ax.set_title(_NAMES[kind])
        ax.set_xlabel("adjusted / reference")
        ax.set_yticks([])
    axes[0].axvline(1.0, color="#333", linestyle="--", linewidth=1)
    axes[2].axvspan(1 - half, 1 + half, color=_COLOURS["share"], alpha=0.15, linewidth=0)
    axes[0].set_ylabel("20 studies of 10 users")


def subjects(figure: Figure) -> None:
    """Draw the half-width of each kind against the number of subjects, at 99 %."""
    n = np.unique(np.geomspace(3, 300, 60).round().astype(int))
    t = stats.t.isf(0.005, n - 1)
    ax: Axes = figure.add_subplot()
    widths = {
        "mean": t / np.sqrt(n),
        "user": t * np.sqrt(1 + 1 / n),
        "share": tolerance_factor(n, 0.99, 0.95),
    }
    for kind, width in widths.items():
        ax.loglog(n, width, color=_COLOURS[kind], linewidth=2, label=kind)
    ax.axhline(
        stats.norm.isf(0.005), color="#333", linestyle="--", linewidth=1, label="99 % of all users"
    )
    ax.set_xticks([3, 10, 30, 100, 300], ["3", "10", "30", "100", "300"])
    ax.set_yticks([0.2, 0.5, 1, 2, 5, 10], ["0.2", "0.5", "1", "2", "5", "10"])
    ax.minorticks_off()
    ax.set_xlabel("subjects")
    ax.set_ylabel("half-width (SDs)")
    ax.legend(frameon=False)


#: Figures of the published study's report that README shows.
_REPORTED = ("overview", "ratios")


def _report() -> None:
    """Take figures from the report of the shipped study."""
    data = ROOT / "datasets"
    with TemporaryDirectory() as folder:
        words = ["report", str(data / "hbfd_sessions.csv"), "--scene", str(data / "hbfd.toml")]
        if main([*words, "--no-checks", "--quiet", "--seed", "1", "--out", folder]):
            raise SystemExit("the report failed")
        for name in _REPORTED:
            shutil.copy(Path(folder) / "figures" / f"{name}.svg", PICTURES / f"{name}.svg")


def draw() -> None:
    """Write every picture."""
    matplotlib.rcParams.update(
        {"svg.hashsalt": "percept", "axes.spines.top": False, "font.size": 9}
    )
    matplotlib.rcParams.update({"axes.spines.right": False, "axes.titlesize": 9})
    for picture, size in ((kinds, (6.4, 2.2)), (studies, (8.0, 3.4)), (subjects, (5.2, 3.2))):
        figure = Figure(figsize=size, layout="constrained", facecolor="white")
        picture(figure)
        figure.savefig(PICTURES / f"{picture.__name__}.svg", metadata={"Date": None})
    _report()
    sys.stdout.write(f"{PICTURES}\n")


if __name__ == "__main__":
    draw()

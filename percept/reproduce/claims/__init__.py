"""The paper's claims, in its own order; each judge takes the published numbers and gives a claim."""

from __future__ import annotations

from percept.reproduce.claims import coupling, curves, figures, limits, stability, text
from percept.reproduce.claims.record import Claim, Quantity, Verdict
from percept.reproduce.published import Published

__all__ = ["Claim", "Quantity", "Verdict", "judge_all"]

_ORDER = (
    stability.theoretical_coupling,
    stability.tuned_coupling,
    stability.worst_case,
    stability.one_coupling,
    text.substitution,
    limits.reprinted,
    limits.reference_inside,
    limits.users_covered,
    limits.thirty_subjects,
    limits.normal_values,
    limits.joint_level,
    limits.published_limits_suffice,
    stability.direct_rendering,
    text.environments_in_text,
    text.mass_left_out,
    curves.upper_above,
    curves.like_shapes,
    figures.free_motion,
    figures.one_device,
    figures.coupling_unnoticed,
    figures.middle_impedance,
    figures.high_impedance,
    coupling.other_environments,
    coupling.suits_high,
    coupling.always_smaller,
    curves.discrimination,
    curves.magnitude_suffices,
    curves.window_suffices,
    text.perceivable_range,
    coupling.affects_realism,
    text.felt_and_rendered,
)


def judge_all(published: Published) -> list[Claim]:
    """Judge every claim.

    Parameters
    ----------
    published : Published

    Returns
    -------
    list of Claim
        In the order of the paper.
    """
    return [judge(published) for judge in _ORDER]

"""What a report cites, as text and as BibTeX."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from percept import __version__


@dataclass(frozen=True)
class Reference:
    """A work to cite."""

    key: str  # BibTeX key
    entry: str  # BibTeX entry type
    text: str  # As it stands in a list of references
    fields: Mapping[str, str] = field(default_factory=dict)  # BibTeX fields

    @property
    def bibtex(self) -> str:
        """The BibTeX entry."""
        body = ",\n".join(f"  {name} = {{{value}}}" for name, value in self.fields.items())
        return f"@{self.entry}{{{self.key},\n{body}\n}}\n"


_ALL = (
    Reference(
        "boundaries",
        "misc",
        "The effect of static virtual couplings on realistic performance of haptic systems. Supported by the "
        "Thailand Research Fund, BRG/2/2542.",
        {
            "title": "The effect of static virtual couplings on realistic performance of haptic systems",
            "note": "Supported by the Thailand Research Fund, BRG/2/2542",
        },
    ),
    Reference(
        "adams1999",
        "article",
        "R. J. Adams and B. Hannaford (1999). Stable haptic interaction with virtual environments. IEEE "
        "Transactions on Robotics and Automation 15(3), 465–474.",
        {
            "author": "Adams, Richard J. and Hannaford, Blake",
            "title": "Stable haptic interaction with virtual environments",
            "journal": "IEEE Transactions on Robotics and Automation",
            "year": "1999",
            "volume": "15",
            "number": "3",
            "pages": "465--474",
        },
    ),
    Reference(
        "meeker2017",
        "book",
        "W. Q. Meeker, G. J. Hahn and L. A. Escobar (2017). Statistical Intervals: A Guide for Practitioners "
        "and Researchers, 2nd edition. Wiley.",
        {
            "author": "Meeker, William Q. and Hahn, Gerald J. and Escobar, Luis A.",
            "title": "Statistical Intervals: A Guide for Practitioners and Researchers",
            "edition": "2",
            "publisher": "Wiley",
            "year": "2017",
        },
    ),
    Reference(
        "emcee",
        "article",
        "D. Foreman-Mackey, D. W. Hogg, D. Lang and J. Goodman (2013). emcee: The MCMC Hammer. Publications "
        "of the Astronomical Society of the Pacific 125, 306–312.",
        {
            "author": "Foreman-Mackey, Daniel and Hogg, David W. and Lang, Dustin and Goodman, Jonathan",
            "title": "emcee: The {MCMC} Hammer",
            "journal": "Publications of the Astronomical Society of the Pacific",
            "year": "2013",
            "volume": "125",
            "pages": "306--312",
            "doi": "10.1086/670067",
        },
    ),
    Reference(
        "terbraak2006",
        "article",
        "C. J. F. ter Braak (2006). A Markov Chain Monte Carlo version of the genetic algorithm Differential "
        "Evolution: easy Bayesian computing for real parameter spaces. Statistics and Computing 16(3), "
        "239–249.",
        {
            "author": "{ter Braak}, Cajo J. F.",
            "title": "A {Markov Chain Monte Carlo} version of the genetic algorithm {Differential "
            "Evolution}: easy {Bayesian} computing for real parameter spaces",
            "journal": "Statistics and Computing",
            "year": "2006",
            "volume": "16",
            "number": "3",
            "pages": "239--249",
        },
    ),
    Reference(
        "vehtari2021",
        "article",
        "A. Vehtari, A. Gelman, D. Simpson, B. Carpenter and P.-C. Bürkner (2021). Rank-normalization, "
        "folding, and localization: an improved R̂ for assessing convergence of MCMC. Bayesian Analysis "
        "16(2), 667–718.",
        {
            "author": "Vehtari, Aki and Gelman, Andrew and Simpson, Daniel and Carpenter, Bob and "
            'B{\\"u}rkner, Paul-Christian',
            "title": "Rank-normalization, folding, and localization: An improved $\\widehat{R}$ for "
            "assessing convergence of {MCMC}",
            "journal": "Bayesian Analysis",
            "year": "2021",
            "volume": "16",
            "number": "2",
            "pages": "667--718",
            "doi": "10.1214/20-BA1221",
        },
    ),
    Reference(
        "percept",
        "software",
        f"The percept developers. percept, version {__version__}.",
        {
            "author": "{The percept developers}",
            "title": "percept: realistic performance boundaries of haptic systems, from perception "
            "experiments",
            "version": __version__,
        },
    ),
)

# As the methods paragraph cites them.
_IN_ORDER = tuple(
    next(reference for reference in _ALL if reference.key == key)
    for key in ("boundaries", "percept", "meeker2017", "emcee", "terbraak2006", "vehtari2021", "adams1999")
)


def cited(document: Mapping[str, Any]) -> list[Reference]:
    """Return what the methods paragraph of a document cites, in order."""
    methods = {row["method"] for row in document["intervals"]}
    scene = document["provenance"]["scene"]
    needed = {"boundaries", "percept"}
    if "classical" in methods:
        needed.add("meeker2017")
    if "bayesian" in methods:
        needed |= {"emcee", "terbraak2006", "vehtari2021"}
    if scene.get("coupling"):
        needed.add("adams1999")
    return [reference for reference in _IN_ORDER if reference.key in needed]


def bibtex(document: Mapping[str, Any]) -> str:
    """Return the BibTeX entries of what a document cites."""
    return "\n".join(reference.bibtex for reference in cited(document))

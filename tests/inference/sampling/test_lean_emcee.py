"""emcee without scipy.stats: nothing of emcee's is lost, and nothing of scipy's is replaced."""

import json
import subprocess
import sys

import pytest


def told(code):
    """Run code that ends in an expression, in a new process, and return the expression's value."""
    *before, last = code.strip().splitlines()
    script = "\n".join(["import json, sys", *before, f"print(json.dumps({last}))"])
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def test_sampling_loads_no_statistics_library():
    assert not told("import percept.inference.sampling.run\n'scipy.stats' in sys.modules")


def test_the_kde_move_works_as_ever():
    """The same chain as with the real function, whoever imports emcee first."""
    chain = """
import emcee, numpy
numpy.random.seed(1)
sampler = emcee.EnsembleSampler(24, 2, lambda x: -0.5 * x @ x, moves=emcee.moves.KDEMove())
sampler.run_mcmc(numpy.random.standard_normal((24, 2)), 5)
sampler.get_chain().tolist()"""
    real = told("import emcee" + chain)
    assert told("import percept.inference.sampling.lean_emcee" + chain) == real
    assert told("import scipy.stats, percept.inference.sampling.lean_emcee" + chain) == real


@pytest.mark.parametrize("first", ["", "import emcee\n", "import scipy.stats\n"])
def test_scipy_keeps_its_own_module(first):
    code = "import percept.inference.sampling.lean_emcee\nfrom scipy import stats\nimport scipy.stats\n"
    assert told(first + code + "[stats is scipy.stats, stats.norm.cdf(0.0), stats.__name__]") == [
        True,
        0.5,
        "scipy.stats",
    ]


def test_what_the_stand_in_was_not_given_comes_from_the_real_module():
    """Another release of emcee may take more of scipy.stats than today's."""
    code = "from percept.inference.sampling import lean_emcee\nfound = lean_emcee._stand_in.norm.cdf(0.0)\n"
    assert told(code + "[found, hasattr(lean_emcee._stand_in, '__path__')]") == [0.5, False]

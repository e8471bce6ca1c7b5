"""Terms of a model in Wilkinson's notation, such as "hand * load + start"."""

from __future__ import annotations

import ast
import itertools

from percept.errors import UsageError

#: A term: one column, or several that interact.
Term = tuple[str, ...]
#: More characters or terms are no formula that somebody wrote: products double with each factor.
_LONGEST = 2_000
_MOST_TERMS = 200
#: In `[model] bias` the reference of the trial, which no column of the files has that name for.
TRIAL_REFERENCE = "reference"


def model_terms(factor: str | None, bias: str | None) -> tuple[Term, ...]:
    """Terms of `[model] bias`, with `[study] factor` as a short form of its own."""
    terms = terms_of(bias, key="model.bias") if bias else ()
    if factor is None or (factor,) in terms:
        return terms
    return ((factor,), *terms)


def terms_of(formula: str, *, key: str) -> tuple[Term, ...]:
    """Expand a formula into its terms, main effects first.

    Parameters
    ----------
    formula : str
        Names of columns joined by ``+``, by ``:`` for an interaction, or by ``*`` for main effects
        and interaction. Parentheses group.
    key : str
        The scene's key, for messages.

    Returns
    -------
    tuple of tuple of str
        Each term's columns in the formula's order.

    Raises
    ------
    UsageError
        Anything else, or an interaction of columns without their main effects.
    """
    if len(formula) > _LONGEST:
        hint = "Name the columns that matter."
        raise UsageError(
            f"has more than {_LONGEST:,} characters.", key=key, value=formula, hint=hint
        )
    try:
        # Python has no binary ":"; its power binds tighter than "*" too.
        tree = ast.parse(formula.replace(":", "**").strip(), mode="eval")
        terms = _expanded(tree.body)
    except UsageError as error:
        error.key, error.value = key, formula
        raise
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        hint = 'Join names of columns by +, : or *, as in "hand * load + start".'
        raise UsageError("is not a formula.", key=key, value=formula, hint=hint) from None
    for term in terms:
        for part in itertools.combinations(term, len(term) - 1):
            if part and part not in terms:
                missing = " : ".join(part)
                message = f"has an interaction without {missing}."
                hint = f"Write {' * '.join(term)} instead of {' : '.join(term)}."
                raise UsageError(message, key=key, value=formula, hint=hint)
    return tuple(sorted(terms, key=len))


def _expanded(node: ast.expr) -> list[Term]:
    """Terms of an expression, each once."""
    if isinstance(node, ast.Name):
        return [(node.id,)]
    if not isinstance(node, ast.BinOp):
        raise ValueError
    first = _expanded(node.left)
    second = _expanded(node.right)
    joint = [_joined(*pair) for pair in itertools.product(first, second)]
    if isinstance(node.op, ast.Add):
        terms = first + second
    elif isinstance(node.op, ast.Mult):
        terms = first + second + joint
    elif isinstance(node.op, ast.Pow):
        terms = joint
    else:
        raise ValueError
    terms = list(dict.fromkeys(terms))
    if len(terms) > _MOST_TERMS:
        hint = "Name the interactions that matter, as in a + b + a:b."
        raise UsageError(f"has more than {_MOST_TERMS} terms.", hint=hint)
    return terms


def _joined(first: Term, second: Term) -> Term:
    """Return the interaction of two terms."""
    return tuple(dict.fromkeys(first + second))

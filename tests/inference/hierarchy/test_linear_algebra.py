"""Shared covariances, pooled means and the least squares behind the density, against dense matrices."""

import numpy as np
import pytest

from percept.inference.hierarchy.blocks import Block, Pair, Scalar, SharedCovariance, block
from percept.inference.hierarchy.regression import PooledMeans, factor
from percept.inference.hierarchy.statistics import Pattern

WIDTH = 3


def random_block(rng, shape, parameters) -> Block:
    sd = tuple(np.exp(rng.normal(size=shape)) for _ in range(parameters))
    rho = rng.uniform(-0.95, 0.95, size=shape)
    return block(sd, rho, 1 - np.abs(rho))


def dense(part: Block, index) -> np.ndarray:
    if isinstance(part, Scalar):
        return np.array([[part.v[index]]])
    assert isinstance(part, Pair)
    v, g, w = part.v[index], part.g[index], part.w[index]
    return np.array([[v, g * v], [g * v, w + g * g * v]])


def stacked(parts) -> np.ndarray:
    """Block-diagonal matrix."""
    size = sum(len(p) for p in parts)
    matrix, at = np.zeros((size, size)), 0
    for p in parts:
        matrix[at : at + len(p), at : at + len(p)] = p
        at += len(p)
    return matrix


@pytest.mark.parametrize("parameters", [1, 2])
@pytest.mark.parametrize("shared", [False, True])
def test_shared_covariance_equals_dense(parameters, shared):
    rng = np.random.default_rng(1)
    environments = 4
    cells = random_block(rng, (environments, WIDTH), parameters)
    common = random_block(rng, (WIDTH,), parameters) if shared else None
    ours = SharedCovariance(cells, common)
    rows = rng.normal(size=(parameters, 5, environments))
    distance = ours.scatter_distance(rows)
    white = [
        np.reshape(c, (-1, c.shape[-1])) for piece in ours.whiten(tuple(rows[:, :1, :, None])) for c in piece
    ]
    for w in range(WIDTH):
        matrix = stacked([dense(cells, (j, w)) for j in range(environments)])
        if common is not None:
            matrix += np.kron(np.ones((environments, environments)), dense(common, w))
        np.testing.assert_allclose(ours.log_determinant()[w], np.linalg.slogdet(matrix)[1], rtol=1e-12)
        vectors = rows.transpose(1, 2, 0).reshape(5, -1)
        wanted = np.einsum("ka,ab,kb->k", vectors, np.linalg.inv(matrix), vectors)
        np.testing.assert_allclose(distance[w], wanted.sum(), rtol=1e-12)
        np.testing.assert_allclose(sum((part[:, w] ** 2).sum() for part in white), wanted[0], rtol=1e-12)


@pytest.mark.parametrize("parameters", [1, 2])
def test_pooled_means_equal_generalised_least_squares(parameters):
    rng = np.random.default_rng(2)
    environments = 4
    present = [[0, 1, 2], [1, 2, 3], [1], [2]]
    patterns = [
        Pattern(
            np.array(p),
            np.ones(len(p)),
            np.arange(2),
            rng.normal(size=(parameters, len(p))),
            np.zeros((parameters, 0, len(p))),
        )
        for p in present
    ]
    noises = [random_block(rng, (len(p), WIDTH), parameters) for p in present]
    pooled = PooledMeans(patterns, noises, environments)
    squares = sum(
        np.reshape(component, (-1, WIDTH)) ** 2 for piece in pooled.deviations for component in piece
    ).sum(axis=0)
    effect = tuple(rng.normal(size=WIDTH) for _ in range(parameters))
    moved = pooled.effect_on_mean(1, effect)
    changes = pooled.effect_on_deviations(1, effect)
    for w in range(WIDTH):
        log_determinant, distance = 0.0, 0.0
        for j in range(environments):
            sources = [(g, p.index(j)) for g, p in enumerate(present) if j in p]
            matrices = [dense(noises[g], (i, w)) for g, i in sources]
            values = [patterns[g].mean[:, i] for g, i in sources]
            precision = sum(np.linalg.inv(m) for m in matrices)
            mean = np.linalg.solve(
                precision, sum(np.linalg.inv(m) @ v for m, v in zip(matrices, values, strict=True))
            )
            np.testing.assert_allclose([m[j, w] for m in pooled.mean], mean, rtol=1e-12)
            np.testing.assert_allclose(
                dense(pooled.spread, (j, w)), np.linalg.inv(precision), rtol=1e-11, atol=1e-14
            )
            log_determinant += (
                sum(np.linalg.slogdet(m)[1] for m in matrices) + np.linalg.slogdet(precision)[1]
            )
            distance += sum(
                (v - mean) @ np.linalg.inv(m) @ (v - mean) for m, v in zip(matrices, values, strict=True)
            )
            e = np.array([c[w] for c in effect])
            share = np.zeros(parameters)
            if 1 in [g for g, _ in sources]:
                own = matrices[[g for g, _ in sources].index(1)]
                share = np.linalg.solve(precision, np.linalg.inv(own) @ e)
            np.testing.assert_allclose([m[j, w] for m in moved], share, rtol=1e-11, atol=1e-14)
        np.testing.assert_allclose(pooled.log_determinant[w], log_determinant, rtol=1e-11)
        np.testing.assert_allclose(squares[w], distance, rtol=1e-11)
    # The deviations are linear in the data: adding the effect to pattern 1 changes them by `changes`.
    for w in range(WIDTH):
        e = np.array([c[w] for c in effect])
        shifted = [
            Pattern(p.environments, p.trials, p.members, p.mean + (e[:, None] if g == 1 else 0.0), p.rows)
            for g, p in enumerate(patterns)
        ]
        after = PooledMeans(shifted, noises, environments)
        for old, new, change in zip(pooled.deviations, after.deviations, changes, strict=True):
            for a, b, c in zip(old, new, change, strict=True):
                np.testing.assert_allclose(b[w] - a[w], c[w], rtol=1e-9, atol=1e-12)


def test_single_source_keeps_its_mean_and_noise():
    rng = np.random.default_rng(5)
    mean = rng.normal(size=(2, 3))
    noise = random_block(rng, (3, WIDTH), 2)
    only = PooledMeans(
        [Pattern(np.arange(3), np.ones(3), np.arange(4), mean, np.zeros((2, 0, 3)))], [noise], 3
    )
    np.testing.assert_array_equal(np.stack(only.mean)[..., 0], mean)
    assert only.spread is noise
    assert only.deviations == []
    np.testing.assert_array_equal(only.log_determinant, 0.0)


@pytest.mark.parametrize("scale", [1.0, 1e6, 1e-6])
def test_least_squares_equals_dense(scale):
    rng = np.random.default_rng(3)
    size, rows = 5, 12
    design = scale * rng.normal(size=(size, rows, WIDTH))
    target = rng.normal(size=(rows, WIDTH))
    kept = design.copy(), target.copy()
    solved = factor(design, target)
    np.testing.assert_array_equal(design, kept[0])
    np.testing.assert_array_equal(target, kept[1])
    right = rng.normal(size=(size, 2, WIDTH))
    for w in range(WIDTH):
        a, y = design[:, :, w].T, target[:, w]
        gram = np.eye(size) + a.T @ a
        covariance = np.eye(rows) + a @ a.T
        np.testing.assert_allclose(
            solved.log_determinant[w], np.linalg.slogdet(gram)[1], rtol=1e-12, atol=1e-14
        )
        # The part of y outside A's columns carries the distance when A is large.
        outside = y - a @ np.linalg.solve(gram, a.T @ y)
        inside = np.linalg.solve(gram, a.T @ y)
        np.testing.assert_allclose(solved.distance[w], outside @ outside + inside @ inside, rtol=1e-8)
        if scale == 1.0:
            np.testing.assert_allclose(solved.distance[w], y @ np.linalg.solve(covariance, y), rtol=1e-12)
        triangle = solved.triangle[:, :, w]
        np.testing.assert_array_equal(triangle, np.triu(triangle))
        np.testing.assert_allclose(triangle.T @ triangle, gram, rtol=1e-12, atol=1e-12 * gram.max())
        np.testing.assert_allclose(solved.mean[:, w], inside, rtol=1e-9)
        for k in range(2):
            np.testing.assert_allclose(
                triangle @ solved.solve(right)[:, k, w], right[:, k, w], rtol=1e-10, atol=1e-12
            )
            np.testing.assert_allclose(
                triangle.T @ solved.solve_transposed(right)[:, k, w], right[:, k, w], rtol=1e-10, atol=1e-12
            )

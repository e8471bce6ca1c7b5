"""Shared covariances and the least squares behind the density, against dense matrices."""

import numpy as np
import pytest

from percept.inference.hierarchy.blocks import Block, block
from percept.inference.hierarchy.orthogonal import factor
from percept.inference.hierarchy.shared_covariance import SharedCovariance

WIDTH = 3


def random_block(rng, shape, parameters) -> Block:
    sd = tuple(np.exp(rng.normal(size=shape)) for _ in range(parameters))
    rho = rng.uniform(-0.95, 0.95, size=shape)
    return block(sd, rho, 1 - np.abs(rho))


def dense(part: Block, index) -> np.ndarray:
    v, *left = (variance[index] for variance in part.variances)
    if part.slope is None:
        return np.array([[v]])
    g, w = part.slope[index], left[0]
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
        np.reshape(c, (-1, c.shape[-1]))
        for piece in ours.whiten(tuple(rows[:, :1, :, None]))
        for c in piece
    ]
    for w in range(WIDTH):
        matrix = stacked([dense(cells, (j, w)) for j in range(environments)])
        if common is not None:
            matrix += np.kron(np.ones((environments, environments)), dense(common, w))
        np.testing.assert_allclose(
            ours.log_determinant()[w], np.linalg.slogdet(matrix)[1], rtol=1e-12
        )
        vectors = rows.transpose(1, 2, 0).reshape(5, -1)
        wanted = np.einsum("ka,ab,kb->k", vectors, np.linalg.inv(matrix), vectors)
        np.testing.assert_allclose(distance[w], wanted.sum(), rtol=1e-12)
        np.testing.assert_allclose(
            sum((part[:, w] ** 2).sum() for part in white), wanted[0], rtol=1e-12
        )


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
        np.testing.assert_allclose(
            solved.distance[w], outside @ outside + inside @ inside, rtol=1e-8
        )
        if scale == 1.0:
            np.testing.assert_allclose(
                solved.distance[w], y @ np.linalg.solve(covariance, y), rtol=1e-12
            )
        triangle = solved.triangle[:, :, w]
        np.testing.assert_array_equal(triangle, np.triu(triangle))
        np.testing.assert_allclose(triangle.T @ triangle, gram, rtol=1e-12, atol=1e-12 * gram.max())
        np.testing.assert_allclose(solved.mean[:, w], inside, rtol=1e-9)
        for k in range(2):
            np.testing.assert_allclose(
                triangle @ solved.solve(right)[:, k, w], right[:, k, w], rtol=1e-10, atol=1e-12
            )
            np.testing.assert_allclose(
                triangle.T @ solved.solve_transposed(right)[:, k, w],
                right[:, k, w],
                rtol=1e-10,
                atol=1e-12,
            )

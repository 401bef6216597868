"""The Gauss-Newton that single tags, the joint pose and the tracker share, against NumPy."""

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal
from strategies import seeds

from tagvo.kernels import gauss_newton


@given(seeds)
def test_rows_make_the_normal_equations_and_the_step_solves_them(seed):
    rng = np.random.default_rng(seed)
    J, r, w = rng.normal(size=(8, 6)), rng.normal(size=8), rng.uniform(0.1, 4.0, 8)
    H, g = np.full((6, 6), np.nan), np.full(6, np.nan)
    gauss_newton.clear(H, g)
    for k in range(8):
        gauss_newton.add_row(J[k], r[k], w[k], H, g)
    assert_array_equal(np.triu(H, 1), 0.0)
    gauss_newton.mirror(H)
    assert_allclose(H, J.T @ (w[:, None] * J), atol=1e-12)
    assert_allclose(g, J.T @ (w * r), atol=1e-12)
    L, b = np.empty((6, 6)), np.empty((6, 1))
    for damping, ridge in ((0.0, 1e-9), (0.3, 1e-3)):
        assert gauss_newton.damped_step(np.tril(H), g, damping, ridge, L, b)
        D = damping * np.diag(np.diag(H)) + ridge * np.eye(6)
        assert_allclose((H + D) @ b[:, 0], g, atol=1e-7)


@pytest.mark.parametrize("bad", [-np.eye(6), np.full((6, 6), np.nan)])
def test_no_step_where_nothing_is_positive(bad):
    assert not gauss_newton.damped_step(
        bad, np.ones(6), 1e-6, 1e-9, np.empty((6, 6)), np.empty((6, 1))
    )

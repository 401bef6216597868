"""The small dense algebra of the kernels against NumPy."""

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose
from strategies import seeds

from tagvo.kernels import linalg


def positive(seed, n=6, condition=1e6):
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    return Q @ np.diag(np.geomspace(1.0, condition, n)) @ Q.T


@given(seeds)
def test_cholesky_and_both_substitutions(seed):
    A = positive(seed)
    L = A.copy()
    assert linalg.cholesky(L)
    L = np.tril(L)
    assert_allclose(L, np.linalg.cholesky(A), rtol=1e-6, atol=1e-6)
    b = np.random.default_rng(seed).standard_normal((6, 3))
    x = b.copy()
    linalg.forward(L, x)
    assert_allclose(L @ x, b, atol=1e-8)
    linalg.backward(L, x)
    assert_allclose(A @ x, b, atol=1e-6)


@given(seeds)
def test_inverse_is_symmetric_and_leaves_its_input(seed):
    A, out = positive(seed), np.empty((6, 6))
    before = A.copy()
    assert linalg.inverse_spd(A, out)
    assert_allclose(out @ A, np.eye(6), atol=1e-6)
    assert (out == out.T).all()
    assert_allclose(A, before, rtol=0)


@pytest.mark.parametrize("bad", [np.zeros((3, 3)), -np.eye(3), np.full((3, 3), np.nan)])
def test_a_matrix_that_is_not_positive_is_told(bad):
    assert not linalg.cholesky(bad.copy())
    assert not linalg.inverse_spd(bad, np.empty((3, 3)))


@given(seeds)
def test_products_are_numpys(seed):
    rng = np.random.default_rng(seed)
    A, B, C = rng.normal(size=(6, 5)), rng.normal(size=(6, 4)), rng.normal(size=(7, 5))
    v, u = rng.normal(size=5), rng.normal(size=6)
    out = np.empty((6, 5))
    linalg.copy(A, out)
    assert_allclose(out, A)
    y = u.copy()
    linalg.add_times(A, v, y)
    assert_allclose(y, u + A @ v)
    y = v.copy()
    linalg.add_t_times(A, u, y)
    assert_allclose(y, v + A.T @ u)
    start = rng.normal(size=(5, 4))
    out = start.copy()
    linalg.add_t_product(A, B, 0.3, out)
    assert_allclose(out, start + 0.3 * A.T @ B)
    out = np.zeros((6, 7))
    linalg.add_product_t(A, C, out)
    assert_allclose(out, A @ C.T)
    y = u.copy()
    linalg.subtract_times(A, v, y)
    assert_allclose(y, u - A @ v)
    linalg.add_scaled(u, -0.7, y)
    assert_allclose(y, 0.3 * u - A @ v)
    linalg.scale(y, 2.0)
    assert_allclose(y, 0.6 * u - 2.0 * A @ v)
    assert linalg.dot(u, y) == pytest.approx(u @ y)
    assert linalg.square(v) == pytest.approx(v @ v)
    out = np.empty((4, 4))
    linalg.identity(out)
    assert_allclose(out, np.eye(4))


@given(seeds)
def test_products_that_skip_zeros_and_the_square_are_numpys(seed):
    rng = np.random.default_rng(seed)
    P = positive(seed, 9, 10.0)
    for m in (3, 6):
        H = rng.normal(size=(m, 9)) * (rng.random((m, 9)) < 0.4)
        M, S = np.empty((m, 9)), np.empty((m, m))
        linalg.times_p(H, P, M)
        assert_allclose(M, H @ P, atol=1e-12)
        linalg.times_ht(M, H, S)
        assert_allclose(S, H @ P @ H.T, atol=1e-11)
        assert (S == S.T).all()
        out = P.copy()
        linalg.subtract_square(out, M)
        assert_allclose(out, P - M.T @ M, atol=1e-11)


@given(seeds)
def test_determinant_largest_eigenvalue_and_mean_with_the_transpose_are_numpys(seed):
    A = np.random.default_rng(seed).normal(size=(3, 3))
    assert linalg.determinant(A) == pytest.approx(np.linalg.det(A), abs=1e-12)
    S = A.copy()
    linalg.symmetrize(S)
    assert_allclose(S, 0.5 * (A + A.T), atol=0)
    assert linalg.largest_eigenvalue(S) == pytest.approx(np.linalg.eigvalsh(S)[-1], abs=1e-7)
    assert linalg.largest_eigenvalue(2.0 * np.eye(3)) == 2.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_element_that_is_no_number_is_found(bad):
    A = np.full((2, 3), 1e300)
    assert linalg.is_finite(A)
    A[1, 2] = bad
    assert not linalg.is_finite(A)

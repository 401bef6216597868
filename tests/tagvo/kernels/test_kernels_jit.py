"""The small dense algebra of the kernels against NumPy, and the cache that must not go stale."""

import os

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose
from strategies import rotvecs, seeds

from tagvo import geometry as geo
from tagvo.kernels import jit


def positive(seed, n=6, condition=1e6):
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    return Q @ np.diag(np.geomspace(1.0, condition, n)) @ Q.T


@given(seeds)
def test_cholesky_and_both_substitutions(seed):
    A = positive(seed)
    L = A.copy()
    assert jit.cholesky(L)
    L = np.tril(L)
    assert_allclose(L, np.linalg.cholesky(A), rtol=1e-6, atol=1e-6)
    b = np.random.default_rng(seed).standard_normal((6, 3))
    x = b.copy()
    jit.forward(L, x)
    assert_allclose(L @ x, b, atol=1e-8)
    jit.backward(L, x)
    assert_allclose(A @ x, b, atol=1e-6)


@given(seeds)
def test_inverse_is_symmetric_and_leaves_its_input(seed):
    A, out = positive(seed), np.empty((6, 6))
    before = A.copy()
    assert jit.inverse_spd(A, out)
    assert_allclose(out @ A, np.eye(6), atol=1e-6)
    assert (out == out.T).all()
    assert_allclose(A, before, rtol=0)


@pytest.mark.parametrize("bad", [np.zeros((3, 3)), -np.eye(3), np.full((3, 3), np.nan)])
def test_a_matrix_that_is_not_positive_is_told(bad):
    assert not jit.cholesky(bad.copy())
    assert not jit.inverse_spd(bad, np.empty((3, 3)))


@given(rotvecs, rotvecs)
def test_rotated_quaternion_and_rotation_agree_with_geometry(a, b):
    R, out, q = geo.exp(a), np.empty((3, 3)), np.empty(4)
    jit.rotated(R, b, out)
    assert_allclose(out, R @ geo.exp(b), atol=1e-12)
    jit.quaternion(R, q)
    assert_allclose(q * np.sign(q @ geo.quat_from_matrix(R)), geo.quat_from_matrix(R), atol=1e-7)
    assert_allclose(jit.rotation(q), R, atol=1e-12)


def test_machine_code_older_than_a_kernel_is_forgotten(tmp_path):
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    kernel, plain = tmp_path / "kernel.py", tmp_path / "plain.py"
    kernel.write_text("@njit\ndef f(): ...\n")
    plain.write_text("x = 1\n")
    old, new, other = cache / "a.nbi", cache / "b.nbc", cache / "c.pyc"
    for file, age in ((old, 50), (new, 150), (other, 50), (kernel, 100), (plain, 200)):
        file.touch()
        os.utime(file, (age, age))
    jit.drop_stale_code([tmp_path, tmp_path / "missing"])
    assert not old.exists()
    assert new.exists()  # newer than every kernel; a file without one does not count
    assert other.exists()

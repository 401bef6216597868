"""`.tum` files: exact nanoseconds, the format that evo takes, and their way back."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vio.errors import LogError
from vio.sinks.tum import read_tum, tum_line, write_tum


def test_a_line_is_exact_to_the_nanosecond() -> None:
    line = tum_line(
        1_403_638_519_492_829_441, np.array([1.0, -2.5, 1e-4]), np.array([0.5, 1, 2, 3])
    )
    assert line == (
        "1403638519.492829441 1.000000000 -2.500000000 0.000100000"
        " 1.000000000 2.000000000 3.000000000 0.500000000"
    )
    zero = np.zeros(4)
    assert tum_line(0, zero[:3], zero).startswith("0.000000000 ")
    assert tum_line(-1, zero[:3], zero).startswith("-0.000000001 ")
    assert tum_line(-1_500_000_000, zero[:3], zero).startswith("-1.500000000 ")


numbers = st.floats(-1e6, 1e6)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(-(2**61), 2**61), st.lists(numbers, min_size=7, max_size=7)),
        max_size=5,
    )
)
def test_what_is_written_is_read_back(tmp_path_factory, rows) -> None:
    path = tmp_path_factory.mktemp("tum") / "a.tum"
    t_ns = np.array([t for t, _ in rows], dtype=np.int64)
    poses = np.array([p for _, p in rows], dtype=float).reshape(-1, 7)
    write_tum(path, t_ns, poses[:, :3], poses[:, 3:])
    text = path.read_text()
    assert all(re.fullmatch(r"-?\d+\.\d{9}( -?\d+\.\d{9}){7}", s) for s in text.splitlines())
    back_ns, p, q = read_tum(path)
    assert back_ns.tolist() == t_ns.tolist()
    assert_allclose(p, poses[:, :3], rtol=1e-15, atol=5.1e-10)
    assert_allclose(q, poses[:, 3:], rtol=1e-15, atol=5.1e-10)
    assert [f.name for f in path.parent.iterdir()] == ["a.tum"]


def test_files_of_others_are_read(tmp_path: Path) -> None:
    path = tmp_path / "evo.tum"
    path.write_text(
        "\ufeff# timestamp tx ty tz qx qy qz qw\n\n"
        "1.403638519492829441e+09 1 2 3 0.1 0.2 0.3 0.9 \r\n1403638520 1e-3 2 3 0 0 0 1\n"
    )
    t_ns, p, q = read_tum(path)
    assert t_ns.tolist() == [1_403_638_519_492_829_441, 1_403_638_520_000_000_000]
    assert_allclose(p[1], [1e-3, 2, 3])
    assert_allclose(q[0], [0.9, 0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    "line",
    ["1 2 3", "x 1 2 3 0 0 0 1", "1 1 2 3 0 0 0 nan", "nan 1 2 3 0 0 0 1", "1e30 1 2 3 0 0 0 1",
     "1 1 2 3 0 0 0 1 5", "1,1,2,3,0,0,0,1"],
)  # fmt: skip
def test_a_bad_line_is_named(tmp_path: Path, line: str) -> None:
    path = tmp_path / "bad.tum"
    path.write_text(f"1 1 2 3 0 0 0 1\n{line}\n")
    with pytest.raises(LogError, match=r"line 2: .* is needed"):
        read_tum(path)


def test_evo_reads_what_is_written(tmp_path: Path) -> None:
    evo = pytest.importorskip("evo.tools.file_interface")
    path = tmp_path / "a.tum"
    t_ns = np.array([1_403_638_519_492_829_441, 1_403_638_519_592_829_441])
    q = np.array([[0.6, 0.0, 0.0, 0.8], [1.0, 0.0, 0.0, 0.0]])
    write_tum(path, t_ns, np.arange(6.0).reshape(2, 3), q)
    trajectory = evo.read_tum_trajectory_file(str(path))
    assert_allclose(trajectory.positions_xyz, np.arange(6.0).reshape(2, 3))
    assert_allclose(trajectory.orientations_quat_wxyz, q)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such file"):
        read_tum(tmp_path / "none.tum")

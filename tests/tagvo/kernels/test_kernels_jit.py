"""The cache of machine code must not go stale."""

import os

from tagvo.kernels import jit


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

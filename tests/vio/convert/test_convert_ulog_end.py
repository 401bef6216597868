"""A ULog that was cut off is told from one that is whole."""

import pytest

from vio.convert.ulog import _cut_off

WHOLE = bytes(16) + b"".join(len(m).to_bytes(2, "little") + b"D" + m for m in (b"abc", b"", b"xy"))


def test_a_whole_file_ends_with_a_message():
    assert not _cut_off(WHOLE)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6, 9])
def test_a_file_that_ends_within_one_is_cut_off(n):
    assert _cut_off(WHOLE[:-n])

"""THS: which tags the three methods take, ties and single classes included."""

import numpy as np
from hypothesis import given
from numpy.testing import assert_array_equal
from strategies import seeds

from tagvo.pose.selection import SELECT
from tagvo.records import ImuPoses


def imu_poses(size, area=None, tag_id=None):
    size = np.array(size, dtype=float)
    n = len(size)
    area = np.ones(n) if area is None else np.array(area, dtype=float)
    tag_id = np.arange(n) if tag_id is None else np.array(tag_id)
    return ImuPoses(
        tag_id, size, np.zeros(n), area, np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1))
    )


def test_jbt_takes_one_of_the_biggest_class():
    assert_array_equal(SELECT["JBT"](imu_poses([0.1, 0.4, 0.2])), [False, True, False])


def test_jbt_ties_go_to_the_largest_image_then_the_lowest_id():
    sizes = [0.4, 0.4, 0.4, 0.1]
    by_area = SELECT["JBT"](imu_poses(sizes, area=[5, 9, 7, 99]))
    assert_array_equal(by_area, [False, True, False, False])
    by_id = SELECT["JBT"](imu_poses(sizes, area=[7, 7, 5, 99], tag_id=[8, 3, 1, 0]))
    assert_array_equal(by_id, [False, True, False, False])


def test_tbs_takes_the_two_biggest_classes_adjacent_or_not():
    assert_array_equal(
        SELECT["TBS"](imu_poses([0.46, 0.0575, 0.115, 0.46])), [True, False, True, True]
    )
    assert_array_equal(SELECT["TBS"](imu_poses([0.0575, 0.46])), [True, True])


def test_tbs_with_one_class_takes_all_of_it():
    assert SELECT["TBS"](imu_poses([0.1, 0.1, 0.1])).all()


def test_sizes_that_differ_by_rounding_are_one_class():
    sizes = [0.1, 0.1 * (1 + 1e-4), 0.05, 0.05 * (1 - 1e-4), 0.02]
    assert_array_equal(SELECT["TBS"](imu_poses(sizes)), [True, True, True, True, False])


def test_no_tags():
    for select in SELECT.values():
        assert len(select(imu_poses([]))) == 0


@given(seeds)
def test_the_methods_nest_whatever_the_order(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 20))
    sizes = rng.choice([0.0575, 0.115, 0.23, 0.46], n)
    poses = imu_poses(sizes, rng.integers(1, 4, n), rng.permutation(n))
    jbt, tbs, both = (SELECT[k](poses) for k in ("JBT", "TBS", "ALL"))
    assert jbt.sum() == 1
    assert (tbs | ~jbt).all()
    assert both.all()
    assert_array_equal(tbs, np.isin(sizes, np.unique(sizes)[-2:]))
    order = rng.permutation(n)
    assert_array_equal(SELECT["JBT"](poses[order]), jbt[order])
    assert_array_equal(SELECT["TBS"](poses[order]), tbs[order])

"""Hypothesis strategies that visit the hard places of rotations and views of a tag."""

import numpy as np
from hypothesis import strategies as st

seeds = st.integers(0, 2**32 - 1)


def _directions():
    return seeds.map(lambda s: np.random.default_rng(s).standard_normal(3)).map(
        lambda v: v / np.linalg.norm(v)
    )


def _rotvecs(angles):
    return st.builds(lambda d, a: d * a, _directions(), angles)


tiny_rotvecs = _rotvecs(st.sampled_from([0.0, 1e-300, 1e-16, 1e-12, 1e-9, 1e-8, 1e-5, 1e-3]))
seam_rotvecs = _rotvecs(st.floats(0.0099, 0.0101))  # where the series hands over
wide_rotvecs = _rotvecs(st.floats(1e-3, np.pi - 1e-3))
near_pi_rotvecs = _rotvecs(st.sampled_from([1e-3, 1e-5, 1e-8, 1e-12, 0.0]).map(lambda e: np.pi - e))
axis_rotvecs = st.builds(
    lambda k, a: np.eye(3)[k] * a, st.integers(0, 2), st.sampled_from([-np.pi / 2, np.pi / 2, 1.0])
)
rotvecs = st.one_of(tiny_rotvecs, seam_rotvecs, wide_rotvecs, near_pi_rotvecs, axis_rotvecs)
away_from_pi = st.one_of(tiny_rotvecs, seam_rotvecs, wide_rotvecs, axis_rotvecs)
points = st.builds(
    lambda s, scale: scale * np.random.default_rng(s).standard_normal(3),
    seeds,
    st.sampled_from([0.0, 1e-6, 1.0, 100.0]),
)
tilts = st.one_of(  # of a tag against the line of sight [rad]
    st.sampled_from([0.0, 1e-9, 1e-4]), st.floats(0.05, 1.2), st.just(np.radians(85.0))
)

"""What the error figure shades: stretches without tags, not the pauses of a slow camera."""

import numpy as np

from vio.evaluate.filter_log import FilterLog
from vio.evaluate.report import plots, sections


def frames(hz, seconds=20.0):
    return np.round(np.arange(0.0, seconds, 1.0 / hz) * 1e9).astype(np.int64)


def test_a_stretch_without_tags_is_a_blackout():
    t_ns = frames(20.0)
    count = np.where((t_ns > 5e9) & (t_ns < 7e9), 0, 4)
    ((start, end),) = sections.blackouts(t_ns, count)
    assert (start, end) == (5_000_000_000, 7_000_000_000)


def test_a_slow_camera_is_none():
    t_ns = frames(1.0)
    assert sections.blackouts(t_ns, np.full(len(t_ns), 4)) == []
    count = np.where((t_ns > 5e9) & (t_ns < 9e9), 0, 4)
    assert sections.blackouts(t_ns, count) == [(5_000_000_000, 9_000_000_000)]


def test_of_no_frame_or_one_there_is_nothing_to_say():
    for n in (0, 1):
        assert sections.blackouts(frames(1.0)[:n], np.ones(n, dtype=int)) == []


def test_both_rows_keep_the_blackouts_and_the_resets():
    fig = plots.error_figure([], 0)
    assert plots.add_blackouts(fig, [(1_000_000_000, 2_000_000_000)] * 3, 0)
    n, belief = 4, (np.zeros((4, 3)), np.ones((4, 3)))
    t_ns = np.arange(n, dtype=np.int64) * 1_000_000_000
    filter_log = FilterLog(t_ns, belief, belief, belief, belief, np.ones(n), np.array([0, 0, 1, 1]))
    assert plots.add_resets(fig, filter_log, 0)
    at = [(s.type, s.x0, s.x1, s.xref, s.yref) for s in fig.layout.shapes]
    assert at == [
        *[("rect", 1.0, 2.0, "x", "y domain")] * 3,
        *[("rect", 1.0, 2.0, "x2", "y2 domain")] * 3,
        ("line", 2.0, 2.0, "x", "y domain"),
        ("line", 2.0, 2.0, "x2", "y2 domain"),
    ]
    assert not plots.add_blackouts(fig, [], 0)

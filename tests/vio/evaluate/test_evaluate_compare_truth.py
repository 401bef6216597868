"""`tagvio compare` ends in values or in one line, whatever the truth holds."""

import json
import warnings

import numpy as np
import pytest
from cli_calls import tagvio, write_true_log

TRUTH = "mav0/state_groundtruth_estimate0/data.csv"


def _every(value):
    return lambda t_ns, rows: (t_ns, np.full_like(rows, value))


def _column(k, value):
    def change(t_ns, rows):
        rows[:, k] = value
        return t_ns, rows

    return change


def _cell(k, value):
    def change(t_ns, rows):
        rows[3, k] = value
        return t_ns, rows

    return change


def _shuffled(t_ns, rows):
    order = np.random.default_rng(0).permutation(len(t_ns))
    return t_ns[order], rows[order]


def _turned(t_ns, rows):
    rows[::2, 3:] *= -1.0  # -q is q
    return t_ns, rows


KINDS = {  # what truth holds -> (stamps (n,), rows (n, 7): p, q wxyz), whether it can be judged by
    "as it is": (lambda t_ns, rows: (t_ns, rows), True),
    "all NaN": (_every(np.nan), False),
    "all infinite": (_every(np.inf), False),
    "all zero": (_every(0.0), False),
    "a NaN": (_cell(0, np.nan), True),
    "1e300 m": (_cell(0, 1e300), True),
    "1e29 m": (_cell(1, 1e29), True),
    "all 1e300 m": (_column(0, 1e300), False),
    "all 1e29 m": (_column(0, 1e29), True),
    "all 1e200 in q": (_column(3, 1e200), False),
    "a quaternion of zeros": (_cell(slice(3, 7), 0.0), True),
    "a quaternion of 1e-200": (_cell(slice(3, 7), 1e-200), True),
    "quaternions of either sign": (_turned, True),
    "at rest": (_column(slice(0, 3), 0.0), True),
    "one row": (lambda t_ns, rows: (t_ns[:1], rows[:1]), True),
    "two rows": (lambda t_ns, rows: (t_ns[:2], rows[:2]), True),
    "no row": (lambda t_ns, rows: (t_ns[:0], rows[:0]), False),
    "one stamp": (lambda t_ns, rows: (np.full_like(t_ns, t_ns[4]), rows), True),
    "one nanosecond apart": (lambda t_ns, rows: (t_ns[4] + np.arange(len(t_ns)), rows), True),
    "backward": (lambda t_ns, rows: (t_ns[::-1], rows[::-1]), True),
    "shuffled": (_shuffled, True),
    "before the flight": (lambda t_ns, rows: (t_ns - 10**12, rows), None),
    "after the flight": (lambda t_ns, rows: (t_ns + 10**12, rows), None),
    "of 1970": (lambda t_ns, rows: (t_ns - t_ns[0], rows), None),
    "beyond 2^62": (lambda t_ns, rows: (t_ns + 2**62, rows), False),
    "from end to end of time": (lambda t_ns, rows: ((t_ns - t_ns[5]) * 10**9, rows), None),
}


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write_true_log(tmp_path_factory.mktemp("truth"))


@pytest.fixture(scope="module")
def truth(log):
    head, *rows = (log / TRUTH).read_text().splitlines()
    numbers = [row.split(",") for row in rows]
    t_ns = np.array([int(row[0]) for row in numbers])
    return head, t_ns, np.array([[float(v) for v in row[1:]] for row in numbers])


DRAWN = ("a NaN", "1e29 m", "one row")  # with the report too, which takes ten times as long


@pytest.mark.parametrize("align", ["none", "se3"])
@pytest.mark.parametrize("kind", KINDS)
def test_compare_ends_whatever_truth_holds(log, truth, tmp_path, monkeypatch, kind, align):
    change, judged = KINDS[kind]
    head, *columns = truth
    t_ns, rows = change(*(column.copy() for column in columns))
    lines = [f"{t},{','.join(map(repr, row.tolist()))}" for t, row in zip(t_ns, rows, strict=True)]
    (log / TRUTH).write_text("\n".join([head, *lines]) + "\n")
    if align != "none" or kind not in DRAWN:
        monkeypatch.setattr("vio.evaluate.report.report.write_report", lambda *_: None)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        done = tagvio("compare", log, "--out", tmp_path, "--vo-only", "--align", align)
    errors = [line for line in done.err.splitlines() if not line.startswith("warning: ")]
    if judged is None or align == "se3":  # which some truths cannot fix
        assert done.code in (0, 1), done
    else:
        assert done.code == (0 if judged else 1), done
    assert len(errors) == done.code, done.err
    if done.code == 0:
        text = (tmp_path / "comparison.json").read_text()
        json.loads(text, parse_constant=lambda word: pytest.fail(f"{word} in comparison.json"))

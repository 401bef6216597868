"""A tag that was moved is named, with where it went; a map that is right is left in peace."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cli_calls import tagvio
from numpy.testing import assert_allclose
from oracles.suspect_study import MOVED_M, a_tag, flight, judged

from tagvo import geometry as geo
from tagvo.tags.tag_map import load_map, save_map
from vio.evaluate import moved_tags
from vio.evaluate.tag_sightings import Sightings

SHORT = ("stream.rate_hz=5",)


@pytest.fixture(scope="module", params=[3])
def flown(request):
    return flight(request.param, "t1_qr", SHORT)


def test_a_moved_tag_is_named_and_no_other(flown):
    recording, seen = flown
    row, offset = a_tag(recording, seen, np.random.default_rng(1))
    named, found = judged(recording, seen, (row, offset))
    assert named == {int(recording.tag_map.tag_id[row])}
    (at,) = np.flatnonzero(found.row == row)
    assert np.linalg.norm(found.offset_W[at] - offset) < 0.4 * MOVED_M


def test_of_a_map_that_is_right_no_tag_is_named(flown):
    named, found = judged(*flown)
    assert named == set()
    assert len(found.row) > 20
    assert (found.frames >= 5).all()


def synthetic(rng, moved, cameras=40, sigma=1e-4):
    """Exact sightings of 12 tags on a wall from random places; moved (12, 3) in W."""
    from simulated import grid_map

    tag_map = grid_map(4, [0.1, 0.15], 0.3)
    tag_map = tag_map.only(tag_map.tag_id[:12])
    frame, rows, points, J = [], [], [], []
    R_WC, p_WC = [], []
    for f in range(cameras):
        R = np.diag([1.0, -1.0, -1.0]) @ geo.exp(0.2 * rng.standard_normal(3))
        p = tag_map.p_WT.mean(axis=0) + np.array([*rng.uniform(-0.5, 0.5, 2), 1.2])
        X = tag_map.corners_W + moved[:, None]
        x_C = np.einsum("ji,kcj->kci", R, X - p)
        n = x_C[..., :2] / x_C[..., 2:]
        R_WC.append(R)
        p_WC.append(p)
        frame += [f] * 12
        rows += list(range(12))
        points.append(n + sigma * rng.standard_normal(n.shape))
        J.append(np.tile(500.0 * np.eye(2), (12, 4, 1, 1)))
    m = len(rows)
    return tag_map, Sightings(
        np.array(frame), np.array(rows), np.concatenate(points), np.concatenate(J),
        np.full((m, 4), 0.1), np.arange(cameras), np.stack(R_WC), np.stack(p_WC), None, None,
    )  # fmt: skip


def test_the_reduced_system_is_that_of_all_unknowns_together():
    """Against the whole normal matrix, cameras and tags, solved at once."""
    rng = np.random.default_rng(7)
    tag_map, seen = synthetic(rng, np.zeros((12, 3)))
    every = np.ones(len(seen), dtype=bool)
    r, Jc, Jt = moved_tags._linearised(seen, every, tag_map)
    k, f = 12, 40
    J = np.zeros((len(r), 8, 6 * (k + f)))
    for i, (t, c) in enumerate(zip(seen.row, seen.frame, strict=True)):
        J[i, :, 6 * t : 6 * t + 6] = Jt[i]
        J[i, :, 6 * (k + c) : 6 * (k + c) + 6] = Jc[i]
    J = J.reshape(-1, 6 * (k + f))
    prior = np.zeros(6 * (k + f))
    prior[: 6 * k] = 1e4
    whole = np.linalg.solve(J.T @ J + np.diag(prior), J.T @ r.reshape(-1))
    Hc = np.zeros((f, 6, 6))
    np.add.at(Hc, seen.frame, np.einsum("mri,mrj->mij", Jc, Jc))
    ac = np.zeros((f, 6))
    np.add.at(ac, seen.frame, np.einsum("mri,mr->mi", Jc, r))
    B = np.einsum("mri,mrj->mij", Jc, Jt)
    groups = np.split(np.arange(len(r)), np.arange(12, len(r), 12))
    S, g = moved_tags._reduced(
        Jt, np.ones(len(r)), np.einsum("mri,mr->mi", Jt, r), B, np.linalg.inv(Hc), ac, seen.row,
        groups, k,
    )  # fmt: skip
    assert_allclose(np.linalg.solve(S + 1e4 * np.eye(6 * k), g), whole[: 6 * k], atol=1e-8)


def test_the_derivatives_are_those_of_the_projection():
    rng = np.random.default_rng(8)
    tag_map, seen = synthetic(rng, np.zeros((12, 3)))
    every, h = np.ones(len(seen), dtype=bool), 1e-6
    r, Jc, Jt = moved_tags._linearised(seen, every, tag_map)
    for k in range(6):
        d = h * np.eye(6)[k]
        turned = replace(seen, p_WC=seen.p_WC + d[:3], R_WC=seen.R_WC @ geo.exp(d[3:]))
        assert_allclose((r - moved_tags._linearised(turned, every, tag_map)[0]) / h, Jc[..., k],
                        atol=2e-2 * np.abs(Jc).max() * 1e-2)  # fmt: skip
        p_WT = tag_map.p_WT + tag_map.R_WT @ d[:3]
        laid = replace(tag_map, p_WT=p_WT, R_WT=tag_map.R_WT @ geo.exp(d[3:]))
        assert_allclose((r - moved_tags._linearised(seen, every, laid)[0]) / h, Jt[..., k],
                        atol=2e-2 * np.abs(Jt).max() * 1e-2)  # fmt: skip


def test_two_moved_tags_are_found_where_they_went():
    moved = np.zeros((12, 3))
    moved[3], moved[8] = [0.02, 0.0, 0.0], [0.0, -0.015, 0.01]
    tag_map, seen = synthetic(np.random.default_rng(9), moved)
    found = moved_tags.judge_tags(seen, tag_map)
    assert found.row[found.suspect].tolist() == [3, 8]
    assert_allclose(found.offset_W[[3, 8]], moved[[3, 8]], atol=0.003)


def test_a_smooth_bend_of_the_whole_map_moves_no_tag_among_its_company():
    """A lens that is off scales, turns and shifts what it sees; a tag that was moved stands out."""
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.arange(8) * 0.4, np.arange(6) * 0.4)
    p_WT = np.stack([x.ravel(), y.ravel(), np.zeros(48)], axis=1)
    shift, turn, scale = np.array([0.03, -0.02, 0.01]), np.array([0.0, 0.0, 0.02]), 0.015
    bent = shift + np.cross(turn, p_WT) + scale * p_WT + 1e-4 * rng.standard_normal((48, 3))
    near = np.linalg.norm(p_WT[:, None] - p_WT, axis=-1) < 0.9
    together = np.where(near, 20.0, 0.0)
    assert np.linalg.norm(bent, axis=1).max() > 0.05
    assert np.linalg.norm(moved_tags.among(bent, p_WT, together), axis=1).max() < 0.005
    bent[20] += [0.0, 0.04, 0.0]
    alone = moved_tags.among(bent, p_WT, together)
    assert_allclose(alone[20], [0.0, 0.04, 0.0], atol=0.005)
    assert np.linalg.norm(np.delete(alone, 20, axis=0), axis=1).max() < 0.01


def test_a_tag_without_company_keeps_its_offset():
    offset = np.array([[0.01, 0.0, 0.0], [0.0, 0.02, 0.0]])
    assert_allclose(moved_tags.among(offset, np.eye(2, 3), np.eye(2)), offset)


def test_too_few_sightings_judge_nothing():
    tag_map, seen = synthetic(np.random.default_rng(1), np.zeros((12, 3)), cameras=4)
    assert len(moved_tags.judge_tags(seen, tag_map).row) == 0


def test_the_report_of_a_rendered_flight_names_the_moved_tag(tmp_path):
    """Images, the whole way: a tag of the map's file is moved, `tagvio compare` says which."""
    log = tmp_path / "log"
    way = "flight.waypoints=[[0,1.5,1.6,0.9,0],[3,1.5,3.0,1.1,30],[6,1.3,1.8,0.9,0]]"
    words = ["flight.name=waypoints", way, "flight.takeoff=false", "stream.rate_hz=3",
             "lens.supersample=2"]  # fmt: skip
    done = tagvio("simulate", "t1_qr", "--out", log, *(w for s in words for w in ("--set", s)))
    assert done.code == 0, done.err
    clean = tagvio("compare", log, "--out", tmp_path / "clean", "--vo-only")
    assert clean.code == 0, clean.err
    assert json.loads((tmp_path / "clean/evaluation.json").read_text())["suspect_tags"] == []
    assert "No tag is suspect" in (tmp_path / "clean/report.html").read_text()

    tag_map = load_map(log / "tagmap.yaml")
    near = np.linalg.norm(tag_map.p_WT[:, :2] - [1.5, 2.2], axis=1)
    row = int(np.argmin(np.where(tag_map.size > 0.09, near, np.inf)))
    p_WT = tag_map.p_WT.copy()
    p_WT[row] += [0.0, MOVED_M, 0.0]
    save_map(replace(tag_map, p_WT=p_WT), log / "tagmap.yaml")
    done = tagvio("compare", log, "--out", tmp_path / "moved", "--vo-only")
    assert done.code == 0, done.err
    (suspect,) = json.loads((tmp_path / "moved/evaluation.json").read_text())["suspect_tags"]
    assert suspect["id"] == tag_map.tag_id[row]
    assert_allclose(suspect["offset_m"], [0.0, -MOVED_M, 0.0], atol=0.01)
    text = f"tag {tag_map.tag_id[row]} disagrees with the map by"
    assert text in done.err
    assert f"tag {tag_map.tag_id[row]} disagrees by" in (tmp_path / "moved/report.html").read_text()

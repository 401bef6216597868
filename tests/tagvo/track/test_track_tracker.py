from dataclasses import replace

import numpy as np
import pytest
from oracles.false_lock_study import OFF_PX, lens, study
from oracles.vision import central_difference
from scipy.optimize import least_squares
from simulated import corners_seen, pinhole, pose_above
from track_views import CAMERA, COV, HIGH, LOW, MAP, TRACK, prior_of, view

from tagvo import geometry as geo
from tagvo.camera.model import project
from tagvo.config import TrackConfig
from tagvo.detect.protocol import no_detections
from tagvo.errors import TagvoError
from tagvo.kernels.projection import corner_covariance
from tagvo.pipeline import TagVO
from tagvo.records import Detections, Frame, PosePrior
from tagvo.tags.bitmaps import tag_bitmap
from tagvo.tags.families import FAMILIES
from tagvo.track import Tracker
from tagvo.track.pattern import PatternScratch, is_there
from tagvo.track.policy import (
    admitted,
)
from tagvo.track.predict import laying_px, posterior, project_tag
from tagvo.track.tag_model import (
    FLAT,
    Belief,
    Lens,
    Limits,
    TrackedTags,
    lens_of,
    map_arrays,
    printed_cells,
)


def projected(R_WC, p_WC, i):
    quad_n, quad_px, J = np.empty((4, 2)), np.empty((4, 2)), np.empty((4, 2, 6))
    seen = project_tag(R_WC, p_WC, map_arrays(MAP), i, lens_of(CAMERA), quad_n, quad_px, J)
    return seen, quad_px, J


def test_prediction_is_the_cameras_own_projection_and_its_derivative():
    R_WC, p_WC = pose_above(np.random.default_rng(1), 1.0, LOW, HIGH, tilt_deg=10.0)
    rows, px = corners_seen(MAP, CAMERA, R_WC, p_WC)
    for i in rows[::7].tolist():
        seen, quad, J = projected(R_WC, p_WC, i)

        def moved(xi, i=i):
            return projected(R_WC @ geo.exp(xi[3:]), p_WC + xi[:3], i)[1].ravel()

        assert seen
        np.testing.assert_allclose(quad, px[i], atol=1e-9)
        np.testing.assert_allclose(
            J.reshape(8, 6), central_difference(moved, 6), rtol=1e-5, atol=1e-4
        )


def test_predicted_spread_is_that_of_sampled_priors():
    rng = np.random.default_rng(2)
    R_WC, p_WC = pose_above(rng, 1.2, LOW, HIGH)
    A = rng.standard_normal((6, 6)) * np.sqrt(np.diag(COV))[:, None]
    P = 0.05 * A @ A.T
    i = int(corners_seen(MAP, CAMERA, R_WC, p_WC)[0][3])
    out = np.empty((4, 3))
    corner_covariance(projected(R_WC, p_WC, i)[2], P, out)
    xi = rng.multivariate_normal(np.zeros(6), P, 4000)
    R, p = R_WC @ geo.exp(xi[:, 3:]), p_WC + xi[:, :3]
    p_C = geo.transform(*(a[:, None] for a in geo.invert(R, p)), MAP.corners_W[i])
    for c in range(4):
        sampled = np.cov(project(CAMERA, p_C[:, c])[0].T)
        want = np.array([sampled[0, 0], sampled[0, 1], sampled[1, 1]])
        np.testing.assert_allclose(out[c], want, atol=0.08 * want.max())


def test_posterior_is_the_least_squares_of_prior_and_corners():
    rng = np.random.default_rng(3)
    R_WC, p_WC = pose_above(rng, 1.2, LOW, HIGH)
    rows, px = corners_seen(MAP, CAMERA, R_WC, p_WC)
    rows = rows[:3].astype(np.int64)
    prior, sigma = prior_of(R_WC, p_WC, rng), np.full((3, 4), 0.1)
    measured = px[rows] + 0.1 * rng.standard_normal((3, 4, 2))
    tags, camera = map_arrays(MAP), lens_of(CAMERA)
    R, p, P, chi = np.empty((3, 3)), np.empty(3), np.empty((6, 6)), np.empty(3)
    none = np.zeros(6, dtype=np.int64)
    found = TrackedTags(rows, measured, sigma, none, none * 0.1, none)
    known, out = Belief(prior.R_WC, prior.p_WC, prior.cov), Belief(R, p, P)
    assert posterior(known, tags, camera, found, 3, out, chi)
    lay = np.array([laying_px(R, p, tags, i, camera) for i in rows])
    weight = 1.0 / np.sqrt(0.1**2 + 4.0 * lay**2)

    def residual(xi):
        pose = prior.R_WC @ geo.exp(xi[3:]), prior.p_WC + xi[:3]
        at = np.array([projected(*pose, i)[1] for i in rows])
        r = (measured - at) * weight[:, None, None]
        return np.concatenate([r.ravel(), xi / np.sqrt(np.diag(COV))])

    best = least_squares(residual, np.zeros(6), x_scale=np.sqrt(np.diag(COV)))
    got = np.concatenate([p - prior.p_WC, geo.log(prior.R_WC.T @ R)])
    np.testing.assert_allclose(got, best.x, atol=2e-4)
    np.testing.assert_allclose(np.diag(P), np.diag(np.linalg.inv(best.jac.T @ best.jac)), rtol=0.05)


@pytest.mark.parametrize("height", [0.8, 1.2, 2.0])
def test_tracked_corners_are_the_exact_projection(height):
    """In a distorted image, XL tags (bent sides) and S tags alike; the stated sigma is honest."""
    errors, sigmas, found, of = [], [], 0, 0
    for seed in range(4):
        image, R_WC, p_WC, rng = view(seed, height)
        tracker = Tracker(CAMERA, MAP, TrackConfig(mode="on", sweep_s=0.0, max_tags=200))
        got = tracker(image, 0, prior_of(R_WC, p_WC, rng), lambda *_: no_detections())
        if got.counts == {"search_none_in_view": 1}:  # a low camera between the large tags
            continue
        assert got.detections is not None, got.counts
        rows, px = corners_seen(MAP, CAMERA, R_WC, p_WC, 8.0)
        side = np.linalg.norm(px[rows] - np.roll(px[rows], 1, axis=1), axis=2).min(axis=1)
        big = rows[side >= 18.5]
        found += np.isin(MAP.tag_id[big], got.detections.tag_id).sum()
        of += len(big)
        errors.append(got.detections.corners_px - px[MAP.rows(got.detections.tag_id)])
        sigmas.append(got.detections.sigma_px)
    error, sigma = np.concatenate(errors), np.concatenate(sigmas)
    assert of >= 4
    assert found >= 0.97 * of
    assert np.sqrt(np.mean(error**2)) < 0.06
    assert np.abs(error).max() < 0.6
    assert 0.4 < np.sqrt(np.mean((error / sigma[..., None]) ** 2)) < 1.5


ON_PIXELS = Lens(
    FLAT, np.zeros(4), np.zeros(8), np.array([400.0, 400.0]), 1e6, np.array([0.0, 399.0] * 2)
)


def reads_as(picture, cells, border, max_errors=0):
    """Wrong cells of a flat print with 8 px a cell, 16 px in from the image's corner; -1: no."""
    n = len(cells)
    pad = 16 - 0.5 + 8 * (n - border) / 2
    a, b = pad, pad + 8 * border
    quad = np.array([[a, a], [b, a], [b, b], [a, b]])
    work = PatternScratch(
        np.empty((n, n)), np.empty((8, 4)), np.empty((n * n, 3)), np.empty((3, 3)), np.empty(2)
    )
    tags = map_arrays(MAP)._replace(cells=cells[None], border=border)
    limits = Limits(10.0, max_errors, 12.0, 15.0, 64)
    read = is_there(picture, ON_PIXELS, quad, tags, 0, 8.0, limits, work)
    return read[0]


def printed(bitmap):
    return np.pad(np.kron(bitmap, np.ones((8, 8))).astype(np.uint8), 16, constant_values=128)


@pytest.mark.parametrize("family", FAMILIES.values(), ids=lambda f: f.name)
def test_the_cells_of_a_family_are_told_apart(family):
    """Own print: no cell wrong; the print of another id, or the same turned: not this tag."""
    rng = np.random.default_rng(4)
    ids = np.unique(np.r_[0, family.ids - 1, rng.integers(0, family.ids, 40)])
    cells = printed_cells(family, ids, 1)
    pictures = [printed(tag_bitmap(family, int(i))) for i in ids]
    for k in range(len(ids)):
        assert reads_as(pictures[k], cells[k], family.border_cells) == 0
        other = (k + 1) % len(ids)
        assert reads_as(pictures[other], cells[k], family.border_cells, 1) == -1
        turned = np.ascontiguousarray(np.rot90(pictures[k]))
        if family.apriltag:
            assert reads_as(turned, cells[k], family.border_cells, 1) == -1


def test_every_id_of_41h12_reads_as_itself_and_one_error_is_counted():
    family = FAMILIES["tagStandard41h12"]
    ids = np.arange(0, family.ids, 5)
    for tag_id, cells in zip(ids.tolist(), printed_cells(family, ids, 1), strict=True):
        bitmap = tag_bitmap(family, tag_id).copy()
        assert reads_as(printed(bitmap), cells, 5) == 0
        bitmap[0, 0] = 255 - bitmap[0, 0]
        assert reads_as(printed(bitmap), cells, 5, 0) == -1
        assert reads_as(printed(bitmap), cells, 5, 1) == 1


def test_a_print_that_lies_two_pixels_off_is_not_there():
    family = FAMILIES["tagStandard41h12"]
    cells = printed_cells(family, np.array([7]), 1)[0]
    picture = printed(tag_bitmap(family, 7))
    for shift in ((0, 2), (2, 0), (-2, -2)):
        moved = np.ascontiguousarray(np.roll(picture, shift, axis=(0, 1)))
        assert reads_as(moved, cells, 5, 1) == -1


BAD = {
    "no_prior": lambda p: None,
    "prior_from_the_future": lambda p: replace(p, t_ns=50_000_000),
    "prior_too_old": lambda p: replace(p, t_ns=-50_000_000),
    "prior_not_finite": lambda p: replace(p, p_WC=np.array([np.nan, 0.0, 1.0])),
    "prior_not_a_rotation": lambda p: replace(p, R_WC=2.0 * p.R_WC),
    "prior_singular": lambda p: replace(p, cov=np.zeros((6, 6))),
    "prior_too_wide": lambda p: replace(p, cov=100.0 * p.cov + np.eye(6)),
}


@pytest.mark.parametrize("cause", BAD)
def test_a_bad_prior_is_counted_and_the_image_searched_whole(cause):
    image, R_WC, p_WC, _ = view(5)
    prior = BAD[cause](prior_of(R_WC, p_WC))
    assert admitted(prior, 0) == (None, cause)
    trace = TagVO(CAMERA, MAP, TRACK).trace(Frame(0, image), prior)
    assert trace.counts[f"search_{cause}"] == 1
    assert "tracked_frames" not in trace.counts
    assert np.linalg.norm(trace.pose.p_WC - p_WC) < 0.005


def test_an_admitted_prior_is_the_nearest_rotation_and_exactly_symmetric():
    rng = np.random.default_rng(2)
    for _ in range(20):
        R_WC = geo.exp(rng.standard_normal(3)) + 1e-4 * rng.standard_normal((3, 3))
        A = 1e-2 * rng.standard_normal((6, 6))
        cov = A @ A.T + 1e-9 * rng.standard_normal((6, 6)) + 1e-8 * np.eye(6)
        sound, fault = admitted(PosePrior(0, rng.standard_normal(3), R_WC, cov), 0)
        assert fault is None
        np.testing.assert_allclose(sound.R_WC, geo.project_to_so3(R_WC), atol=1e-13)
        np.testing.assert_array_equal(sound.cov, sound.cov.T)
        np.testing.assert_allclose(sound.cov, 0.5 * (cov + cov.T), rtol=1e-15)


@pytest.mark.parametrize("share", [0.98, 1.02])
def test_a_rotation_may_be_unsure_by_six_degrees_in_any_direction(share):
    """The largest eigenvalue, against NumPy's, just within and just beyond the limit."""
    rng = np.random.default_rng(3)
    for spectrum in ([1.0, 0.1, 0.1], [1.0, 1.0, 0.2], [1.0, 1.0, 1.0], [1.0, 1e-6, 1e-3]):
        Q = geo.exp(rng.standard_normal(3))
        cov = 1e-4 * np.eye(6)
        cov[3:, 3:] = share * np.radians(6.0) ** 2 * Q @ np.diag(spectrum) @ Q.T
        wide = np.linalg.eigvalsh(cov[3:, 3:])[-1] > np.radians(6.0) ** 2
        assert wide == (share > 1.0)
        fault = admitted(PosePrior(0, np.zeros(3), np.eye(3), cov), 0)[1]
        assert fault == ("prior_too_wide" if wide else None)


@pytest.mark.parametrize(
    "cov", [COV * 1e-12, np.where(np.eye(6) > 0, -COV, 0), np.full((6, 6), np.inf)]
)
def test_an_absurd_covariance_never_makes_a_wrong_pose(cov):
    image, R_WC, p_WC, _ = view(6)
    prior = replace(prior_of(R_WC, p_WC + np.array([0.03, 0.0, 0.0])), cov=cov)
    trace = TagVO(CAMERA, MAP, TRACK).trace(Frame(0, image), prior)
    assert np.linalg.norm(trace.pose.p_WC - p_WC) < 0.005


def test_a_wrong_prior_is_searched_whole_in_the_same_frame():
    image, R_WC, p_WC, _ = view(7)
    prior = prior_of(R_WC, p_WC + np.array([0.3, 0.2, 0.0]))
    trace = TagVO(CAMERA, MAP, TRACK).trace(Frame(0, image), prior)
    assert trace.counts.get("search_too_few", 0) + trace.counts.get("search_too_small_a_share", 0)
    assert np.linalg.norm(trace.pose.p_WC - p_WC) < 0.005


def test_a_tag_in_view_by_the_prior_alone_holds_nothing_up():
    """Two tags; at the camera's true height one is smaller than the least side. (It hung.)"""
    image, R_WC, p_WC, _ = view(1, 1.2)
    rows, px = corners_seen(MAP, CAMERA, R_WC, p_WC, 12.0)
    rows = rows[np.argsort(geo.shortest_sides(px[rows]))]
    pair = MAP.only(MAP.tag_id[[rows[0], rows[-1]]])
    lower, got = prior_of(R_WC, p_WC - np.array([0.0, 0.0, 0.025])), []
    for share in np.linspace(0.99, 1.03, 9):
        least = share * geo.shortest_sides(px[rows[:1]])[0]
        tracker = Tracker(CAMERA, pair, TrackConfig(mode="on", sweep_s=0.0, min_side_px=least))
        got.append(tracker(image, 0, lower, lambda *_: no_detections()))
    assert got[0].tried == 2
    assert got[-1].tried == 1
    assert all(MAP.tag_id[rows[-1]] in g.detections.tag_id for g in got)


def test_tracked_frames_give_the_pose_that_detected_ones_give():
    for seed in range(3):
        image, R_WC, p_WC, rng = view(seed, 1.0)
        whole = TagVO(CAMERA, MAP).trace(Frame(0, image))
        prior = prior_of(R_WC, p_WC, rng)
        vo = TagVO(CAMERA, MAP, TRACK)
        for picture in (image, np.repeat(image[..., None], 3, axis=2)):  # grey, and BGR
            trace = vo.trace(Frame(0, picture), prior)
            assert trace.counts["tracked_frames"] == 1
            assert np.linalg.norm(trace.pose.p_WC - whole.pose.p_WC) < 0.002
            assert geo.angle(trace.pose.R_WC.T @ whole.pose.R_WC) < np.radians(0.1)


def test_an_image_of_another_size_is_refused():
    _, R_WC, p_WC, _ = view(8)
    small = np.zeros((240, 320), dtype=np.uint8)
    with pytest.raises(TagvoError, match="320x240 pixels; the camera file says 640x480"):
        TagVO(CAMERA, MAP, TRACK).trace(Frame(0, small), prior_of(R_WC, p_WC))


def test_what_a_strip_contradicts_is_dropped_and_the_next_frame_searched():
    image, R_WC, p_WC, _ = view(9)
    tracker = Tracker(CAMERA, MAP, TrackConfig(mode="on", strips=1))
    clean = tracker(image, 0, prior_of(R_WC, p_WC), lambda *_: no_detections()).detections
    victim = clean[:1]

    def search(part, decimate):
        return Detections.of(victim.tag_id, victim.corners_px + 9.0)

    tracker = Tracker(CAMERA, MAP, TrackConfig(mode="on", strips=1))
    got = tracker(image, 0, prior_of(R_WC, p_WC), search)
    assert got.counts["strip_contradicts"] == 1
    at = got.detections.tag_id == victim.tag_id[0]
    assert np.abs(got.detections.corners_px[at] - victim.corners_px - 9.0).max() < 1e-9
    after = tracker(image, 1_000_000, prior_of(R_WC, p_WC, t_ns=1_000_000), search)
    assert after.detections is None
    assert after.counts == {"search_contradiction": 1}


def test_no_false_lock_under_wrong_priors_and_disturbed_floors():
    """The long run is tools/false_lock.py."""
    tally = study(images=24, priors=6, seed=77)
    assert sum(tally.off.values()) == 0, tally
    assert tally.worst_px < OFF_PX
    assert sum(tally.tags.values()) > 500
    assert pinhole().resolution == lens().resolution

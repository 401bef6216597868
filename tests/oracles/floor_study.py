"""The paper's variants and the joint pose on rendered views of a floor: who is off by how much.

Shared by tools/floor_table.py and test_tagvo_floor.py. Every image is searched once, by the real
detector; all variants work on what it found, with the sigma that the image gave each corner.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from simulated import pose_above

from tagvo import geometry as geo
from tagvo.camera.model import Camera, project
from tagvo.config import TagvoConfig
from tagvo.geometry import Array
from tagvo.pipeline import TagVO, Trace
from tagvo.records import Detections, Frame
from tagvo.render.view import Look, displaced, render_view
from tagvo.tags.tag_map import TagMap

SELECTIONS = {  # the paper's name: THS, OR
    "JBT": ("JBT", "none"),
    "ALL-notOR": ("ALL", "none"),
    "ALL-OR": ("ALL", "iqr"),
    "TBS-notOR": ("TBS", "none"),
    "TBS-OR": ("TBS", "iqr"),
}
WEIGHTS, MEANS = ("W1", "W2"), ("QL2", "CL2")
SMALL_SPREAD = np.radians(3.0)  # of the averaged rotations about their mean
LOOK = Look(texture=12.0)
GREY_NOISE = 2.0


@dataclass(frozen=True)
class View:
    """One place: the true pose of the camera and what the detector found there."""

    height: float
    R_WC: Array
    p_WC: Array
    detections: Detections


@dataclass(frozen=True)
class Errors:
    """Of each view, in order: position [cm] and rotation [deg]; NaN where there was no pose."""

    position_cm: Array
    rotation_deg: Array


def variants(ambiguity: str = "first") -> dict[str, TagvoConfig]:
    """Every column of the paper by name, W x mean each, and the joint pose at its defaults."""
    out = {
        f"{name} {w}+{m}": TagvoConfig(
            pose="fused", select=select, outliers=outliers, weights=w, mean=m, ambiguity=ambiguity
        )
        for name, (select, outliers) in SELECTIONS.items()
        for w in WEIGHTS
        for m in MEANS
    }
    return {**out, "joint": TagvoConfig()}


def views(
    tag_map: TagMap,
    camera: Camera,
    height: float,
    count: int,
    seed: int,
    *,
    misplaced: bool,
    exact_corners: bool = False,
) -> Iterator[View]:
    """Rendered places over the map's area, the same for each way the tags lie; tags found there.

    misplaced: every tag laid anew for each place, with errors of the map's own sigmas (the
    solvers get the map as it should be). exact_corners: found tags, but with projected corners.
    """
    low, high = tag_map.p_WT[:, :2].min(axis=0), tag_map.p_WT[:, :2].max(axis=0)
    vo = TagVO(camera, tag_map)
    for k in range(count):
        place, laying, grey = np.random.default_rng([seed, round(1e3 * height), k]).spawn(3)
        R_WC, p_WC = pose_above(place, height, low, high)
        floor = displaced(tag_map, laying) if misplaced else tag_map
        image = render_view(floor, camera, R_WC, p_WC, look=LOOK, noise_sigma=GREY_NOISE, rng=grey)
        found = vo.trace(Frame(k, image)).detections
        if exact_corners:
            found = _projected(found, floor, camera, R_WC, p_WC)
        yield View(height, R_WC, p_WC, found)


def _projected(
    found: Detections, floor: TagMap, camera: Camera, R_WC: Array, p_WC: Array
) -> Detections:
    R_CW, p_CW = geo.invert(R_WC, p_WC)
    corners = floor.corners_W[floor.rows(found.tag_id)]
    return replace(found, corners_px=project(camera, geo.transform(R_CW, p_CW, corners))[0])


@dataclass(frozen=True)
class Study:
    """Errors of each variant on the same views, and how far QL2 and CL2 are apart.

    gap_deg: angle between the two of every view and selection with small spreads; all_gaps_deg:
    of every view.
    """

    errors: dict[str, Errors]
    gap_deg: Array
    all_gaps_deg: Array


def study(
    seen: list[View],
    tag_map: TagMap,
    camera: Camera,
    configs: dict[str, TagvoConfig],
    step: Callable[[], None] = lambda: None,
) -> Study:
    """Run every configuration over the same detections."""
    vos = {name: TagVO(camera, tag_map, cfg) for name, cfg in configs.items()}
    rows: dict[str, list[tuple[float, float]]] = {name: [] for name in vos}
    gaps: list[tuple[float, float]] = []
    for view in seen:
        frame = Frame(0, detections=view.detections)
        traces = {name: vo.trace(frame) for name, vo in vos.items()}
        for name, trace in traces.items():
            rows[name].append(_error(trace, view))
        gaps += _gaps(traces)
        step()
    spread, gap = np.array(gaps).reshape(-1, 2).T
    errors = {name: Errors(*np.array(r).reshape(-1, 2).T) for name, r in rows.items()}
    return Study(errors, np.degrees(gap[spread < SMALL_SPREAD]), np.degrees(gap))


def _error(trace: Trace, view: View) -> tuple[float, float]:
    if trace.pose is None:
        return np.nan, np.nan
    turn = geo.angle(view.R_WC.T @ trace.pose.R_WC)
    shift = np.linalg.norm(trace.pose.p_WC - view.p_WC)
    return 100.0 * float(shift), float(np.degrees(turn))


def _gaps(traces: dict[str, Trace]) -> Iterator[tuple[float, float]]:
    """(largest turn of an averaged rotation from the mean, turn of CL2 from QL2) [rad]."""
    for name, trace in traces.items():
        twin = traces.get(name.replace("QL2", "CL2"))
        if twin is None or twin is trace or trace.fused is None or twin.fused is None:
            continue
        assert trace.imu_poses is not None
        R_mean = trace.fused.R_WI
        spread = geo.angle(R_mean.T @ trace.imu_poses[trace.kept].R_WI).max()
        yield float(spread), float(geo.angle(R_mean.T @ twin.fused.R_WI))

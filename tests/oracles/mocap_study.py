"""Real photographs against motion capture: the one measurement here that nobody simulated.

Shared by tools/eval_mocap.py and test_pose_mocap.py. Frames: M motion capture, B the camera's
marker body, G the board's marker grid, C camera, W the printed board (the tag map). T_BC and T_GW
are not given: they are fitted on all photographs but one, and judge that one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

from tagvo import geometry as geo
from tagvo.camera.calibration import load_camera
from tagvo.camera.model import Camera
from tagvo.config import TagvoConfig
from tagvo.geometry import Array, IntArray
from tagvo.pipeline import TagVO
from tagvo.records import Detections, Frame
from tagvo.tags.tag_map import TagMap, load_map
from vio.sources.flight_log.files import read_detections
from vio.sources.flight_log.log_frames import read_image
from vio.sources.flight_log.tally import Tally

SIGMA_M, SIGMA_RAD = 5e-3, np.radians(0.3)  # weights of the fit: the spread of one photograph
Pose = tuple[Array, Array]  # R (..., 3, 3), p (..., 3)


@dataclass(frozen=True)
class MocapSet:
    """The photographs, the corners shipped with them, and motion capture at their stamps.

    image, shipped: by stamp; T_GB: pose of the camera's body in the board's marker grid, (n, ...).
    """

    camera: Camera
    tag_map: TagMap
    t_ns: IntArray
    image: Mapping[int, np.ndarray]
    shipped: Mapping[int, Detections]
    T_GB: Pose


def load_mocap_set(folder: Path) -> MocapSet:
    """`mocap_aprilgrid`; motion capture interpolated to the stamps of the photographs."""
    table = read_detections(folder / "detections.csv", Tally())
    t_ns = np.array(sorted(int(p.stem) for p in (folder / "images").glob("*.jpg")), dtype=np.int64)
    images = {int(t): read_image(folder / "images" / f"{t}.jpg") for t in t_ns}
    R_MB, p_MB = _interpolated(folder / "mocap_body0.csv", t_ns)
    R_MG, p_MG = _interpolated(folder / "mocap_target0.csv", t_ns)
    return MocapSet(
        load_camera(folder / "camera.yaml"),
        load_map(folder / "tagmap.yaml"),
        t_ns,
        {t: image for t, image in images.items() if image is not None},
        {int(t): table.tags[table.t_ns == t] for t in t_ns},
        geo.compose(*geo.invert(R_MG, p_MG), R_MB, p_MB),
    )


def _interpolated(path: Path, t_ns: IntArray) -> Pose:
    """Poses of a motion capture file (x y z, quaternion xyzw) at these stamps."""
    stamps = np.loadtxt(path, delimiter=",", skiprows=1, usecols=0, dtype=np.int64)
    values = np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(1, 8))
    at, known = (t_ns - stamps[0]) * 1e-9, (stamps - stamps[0]) * 1e-9
    R = Slerp(known, Rotation.from_quat(values[:, 3:]))(at).as_matrix()
    p = np.stack([np.interp(at, known, x) for x in values[:, :3].T], axis=-1)
    return R, p


@dataclass(frozen=True)
class Found:
    """What our detector found in the photographs, against the corners shipped with them."""

    detections: Mapping[int, Detections]
    photos: int
    tags: int
    tags_shipped: int
    corner_rms_px: float


def detect_all(data: MocapSet) -> Found:
    """Our detections by stamp; counts are of tags that the shipped file has, too."""
    vo = TagVO(data.camera, data.tag_map)
    found = {t: vo.trace(Frame(t, image)).detections for t, image in data.image.items()}
    distances, photos = [], 0
    for t, det in found.items():
        shipped = data.shipped[t]
        _, ours, theirs = np.intersect1d(det.tag_id, shipped.tag_id, return_indices=True)
        gap = det.corners_px[ours] - shipped.corners_px[theirs]
        distances.append(np.linalg.norm(gap, axis=-1))
        photos += len(ours) > 0
    all_distances = np.concatenate(distances)
    rms = float(np.sqrt(np.square(all_distances).mean()))
    total = sum(len(d) for d in data.shipped.values())
    return Found(found, photos, len(all_distances), total, rms)


def tagvo_poses(
    data: MocapSet, detections: Mapping[int, Detections], config: TagvoConfig | None = None
) -> dict[int, Pose]:
    """T_WC by stamp of the pipeline."""
    vo = TagVO(data.camera, data.tag_map, config)
    poses = {t: vo(Frame(t, detections=det)) for t, det in detections.items()}
    return {t: (m.R_WC, m.p_WC) for t, m in poses.items() if m is not None}


def plain_pnp(data: MocapSet, detections: Mapping[int, Detections]) -> dict[int, Pose]:
    """T_WC by stamp as most software has it: SQPNP over all corners, refined by LM."""
    fu, fv, pu, pv = data.camera.intrinsics
    K, d = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]]), data.camera.coeffs
    out = {}
    for t, det in detections.items():
        if not len(det):
            continue
        X = data.tag_map.corners_W[data.tag_map.rows(det.tag_id)].reshape(-1, 3)
        x = det.corners_px.reshape(-1, 2)
        _, r, p = cv2.solvePnP(X, x, K, d, flags=cv2.SOLVEPNP_SQPNP)
        r, p = cv2.solvePnPRefineLM(X, x, K, d, r, p)
        out[t] = geo.invert(geo.exp(r.ravel()), p.ravel())
    return out


def leave_one_out(data: MocapSet, T_WC: Mapping[int, Pose]) -> tuple[Array, Array]:
    """Error of each photograph's pose against motion capture, fitted on the others; (n,) m, rad."""
    rows = np.flatnonzero([int(t) in T_WC for t in data.t_ns])
    R_WC = np.array([T_WC[int(data.t_ns[i])][0] for i in rows])
    p_WC = np.array([T_WC[int(data.t_ns[i])][1] for i in rows])
    R_GB, p_GB = data.T_GB[0][rows], data.T_GB[1][rows]
    shift, turn = np.empty(len(rows)), np.empty(len(rows))
    for k in range(len(rows)):
        rest = np.arange(len(rows)) != k
        fit = fit_transforms((R_GB[rest], p_GB[rest]), (R_WC[rest], p_WC[rest]))
        R, p = predict(*fit, (R_GB[k], p_GB[k]))
        shift[k] = np.linalg.norm(p_WC[k] - p)
        turn[k] = geo.angle(R.T @ R_WC[k])
    return shift, turn


def predict(T_BC: Pose, T_GW: Pose, T_GB: Pose) -> Pose:
    """T_WC as motion capture has it."""
    return geo.compose(*geo.invert(*T_GW), *geo.compose(*T_GB, *T_BC))


def hand_eye(T_GB: Pose, T_WC: Pose) -> tuple[Pose, Pose]:
    """T_BC and T_GW with T_GB T_BC = T_GW T_WC, in closed form: rotations, then positions."""
    (R_GB, p_GB), (R_WC, p_WC), eye = T_GB, T_WC, np.eye(3)
    rows = [
        np.hstack([np.kron(A, eye), -np.kron(eye, B.T)]) for A, B in zip(R_GB, R_WC, strict=True)
    ]
    both = np.linalg.svd(np.vstack(rows))[2][-1].reshape(2, 3, 3)  # vec(R_BC), vec(R_GW), scaled
    R_BC, R_GW = geo.project_to_so3(both * np.sign(np.linalg.det(both[0])))
    lhs = np.vstack([np.hstack([A, -eye]) for A in R_GB])
    p = np.linalg.lstsq(lhs, (p_WC @ R_GW.T - p_GB).ravel(), rcond=None)[0]
    return (R_BC, p[:3]), (R_GW, p[3:])


def fit_transforms(T_GB: Pose, T_WC: Pose) -> tuple[Pose, Pose]:
    """T_BC and T_GW from n pairs, T_GB T_BC = T_GW T_WC.

    Least squares over position / 5 mm and rotation / 0.3 deg with a soft L1 loss, from the closed
    form.
    """
    T_BC, T_GW = hand_eye(T_GB, T_WC)

    def moved(x: Array) -> tuple[Pose, Pose]:
        return geo.compose(*T_BC, *geo.exp_se3(x[:6])), geo.compose(*T_GW, *geo.exp_se3(x[6:]))

    def residuals(x: Array) -> Array:
        R, p = predict(*moved(x), T_GB)
        turn = geo.log(np.swapaxes(R, -1, -2) @ T_WC[0])
        return np.concatenate([(p - T_WC[1]) / SIGMA_M, turn / SIGMA_RAD]).ravel()

    return moved(least_squares(residuals, np.zeros(12), loss="soft_l1").x)

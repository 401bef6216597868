"""What a viewer is shown, as Foxglove messages: pictures, outlines, map, body and its trail."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from foxglove import messages as fox

from tagvo import geometry as geo
from tagvo.camera.model import Camera, project
from tagvo.geometry import Array, BoolArray
from tagvo.records import Observations
from tagvo.tags.tag_map import TagMap

MAP, BODY, CAMERA = "map", "imu", "camera"
_WIDTH = 640
_GREEN, _RED, _BLUE = (0.2, 0.8, 0.3), (0.9, 0.2, 0.2), (0.3, 0.6, 1.0)
_MODELS = {"radtan": "plumb_bob", "equidistant": "kannala_brandt", "none": "plumb_bob"}
Image = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """The filter at a moment: p_WI (3,), R_WI (3, 3), v_WI (3,) and cov (6, 6) or None."""

    t_ns: int
    p_WI: Array
    R_WI: Array
    v_WI: Array | None
    cov: Array | None


def image(t_ns: int, picture: Image) -> fox.CompressedImage:
    """A JPEG of at most 640 pixels' width."""
    scale = min(1.0, _WIDTH / picture.shape[1])
    if scale < 1.0:
        small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        picture = np.asarray(small, dtype=np.uint8)
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 70])
    return fox.CompressedImage(
        timestamp=stamp(t_ns), frame_id=CAMERA, data=data.tobytes(), format="jpeg"
    )


def calibration(t_ns: int, camera: Camera) -> fox.CameraCalibration:
    """The calibration of the pictures as they are sent."""
    width, height = camera.resolution
    scale = min(1.0, _WIDTH / width)
    fu, fv, pu, pv = (float(x) * scale for x in camera.intrinsics)
    K = [fu, 0.0, pu, 0.0, fv, pv, 0.0, 0.0, 1.0]
    D = [float(x) for x in camera.coeffs]
    return fox.CameraCalibration(
        timestamp=stamp(t_ns), frame_id=CAMERA, width=round(scale * width),
        height=round(scale * height), distortion_model=_MODELS[camera.model],
        D=D + [0.0] * max(0, (4 if camera.model == "equidistant" else 5) - len(D)), K=K,
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[*K[:3], 0.0, *K[3:6], 0.0, *K[6:], 0.0],
    )  # fmt: skip


def outlines(
    t_ns: int, seen: Observations, rejected: BoolArray, predicted: Sequence[Array], width: int
) -> fox.ImageAnnotations:
    """Tags in use (green), rejected (red), and where tags were expected (blue), in the picture."""
    scale = min(1.0, _WIDTH / width)
    points = [_outline(scale * corners, _BLUE, 1.0) for corners in predicted]
    texts = []
    for i in range(len(seen)):
        corners = scale * seen.corners_px[i]
        points.append(_outline(corners, _RED if rejected[i] else _GREEN, 2.0))
        x, y = corners.mean(axis=0)
        texts.append(
            fox.TextAnnotation(
                timestamp=stamp(t_ns), position=fox.Point2(x=float(x), y=float(y)),
                text=str(int(seen.tag_id[i])), font_size=10.0, text_color=_colour((1.0, 1.0, 1.0)),
            )
        )  # fmt: skip
    return fox.ImageAnnotations(timestamp=stamp(t_ns), points=points, texts=texts)


def expected(tag_map: TagMap, camera: Camera, R_WC: Array, p_WC: Array) -> list[Array]:
    """Corners (4, 2) of each tag of the map that lies wholly in the picture."""
    corners = tag_map.corners_W.reshape(-1, 3)
    near = np.linalg.norm(tag_map.p_WT - p_WC, axis=-1) < 60.0 * tag_map.size
    pixels, seen = project(camera, (corners - p_WC) @ R_WC)
    pixels, front = pixels.reshape(-1, 4, 2), np.asarray(seen.reshape(-1, 4).all(axis=1))
    size = np.array(camera.resolution, dtype=float)
    inside = front & near & ((pixels >= 0.0) & (pixels <= size)).all(axis=(1, 2))
    return list(pixels[inside])


def map_scene(t_ns: int, tag_map: TagMap) -> fox.SceneUpdate:
    """The outlines of all tags, as one entity that stays."""
    corners = tag_map.corners_W[:, [0, 1, 1, 2, 2, 3, 3, 0]].reshape(-1, 3)
    lines = fox.LinePrimitive(
        type=fox.LinePrimitiveLineType.LineList, thickness=1.5, scale_invariant=True,
        points=_points(corners), color=_colour((0.6, 0.6, 0.6)),
    )  # fmt: skip
    entity = fox.SceneEntity(timestamp=stamp(t_ns), frame_id=MAP, id="tags", lines=[lines])
    return fox.SceneUpdate(entities=[entity])


def body_scene(body: Body, trail: Array) -> fox.SceneUpdate:
    """The trail (n, 3), and three sigma of the position as an ellipsoid."""
    path = fox.LinePrimitive(
        type=fox.LinePrimitiveLineType.LineStrip, thickness=2.0, scale_invariant=True,
        points=_points(trail), color=_colour((0.9, 0.5, 0.1)),
    )  # fmt: skip
    spheres = []
    if body.cov is not None and np.isfinite(body.cov).all():
        values, vectors = np.linalg.eigh(body.cov[:3, :3])
        vectors[:, 0] *= np.sign(np.linalg.det(vectors))
        x, y, z = (float(v) for v in 6.0 * np.sqrt(np.maximum(values, 1e-12)))
        spheres.append(
            fox.SpherePrimitive(
                pose=_pose(body.p_WI, vectors), size=fox.Vector3(x=x, y=y, z=z),
                color=fox.Color(r=0.9, g=0.5, b=0.1, a=0.35),
            )
        )  # fmt: skip
    entity = fox.SceneEntity(
        timestamp=stamp(body.t_ns), frame_id=MAP, id="body", lines=[path], spheres=spheres
    )
    return fox.SceneUpdate(entities=[entity])


def transforms(body: Body, camera: Camera) -> fox.FrameTransforms:
    """Body in the map, camera at the body."""
    R_IC, p_IC = geo.invert(camera.R_CI, camera.p_CI)
    return fox.FrameTransforms(transforms=[
        _transform(body.t_ns, MAP, BODY, body.R_WI, body.p_WI),
        _transform(body.t_ns, BODY, CAMERA, R_IC, p_IC),
    ])  # fmt: skip


def stamp(t_ns: int) -> fox.Timestamp:
    """A time of ours as a message's."""
    seconds, rest = divmod(max(t_ns, 0), 1_000_000_000)
    return fox.Timestamp(sec=seconds, nsec=rest)


def _transform(t_ns: int, parent: str, child: str, R: Array, p: Array) -> fox.FrameTransform:
    x, y, z = (float(v) for v in p)
    return fox.FrameTransform(
        timestamp=stamp(t_ns), parent_frame_id=parent, child_frame_id=child,
        translation=fox.Vector3(x=x, y=y, z=z), rotation=_quaternion(R),
    )  # fmt: skip


def _pose(p: Array, R: Array) -> fox.Pose:
    x, y, z = (float(v) for v in p)
    return fox.Pose(position=fox.Vector3(x=x, y=y, z=z), orientation=_quaternion(R))


def _quaternion(R: Array) -> fox.Quaternion:
    w, x, y, z = (float(v) for v in geo.quat_from_matrix(R))
    return fox.Quaternion(x=x, y=y, z=z, w=w)


def _outline(corners: Array, tint: tuple[float, float, float], thickness: float) -> Any:
    return fox.PointsAnnotation(
        type=fox.PointsAnnotationType.LineLoop, thickness=thickness, outline_color=_colour(tint),
        points=[fox.Point2(x=float(x), y=float(y)) for x, y in corners],
    )  # fmt: skip


def _points(p: Array) -> "list[fox.Point3]":
    return [fox.Point3(x=float(x), y=float(y), z=float(z)) for x, y, z in p]


def _colour(tint: tuple[float, float, float]) -> fox.Color:
    return fox.Color(r=tint[0], g=tint[1], b=tint[2], a=1.0)

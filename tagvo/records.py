"""The frozen records that flow from pixels to pose; many tags are one record of arrays."""

from dataclasses import dataclass

import numpy as np

from tagvo.geometry import Array, BoolArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """Tags found in one image, before any filter.

    tag_id (n,); corners_px (n, 4, 2) TL, TR, BR, BL of the upright tag, pixel centres at integers;
    hamming (n,) corrected bits; margin (n,) decision margin, NaN where the source has none;
    sigma_px (n, 4) standard deviation of each corner per axis, NaN: take the configured one.
    """

    tag_id: IntArray
    corners_px: Array
    hamming: IntArray
    margin: Array
    sigma_px: Array

    def __len__(self) -> int:
        return len(self.tag_id)

    def __getitem__(self, rows: BoolArray | IntArray | slice) -> "Detections":
        return Detections(
            self.tag_id[rows],
            self.corners_px[rows],
            self.hamming[rows],
            self.margin[rows],
            self.sigma_px[rows],
        )

    @staticmethod
    def of(
        tag_id: IntArray,
        corners_px: Array,
        hamming: IntArray | None = None,
        margin: Array | None = None,
        sigma_px: Array | None = None,
    ) -> "Detections":
        """Detections from ids (n,) and corners (n, 4, 2) [px]; the rest defaults to unknown.

        Corners are laid out row by row whatever they came as: compiled code is compiled again for
        every other layout, half a minute in the middle of a flight.
        """
        n = len(tag_id)
        return Detections(
            np.asarray(tag_id, dtype=np.int64).reshape(n),
            np.ascontiguousarray(corners_px, dtype=float).reshape(n, 4, 2),
            np.zeros(n, dtype=np.int64) if hamming is None else np.asarray(hamming, np.int64),
            np.full(n, np.nan) if margin is None else np.asarray(margin, dtype=float),
            np.full((n, 4), np.nan) if sigma_px is None else np.ascontiguousarray(sigma_px, float),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One camera frame: an image, or what a detector found in it.

    t_ns: middle of the exposure in the camera's clock, uncorrected; image (h, w) or (h, w, 3)
    uint8, or None; detections: used in place of the image where given; arrival_ns: when the frame
    was known, in the clock of the consumer; None: at its stamp; received_ns: when its image came
    from the camera, before its tags were known; None: at arrival_ns; camera: index of the camera.
    """

    t_ns: int
    image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]] | None = None
    detections: Detections | None = None
    arrival_ns: int | None = None
    received_ns: int | None = None
    camera: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Detections of tags on the map, ready for geometry.

    row (n,) index of each tag in the map; corners_px (n, 4, 2); corners_n (n, 4, 2) normalised
    image coordinates x/z, y/z; J_px_n (n, 4, 2, 2) d pixel / d normalised; sigma_px (n, 4);
    camera: index of the camera.
    """

    row: IntArray
    tag_id: IntArray
    corners_px: Array
    corners_n: Array
    J_px_n: Array
    sigma_px: Array
    camera: int = 0

    def __len__(self) -> int:
        return len(self.tag_id)

    def __getitem__(self, rows: BoolArray | IntArray | slice) -> "Observations":
        return Observations(
            self.row[rows],
            self.tag_id[rows],
            self.corners_px[rows],
            self.corners_n[rows],
            self.J_px_n[rows],
            self.sigma_px[rows],
            self.camera,
        )


@dataclass(frozen=True, slots=True, eq=False)
class TagPoses:
    """Both planar solutions of each tag, the better one first.

    p_CT (n, 2, 3) [m], R_CT (n, 2, 3, 3): tag in camera; rms_px (n, 2) reprojection error, inf
    where a solution does not exist; information (n, 2, 6, 6) of [p_CT in T, right rotation in T]
    from the corners' noise [1/m^2, 1/rad^2].
    """

    p_CT: Array
    R_CT: Array
    rms_px: Array
    information: Array

    def __len__(self) -> int:
        return len(self.p_CT)

    @property
    def cov(self) -> Array:
        """Covariance of each solution, the inverse of its information; (n, 2, 6, 6)."""
        slack = np.einsum("...ii->...i", self.information)[..., None] * np.eye(6)
        return np.asarray(np.linalg.inv(self.information + 1e-12 * (slack + np.eye(6))))


@dataclass(frozen=True, slots=True, eq=False)
class ImuPoses:
    """One pose of the IMU in the map from each tag; the paper's T_WB_i, where I is called B.

    tag_id (n,); size (n,) border side [m]; level (n,) h = log2(size / smallest in the map);
    area_px (n,) image area [px^2]; p_WI (n, 3) [m]; R_WI (n, 3, 3).
    """

    tag_id: IntArray
    size: Array
    level: Array
    area_px: Array
    p_WI: Array
    R_WI: Array

    def __len__(self) -> int:
        return len(self.tag_id)

    def __getitem__(self, rows: BoolArray | IntArray) -> "ImuPoses":
        return ImuPoses(
            self.tag_id[rows],
            self.size[rows],
            self.level[rows],
            self.area_px[rows],
            self.p_WI[rows],
            self.R_WI[rows],
        )


@dataclass(frozen=True, slots=True, eq=False)
class PosePrior:
    """Where the camera should be: p_WC (3,) [m], R_WC (3, 3), cov (6, 6) as in PoseMeasurement."""

    t_ns: int
    p_WC: Array
    R_WC: Array
    cov: Array


@dataclass(frozen=True, slots=True, eq=False)
class PoseMeasurement:
    """tagvo's output: the pose of the camera in the map at one moment.

    t_ns: exposure midpoint, camera clock, uncorrected; p_WC (3,) [m]; R_WC (3, 3); cov (6, 6) of
    [p in W, right rotation in C], honest for this one frame [m^2, rad^2]; tag_ids used;
    flags: degraded, or_skipped, ambiguous, ... (sorted); camera: index of the camera.
    """

    t_ns: int
    p_WC: Array
    R_WC: Array
    cov: Array
    tag_ids: tuple[int, ...]
    flags: tuple[str, ...] = ()
    camera: int = 0

"""Finds tags in images: one protocol, one adapter a library, one convention of corners."""

from tagvo.detect.protocol import Detector
from tagvo.errors import DetectorError, choose_one_of
from tagvo.tags.families import Family

LIBRARIES = ("auto", "apriltag", "aruco")

__all__ = ["LIBRARIES", "Detector", "make_detector"]


def make_detector(
    library: str,
    family: Family,
    *,
    border_bits: int = 1,
    decimate: float | None = None,
    max_hamming: int = 1,
    threads: int = 1,
) -> Detector:
    """The detector for a family; auto: the AprilTag library where it reads it, else OpenCV.

    border_bits: as in the map (the AprilTag library reads 1 only); decimate (AprilTag library):
    None takes 1.5 for images narrower than 1280, 2 from there; max_hamming: bits corrected.
    """
    if library not in LIBRARIES:
        raise DetectorError(choose_one_of("detector library", library, LIBRARIES))
    if library == "apriltag" and border_bits != 1:
        raise DetectorError(
            f"apriltag: border_bits {border_bits}; the AprilTag library reads 1 only,"
            " aruco reads more"
        )
    if library == "apriltag" or (library == "auto" and family.apriltag and border_bits == 1):
        from tagvo.detect.apriltag import AprilTagDetector

        return AprilTagDetector(family, decimate, max_hamming, threads)
    from tagvo.detect.aruco import ArucoDetector

    return ArucoDetector(family, border_bits, max_hamming)

"""Pixels to pose: where the camera is over a map of fiducial tags; what stands here is public.

Names are loaded when they are first used, so that `import tagvo` costs next to nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tagvo.camera.calibration import load_camera as load_camera
    from tagvo.camera.calibration import save_camera as save_camera
    from tagvo.camera.model import Camera as Camera
    from tagvo.config import TagvoConfig as TagvoConfig
    from tagvo.config import load_tagvo_config as load_tagvo_config
    from tagvo.errors import CameraError as CameraError
    from tagvo.errors import ConfigError as ConfigError
    from tagvo.errors import DetectorError as DetectorError
    from tagvo.errors import MapError as MapError
    from tagvo.errors import TagvoError as TagvoError
    from tagvo.pipeline import TagVO as TagVO
    from tagvo.pipeline import Trace as Trace
    from tagvo.records import Detections as Detections
    from tagvo.records import Frame as Frame
    from tagvo.records import PoseMeasurement as PoseMeasurement
    from tagvo.records import PosePrior as PosePrior
    from tagvo.render.view import render_view as render_view
    from tagvo.tags.tag_map import TagMap as TagMap
    from tagvo.tags.tag_map import load_map as load_map
    from tagvo.tags.tag_map import save_map as save_map

_HOME = {
    "Camera": "camera.model",
    "CameraError": "errors",
    "ConfigError": "errors",
    "Detections": "records",
    "DetectorError": "errors",
    "Frame": "records",
    "MapError": "errors",
    "PoseMeasurement": "records",
    "PosePrior": "records",
    "TagMap": "tags.tag_map",
    "TagVO": "pipeline",
    "TagvoConfig": "config",
    "TagvoError": "errors",
    "Trace": "pipeline",
    "load_camera": "camera.calibration",
    "load_map": "tags.tag_map",
    "load_tagvo_config": "config",
    "render_view": "render.view",
    "save_camera": "camera.calibration",
    "save_map": "tags.tag_map",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'tagvo' has no attribute {name!r}")
    return getattr(import_module(f"tagvo.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})

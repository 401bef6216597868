"""Owns what tracking needs between frames: arrays of the map, buffers, the state of the gate."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tagvo.camera.model import Camera
from tagvo.config import TrackConfig
from tagvo.geometry import shortest_sides
from tagvo.records import Detections, PosePrior
from tagvo.tags.tag_map import TagMap
from tagvo.track.policy import (
    GateState,
    Strip,
    admitted,
    decimate_again,
    decimate_needed,
    looks_mosaic,
    strip_due,
    tracking_failed,
)
from tagvo.track.predict import sides_in_view
from tagvo.track.tag_fit import FATES
from tagvo.track.tag_model import Belief, Gray, Limits, TrackedTags, lens_of, map_arrays
from tagvo.track.track_image import track_image

_OVERLAP_PX = 40  # of neighbouring strips, for tags that lie across their border
_AGREE_PX = 2.0  # a tracked tag and the same tag found by the detector
_KNOWN_M = 0.3  # position sigma up to which the size of tags in the image is known
_RIM_PX = 8.0  # tags so near to a strip's rim are cut

Search = Callable[[Gray, float | None], Detections]  # of an image, decimated as far as that


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What tracking made of one image.

    detections: None where the image must be searched whole; counts: by cause, for the trace;
    tried: how many tags were looked for.
    """

    detections: Detections | None
    counts: dict[str, int]
    tried: int = 0


class Tracker:
    """Tracks the tags of one map in the images of one camera; owns buffers and the gate's state."""

    def __init__(self, camera: Camera, tag_map: TagMap, config: TrackConfig) -> None:
        self.config = config
        self._map, self._size = tag_map, np.ascontiguousarray(tag_map.size, dtype=float)
        self._tags, self._lens = map_arrays(tag_map), lens_of(camera)
        self._state = GateState()
        n = len(tag_map)
        self._rows, self._wrong = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
        self._corners, self._sigma, self._margin = (
            np.empty((n, 4, 2)),
            np.empty((n, 4)),
            np.empty(n),
        )
        self._limits = Limits(
            config.min_contrast,
            config.max_errors,
            config.min_side_px,
            config.max_sigma_px,
            config.max_tags,
        )

    def __call__(
        self,
        image: Gray,
        t_ns: int,
        prior: PosePrior | None,
        search: Search,
        largest_only: bool = False,
    ) -> Tracked:
        """The tags of a grey image where the prior puts them, and those of the strip that is due.

        search: the detector, for a strip of the image; largest_only: as in `decimate`. Where
        tracking is not to be trusted the answer has no detections and says why in its counts.
        """
        sound, fault = admitted(prior, t_ns)
        fault = fault or self._state.search_next
        if fault is None and looks_mosaic(image):
            fault = "mosaic"
        if fault is not None or sound is None:
            self._state = replace(self._state, search_next=None)
            return Tracked(None, {f"search_{fault}": 1})
        found, tried, counts = self._track(image, sound)
        failed = "prior_too_wide" if tried < 0 else tracking_failed(len(found), tried, self.config)
        if failed is not None:
            return Tracked(None, {**counts, f"search_{failed}": 1}, max(tried, 0))
        if self._state.searched:
            self._state = replace(self._state, searched=False)
        strip = strip_due(self._state, self.config, t_ns, image.shape[0], _OVERLAP_PX)
        if strip is not None:
            self._state = replace(self._state, strip=strip.index)
            part = np.ascontiguousarray(image[strip.top : strip.bottom])
            seen = search(part, self._by_prior(sound, largest_only))
            found, more = self._with_strip(image.shape[0], strip, found, seen)
            counts |= more
        return Tracked(found, {"tracked_frames": 1, **counts}, tried)

    def decimate(self, prior: PosePrior | None, t_ns: int, largest_only: bool) -> float | None:
        """How far a search of the whole image may be decimated.

        By what was found in the frame before, where that was searched whole, else by what the
        prior puts into the image: one too vague to track by still knows the size of tags.
        largest_only: no more than the two largest sizes are needed. None: nothing is known.
        """
        if self._state.searched:
            return self._state.decimate
        _, fault = admitted(prior, t_ns)
        if prior is None or fault not in (None, "prior_too_wide"):
            return None
        if float(prior.cov[:3, :3].trace()) > _KNOWN_M**2:
            return None
        return self._by_prior(prior, largest_only)

    def searched(self, found: Detections, largest_only: bool) -> None:
        """Learn from a search of the whole image how far the next one may be decimated."""
        rows = self._map.rows(found.tag_id)
        on_map = rows >= 0
        sides = shortest_sides(found.corners_px[on_map])
        decimate = decimate_again(sides, self._size[rows[on_map]], largest_only)
        self._state = replace(self._state, searched=True, decimate=decimate)

    def _by_prior(self, prior: PosePrior, largest_only: bool) -> float | None:
        """By the tags that a prior puts into the image; None: none."""
        R_WC, p_WC = np.ascontiguousarray(prior.R_WC), np.ascontiguousarray(prior.p_WC)
        sides_in_view(R_WC, p_WC, self._tags, self._lens, self._margin)
        seen = self._margin > 0.0
        return decimate_needed(self._margin[seen], self._size[seen], largest_only)

    def _track(self, image: Gray, prior: PosePrior) -> tuple[Detections, int, dict[str, int]]:
        """Tags tracked, how many were tried (-1: the prior is too wide), fates of those lost."""
        fates = np.zeros(len(FATES), dtype=np.int64)
        k, tried, largest = track_image(
            image, self._tags, self._lens, Belief(prior.R_WC, prior.p_WC, prior.cov), self._limits,
            TrackedTags(
                self._rows, self._corners, self._sigma, self._wrong, self._margin, fates
            ),
        )  # fmt: skip
        found = Detections(
            self._map.tag_id[self._rows[:k]],
            self._corners[:k].copy(),
            self._wrong[:k].copy(),
            self._margin[:k].copy(),
            self._sigma[:k].copy(),
        )
        counts = {
            f"track_{name}": int(n) for name, n in zip(FATES[1:], fates[1:], strict=True) if n
        }
        return found, -1 if largest > self.config.max_sigma_px else tried, counts

    def _with_strip(
        self, height: int, strip: Strip, found: Detections, seen: Detections
    ) -> tuple[Detections, dict[str, int]]:
        """The tracked tags and what a search of a strip adds; tags that contradict it are dropped.

        One contradiction has the next frame searched whole.
        """
        corners = seen.corners_px + np.array([0.0, strip.top])
        v = corners[..., 1]
        low = -np.inf if strip.top == 0 else strip.top + _RIM_PX
        high = np.inf if strip.bottom == height else strip.bottom - 1 - _RIM_PX
        whole = ((v > low) & (v < high)).all(axis=1)
        on_map = self._map.rows(seen.tag_id) >= 0
        seen = replace(seen, corners_px=corners)[whole & on_map]
        counts, keep = Counter({"strips": 1}), np.ones(len(found), dtype=bool)
        new = np.ones(len(seen), dtype=bool)
        for k, tag_id in enumerate(seen.tag_id.tolist()):
            for at in np.flatnonzero(found.tag_id == tag_id).tolist():
                apart = np.abs(found.corners_px[at] - seen.corners_px[k]).max()
                if apart <= _AGREE_PX + 3.0 * float(found.sigma_px[at].max()):
                    new[k] = False
                else:
                    keep[at] = False
                    counts["strip_contradicts"] += 1
        counts["strip_new"] = int(new.sum())
        if not keep.all():
            self._state = replace(self._state, search_next="contradiction")
        return joined(found[keep], seen[new]), {c: n for c, n in counts.items() if n}


def joined(a: Detections, b: Detections) -> Detections:
    """Two records as one."""
    if not len(b):
        return a
    return Detections(
        np.concatenate([a.tag_id, b.tag_id]),
        np.concatenate([a.corners_px, b.corners_px]),
        np.concatenate([a.hamming, b.hamming]),
        np.concatenate([a.margin, b.margin]),
        np.concatenate([a.sigma_px, b.sigma_px]),
    )

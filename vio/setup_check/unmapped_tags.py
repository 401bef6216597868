"""Tags that are seen and of no use: not on the map, seen twice, or of another family; in words."""

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tagvo.detect import make_detector
from tagvo.errors import DetectorError, some_of
from tagvo.geometry import IntArray
from tagvo.records import Detections
from tagvo.tags.families import FAMILIES
from tagvo.tags.tag_map import TagMap

_SHARE = 0.02  # of the frames: a misread code comes less often, a tag that is there more often
_ENOUGH_FRAMES = 30  # a second of a camera: fewer say little of a share
_TRY = (  # from the family with the fewest false finds on
    "tag36h11", "tagStandard41h12", "tag25h9", "tagStandard52h13", "tagCircle49h12",
    "tagCustom48h12", "tag36h10", "tagCircle21h7", "DICT_ARUCO_ORIGINAL",
    "DICT_7X7_1000", "DICT_6X6_1000", "DICT_5X5_1000", "DICT_4X4_1000", "tag16h5",
)  # fmt: skip


@dataclass(slots=True)
class UnmappedTags:
    """Counts of a run, frames by tag id: not_on_map, twice (found twice in one); told: `news`."""

    frames: int = 0
    found: int = 0  # frames with any tag
    not_on_map: Counter[int] = field(default_factory=Counter)
    twice: Counter[int] = field(default_factory=Counter)
    told: set[str] = field(default_factory=set)

    def take(self, found: Detections, counts: dict[str, int], tag_map: TagMap) -> None:
        """A frame's tags as they were found, and how many fell to each filter."""
        self.frames += 1
        self.found += len(found) > 0
        if counts.get("not_on_map"):
            self.not_on_map.update(set(found.tag_id[tag_map.rows(found.tag_id) < 0].tolist()))
        if counts.get("duplicate"):
            ids, times = np.unique(found.tag_id, return_counts=True)
            self.twice.update(ids[times > 1].tolist())

    def news(self, tag_map: TagMap, with_pose: int) -> list[str]:
        """Those of the words whose tags were not named before; none before 30 frames were seen."""
        if self.frames < _ENOUGH_FRAMES:
            return []
        fresh = {re.sub(r" \(in \d+ frames?\)", "", text): text
                 for text in self.words(tag_map, with_pose)}  # fmt: skip
        out = [text for key, text in fresh.items() if key not in self.told]
        self.told |= set(fresh)
        return out

    def words(self, tag_map: TagMap, with_pose: int) -> list[str]:
        """A line on each kind that comes in 2 % of the frames, or at all where none gave a pose."""
        least = _SHARE * self.frames if with_pose else 1
        out = []
        strangers = {t: n for t, n in sorted(self.not_on_map.items()) if n >= least}
        if strangers:
            out.append(f"tags {_listed(strangers)} are seen and not on the map, which has"
                       f" {_ids(tag_map.tag_id)}")  # fmt: skip
        twice = {t: n for t, n in sorted(self.twice.items()) if n >= least}
        if twice:
            out.append(f"tags {_listed(twice)} are seen twice in a frame: laid twice, or printed"
                       " elsewhere, too; neither is used")  # fmt: skip
        return out


def _listed(frames: dict[int, int]) -> str:
    return some_of(f"{t} (in {n} frame{'s' * (n != 1)})" for t, n in frames.items())


def _ids(tag_id: IntArray) -> str:
    return some_of(sorted(tag_id.tolist()))


def other_family(images: Iterable[Any], family: str) -> str | None:
    """A line that names the family whose tags the images hold; None: no family's.

    Exact codes alone count: of the small families a corrected one is soon found in noise.
    """
    shots = [image for image in images if image is not None]
    for name in _TRY:
        if name == family or not shots:
            continue
        try:
            detector = make_detector("auto", FAMILIES[name], max_hamming=0)
        except DetectorError:
            continue
        seen = [detector.detect(image) for image in shots]
        ids = {int(t) for found in seen for t in found.tag_id[found.hamming == 0]}
        if ids:
            return (f"no tag of {family} is seen, but of {name}: {some_of(sorted(ids))}; is the"
                    " map's family right?")  # fmt: skip
    return None

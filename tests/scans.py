"""Printed pages as a scanner sees them: pixels at a known resolution, text, marks, millimetres.

Nothing here knows how the pages were laid out: positions come from pixels and from what a page
says of itself. Millimetres run from the page's lower left corner to the right and up.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pypdfium2 as pdfium

from tagvo.detect.apriltag import AprilTagDetector
from tagvo.tags.families import FAMILIES

_CORNER = re.compile(r"cut corner at x (-?[\d.]+) m, y (-?[\d.]+) m in W")


@dataclass(frozen=True)
class Page:
    """One page: grey pixels (h, w), its size [mm], its text."""

    image: np.ndarray
    size: np.ndarray
    text: str

    @property
    def per_px(self) -> np.ndarray:
        """Millimetres a pixel, across and down."""
        return self.size / self.image.shape[::-1]

    def mm(self, pixels: np.ndarray) -> np.ndarray:
        """Millimetres of pixel coordinates (..., 2), pixel centres at whole numbers."""
        scaled = (np.asarray(pixels) + 0.5) * self.per_px
        return np.stack([scaled[..., 0], self.size[1] - scaled[..., 1]], axis=-1)

    def window(self, low, high) -> tuple[np.ndarray, np.ndarray]:
        """Darkness 0..1 of a rectangle [mm], and the mm of its first pixel's centre."""
        x0, x1 = (np.array([low[0], high[0]]) / self.per_px[0]).round().astype(int)
        y0, y1 = ((self.size[1] - np.array([high[1], low[1]])) / self.per_px[1]).round().astype(int)
        return 1.0 - self.image[y0:y1, x0:x1] / 255.0, self.mm(np.array([x0, y0]))

    @property
    def cut_corner(self) -> np.ndarray:
        """Where the page says that its lower left cut corner lies in W [mm]."""
        return 1e3 * np.array([float(v) for v in _CORNER.search(self.text).groups()])


def pages(path: Path, dpi: float, numbers=None) -> list[Page]:
    """Pages of a PDF, rendered by PDFium, an engine that shares no code with what wrote it."""
    document = pdfium.PdfDocument(path)
    out = []
    for i in range(len(document)) if numbers is None else numbers:
        page = document[i]
        image = page.render(scale=dpi / 72.0, grayscale=True).to_numpy().squeeze().copy()
        size = np.array(page.get_size()) * 25.4 / 72.0
        out.append(Page(image, size, page.get_textpage().get_text_range()))
    document.close()
    return out


def image_objects(path: Path) -> int:
    """How many raster images a PDF holds."""
    document = pdfium.PdfDocument(path)
    kinds = [o.type for page in document for o in page.get_objects()]
    document.close()
    return sum(kind == pdfium.raw.FPDF_PAGEOBJ_IMAGE for kind in kinds)


def line_at(page: Page, low, high, upright: bool) -> float:
    """Where the one line in a rectangle [mm] lies across its direction, by its darkness [mm]."""
    dark, first = page.window(low, high)
    profile = dark.sum(axis=0 if upright else 1)
    assert profile.max() > 0.2, f"no line between {low} and {high} mm"
    middle = (profile * np.arange(len(profile))).sum() / profile.sum()
    step = page.per_px[0] if upright else -page.per_px[1]
    return float(first[0 if upright else 1] + step * middle)


def crop_corner(page: Page, near, overlap: float, left: bool = True, low: bool = True):
    """The cut corner [mm] that the two crop marks near a place point at."""
    x, y = near
    gap = overlap + 2.0
    v = (y - gap - 3.0, y - gap) if low else (y + gap, y + gap + 3.0)
    h = (x - gap - 3.0, x - gap) if left else (x + gap, x + gap + 3.0)
    return np.array(
        [
            line_at(page, (x - 1.5, v[0]), (x + 1.5, v[1]), upright=True),
            line_at(page, (h[0], y - 1.5), (h[1], y + 1.5), upright=False),
        ]
    )


def detect(image: np.ndarray, family: str = "tagStandard41h12", decimate: float = 1.0):
    """Ids and corners (n, 4, 2) [px] of the tags in an image."""
    detector = AprilTagDetector(FAMILIES[family], decimate=decimate, maxhamming=0)
    found = detector.detect(np.pad(image, 40, constant_values=255))
    return found.tag_id, found.corners_px - 40.0


def mosaic(parts, low, high, dpi: float) -> np.ndarray:
    """Pages put together as a person does: cut at their marks, laid by where they say they lie.

    parts: pages with their lower left and upper right cut corners [mm]; low, high: what the
    picture shows, in W [mm].
    """
    scale = dpi / 25.4
    size = np.ceil((np.asarray(high) - low) * scale).astype(int)
    out = np.full((size[1], size[0]), 255, np.uint8)
    for page, corner, end in parts:
        at = page.cut_corner  # W [mm] of `corner` on the page
        # picture pixel (c, r) -> W [mm] -> page [mm] -> page pixel
        A = np.array([[1 / scale, 0], [0, -1 / scale]])
        b = np.array([low[0] + 0.5 / scale, high[1] - 0.5 / scale]) - at + corner
        P = np.diag([1 / page.per_px[0], -1 / page.per_px[1]])
        M = np.column_stack([P @ A, P @ (b - [0, page.size[1]]) - 0.5])
        warped = cv2.warpAffine(
            page.image, M, (int(size[0]), int(size[1])),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderValue=255,
        )  # fmt: skip
        first, last = at - low, at - low + end - corner
        x0, x1 = (np.array([first[0], last[0]]) * scale).round().astype(int)
        y0, y1 = ((high[1] - low[1] - np.array([last[1], first[1]])) * scale).round().astype(int)
        out[y0:y1, x0:x1] = warped[y0:y1, x0:x1]
    return out

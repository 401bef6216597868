"""What is known of each tag family: number of ids, cells across, which library reads it."""

from dataclasses import dataclass

from tagvo.errors import MapError, choose_one_of


@dataclass(frozen=True, slots=True)
class Family:
    """One tag family.

    ids: number of ids; border_cells: cells across the square that the detector reports;
    total_cells: cells across the whole printed tag; reversed_border: white square outside black;
    apriltag: read by the AprilTag library; aruco: name of OpenCV's dictionary, or None.
    """

    name: str
    ids: int
    border_cells: int
    total_cells: int
    reversed_border: bool
    apriltag: bool
    aruco: str | None

    def total_per_border(self, border_bits: int = 1) -> float:
        """Whole printed side over border side; `border_bits` as in the map (2: Kalibr's grids)."""
        extra = 2 * (border_bits - 1)
        return (self.total_cells + extra) / (self.border_cells + extra)


def _april(name: str, ids: int, border: int, total: int, rev: bool, aruco: str | None) -> Family:
    return Family(name, ids, border, total, rev, apriltag=True, aruco=aruco)


def _aruco(name: str, ids: int, bits: int) -> Family:
    return Family(name, ids, bits + 2, bits + 4, False, apriltag=False, aruco=name)


_ALL = (
    _april("tagStandard41h12", 2115, 5, 9, True, None),
    _april("tagStandard52h13", 48714, 6, 10, True, None),
    _april("tagCustom48h12", 42211, 6, 10, True, None),
    _april("tagCircle21h7", 38, 5, 9, True, None),
    _april("tagCircle49h12", 65535, 5, 11, True, None),
    _april("tag36h11", 587, 8, 10, False, "DICT_APRILTAG_36h11"),
    _april("tag36h10", 2320, 8, 10, False, "DICT_APRILTAG_36h10"),
    _april("tag25h9", 35, 7, 9, False, "DICT_APRILTAG_25h9"),
    _april("tag16h5", 30, 6, 8, False, "DICT_APRILTAG_16h5"),
    *(_aruco(f"DICT_{b}X{b}_{n}", n, b) for b in (4, 5, 6, 7) for n in (50, 100, 250, 1000)),
    _aruco("DICT_ARUCO_ORIGINAL", 1024, 5),
    _aruco("DICT_ARUCO_MIP_36h12", 250, 6),
)

FAMILIES: dict[str, Family] = {family.name: family for family in _ALL}
_BY_ANY_NAME = {family.name.lower(): family for family in _ALL} | {
    family.aruco.lower(): family for family in _ALL if family.aruco
}


def family_named(name: object, where: str) -> Family:
    """The family of that name (case ignored; OpenCV's names too); MapError where unknown."""
    family = _BY_ANY_NAME.get(str(name).lower())
    if family is None:
        raise MapError(choose_one_of(where, name, FAMILIES))
    return family

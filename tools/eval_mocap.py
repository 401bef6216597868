"""Real photographs of a printed board: our tags, and poses judged by motion capture.

(a) Our detector on the 15 photographs against the corners shipped with them. (b) Poses against
motion capture by leave-one-out: the camera in its marker body and the board in its marker grid are
fitted (least squares over position / 5 mm and rotation / 0.3 deg, soft L1 loss, started from the
closed form of hand-eye calibration) on 14 photographs and predict the pose of the 15th.
Run: TAGVIO_DATA=... python tools/eval_mocap.py [--data FOLDER]
"""

import argparse
import os
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from oracles.mocap_study import (
    MocapSet,
    Pose,
    detect_all,
    leave_one_out,
    load_mocap_set,
    plain_pnp,
    tagvo_poses,
)

from vio.config import load_config
from vio.config.shipped import config_path


def row(name: str, data: MocapSet, poses: dict[int, Pose]) -> str:
    """Median, mean and largest error of one way to a pose."""
    shift, turn = leave_one_out(data, poses)
    mm, deg = 1e3 * shift, np.degrees(turn)
    return (
        f"{name:34s} {len(mm):3d}   {np.median(mm):7.2f} {mm.mean():7.2f} {mm.max():7.2f}"
        f"   {np.median(deg):6.3f} {deg.mean():6.3f} {deg.max():6.3f}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    root = os.environ.get("TAGVIO_DATA")
    default = Path(root) / "mocap_aprilgrid" if root else None
    parser.add_argument("--data", type=Path, default=default, help="TAGVIO_DATA/mocap_aprilgrid")
    args = parser.parse_args()
    if args.data is None:
        parser.error("TAGVIO_DATA is not set; --data FOLDER is needed")
    data = load_mocap_set(args.data)
    found = detect_all(data)
    print(
        f"(a) tags in {found.photos} of {len(data.image)} photographs, {found.tags} of"
        f" {found.tags_shipped} shipped tags, corner rms {found.corner_rms_px:.3f} px"
    )
    paper = load_config(config_path("paper/NEW.yaml")).tagvo
    print(f"(b) {'':30s}   n    mm: median    mean     max   deg: med   mean    max")
    for corners, detections in (("shipped", data.shipped), ("our", found.detections)):
        print(row(f"joint, {corners} corners", data, tagvo_poses(data, detections)))
        print(row(f"plain PnP, {corners} corners", data, plain_pnp(data, detections)))
        print(
            row(f"the paper's NEW, {corners} corners", data, tagvo_poses(data, detections, paper))
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())

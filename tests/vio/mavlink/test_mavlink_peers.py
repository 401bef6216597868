"""An independent MAVLink stack reads what `tagvio replay` sends: MAVSDK, by tools/peers.py."""

import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).parents[3] / "tools/peers.py"


def test_mavsdk_gets_every_pose_once_and_in_order():
    pytest.importorskip("mavsdk")
    done = subprocess.run([sys.executable, TOOL, "mavsdk", "--seconds", "4"], capture_output=True,
                          text=True, timeout=120.0)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "MAVSDK v" in done.stdout
    words = done.stdout.splitlines()[-1].split()
    got, sent = int(words[3]), int(words[5])
    assert got == sent > 15

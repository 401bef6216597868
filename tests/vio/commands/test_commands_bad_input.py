"""What a user gets wrong: one line saying where, what came, what is allowed; the rest counted."""

import json
import shutil

import numpy as np
import pytest
from cli_calls import T0, tagvio, write_true_log
from flying_log import write_flying_log
from small_log import DETECTIONS_HEADER, FRAME_STAMPS, corner_cells, write_log

CAMERA = "camchain-imucam.yaml"
DETECTIONS = "mav0/cam0/detections.csv"
TRUTH = "mav0/state_groundtruth_estimate0/data.csv"


def change(name, old, new):
    """Edit of a log: replace a text in one of its files."""

    def edit(log):
        text = (log / name).read_text()
        assert old in text
        (log / name).write_text(text.replace(old, new))

    return edit


def put(name, content):
    """Edit of a log: one file with other content; bytes, text, or None for no file."""

    def edit(log):
        path = log / name
        path.unlink(missing_ok=True)
        if content is not None:
            path.write_bytes(content if isinstance(content, bytes) else content.encode())

    return edit


def no_folder(log):
    log.rename(log.with_name("elsewhere"))


REFUSED = {  # what was done to the log -> the file named, and words that must be in the line
    "no log": (no_folder, "log", ["no such folder", "tagmap.yaml", CAMERA]),
    "no map": (put("tagmap.yaml", None), "log", ["no tagmap.yaml"]),
    "binary map": (put("tagmap.yaml", b"\xff\xfe\x00\x01"), "tagmap.yaml", ["not a text file"]),
    "broken map": (put("tagmap.yaml", "tags: ["), "tagmap.yaml", ["not valid YAML"]),
    "blank map": (put("tagmap.yaml", ""), "tagmap.yaml", ["empty"]),
    "empty map": (put("tagmap.yaml", "family: tag36h11\ntags: []\n"), "tagmap.yaml", ["no tags"]),
    "unknown family": (
        change("tagmap.yaml", "tag36h11", "tag99h9"), "tagmap.yaml", ["'tag99h9'", "tag36h11"]),
    "duplicate id": (
        change("tagmap.yaml", "id: 7", "id: 3"), "tagmap.yaml", ["tag 3 stands twice"]),
    "size of nothing": (change("tagmap.yaml", "size: 0.1", "size: 0"), "tagmap.yaml", ["positive"]),
    "map key": (change("tagmap.yaml", "family", "familie"), "tagmap.yaml", ["'familie'", "family"]),
    "no camera": (put(CAMERA, None), "log", ["no camchain-imucam.yaml"]),
    "broken camera": (put(CAMERA, "cam0: ["), CAMERA, ["not valid YAML"]),
    "camera without distortion": (
        change(CAMERA, "distortion_model: radtan", "comment: none"), CAMERA, ["distortion_model"]),
    "camera without coefficients": (
        change(CAMERA, "distortion_coeffs", "coeffs"), CAMERA, ["distortion_coeffs", "missing"]),
    "camera of another kind": (change(CAMERA, "pinhole", "omni"), CAMERA, ["'omni'", "pinhole"]),
    "camera that mirrors": (
        change(CAMERA, "[1, 0, 0, 0]", "[-1, 0, 0, 0]"), CAMERA, ["mirrors"]),
    "detections header": (
        change(DETECTIONS, DETECTIONS_HEADER, "a,b,c\n"), DETECTIONS, ["header", "tag_id"]),
    "no valid detection": (
        put(DETECTIONS, DETECTIONS_HEADER + "1,2,3\nx,y\n"), DETECTIONS, ["valid row"]),
    "frames header": (put("mav0/cam0/data.csv", "p_x,p_y\n1,2\n"), "data.csv", ["header"]),
    "config key": (
        put("config.yaml", "tagvo: {poze: joint}\n"), "config.yaml", ["'poze'", "pose, select"]),
    "config value": (
        put("config.yaml", "tagvo: {pose: both}\n"), "config.yaml", ["'both'", "fused, joint"]),
    "blank config": (put("config.yaml", ""), "config.yaml", ["empty"]),
}  # fmt: skip


@pytest.mark.parametrize("command", ["run", "compare"])
@pytest.mark.parametrize("fault", REFUSED)
def test_a_log_that_cannot_be_used_is_refused_in_one_line(tmp_path, fault, command):
    edit, file, words = REFUSED[fault]
    log = write_log(tmp_path, detections=True, images=False)
    edit(log)
    done = tagvio(command, log, "--out", tmp_path / "out")
    assert done.code == 1, done
    lines = done.err.splitlines()
    assert len(lines) == 1, done.err
    assert lines[0].startswith("tagvio: ")
    assert all(word in lines[0] for word in [file, *words]), lines[0]


OUT_OF_RANGE = [
    (["--config", "nowhere.yaml"], ["nowhere.yaml", "no such file"]),
    (["--set", "tagvo.nope=1"], ["tagvo.nope=1", "choose one of pose"]),
    (["--set", "tagvo.detector.decimate=9.5", "--set", "tagvo.pose=x"], ["fused, joint"]),
    (["--imu", "imu7"], ["imu7", "imu0"]),
    (["--only-tags", "55"], ["no tag 55", "2 tags"]),
    (["--only-tags", ","], ["--only-tags", "at least one"]),
    (["--every", "0"], ["--every", "at least 1"]),
    (["--latency", "-1"], ["--latency", "from 0"]),
    (["--latency", "nan"], ["--latency", "from 0"]),
    (["--blackout", "1,3"], ["--blackout", "LENGTH <= PERIOD"]),
]


@pytest.mark.parametrize(("words", "says"), OUT_OF_RANGE)
def test_an_option_out_of_range_is_one_line(small, tmp_path, words, says):
    done = tagvio("run", small, "--out", tmp_path / "out", *words)
    assert done.code == 1, done
    assert len(done.err.splitlines()) == 1
    assert all(word in done.err for word in says), done.err


WRONG_USAGE = [
    ["run"],
    ["run", "LOG"],
    ["fly"],
    ["run", "LOG", "--out", "OUT", "--every", "two"],
    ["run", "LOG", "--out", "OUT", "--fast"],
    ["run", "LOG", "--out", "OUT", "--only-tags", "a,b"],
    ["run", "LOG", "--out", "OUT", "--blackout", "3"],
    ["compare", "LOG", "--out", "OUT", "--align", "sim3"],
    ["compare", "LOG", "--out", "OUT", "--skip", "-1"],
    ["compare", "LOG", "--out", "OUT", "--skip", "nan"],
    ["compare", "LOG", "--out", "OUT", "--skip", "1e300"],
]


@pytest.mark.parametrize("words", WRONG_USAGE, ids=" ".join)
def test_wrong_usage_is_exit_code_2(small, tmp_path, words):
    given = {"LOG": small, "OUT": tmp_path}
    done = tagvio(*(given.get(word, word) for word in words))
    assert done.code == 2, done
    assert "Error: " in done.err


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("small"), detections=True, images=False)


def test_an_out_folder_that_cannot_be_is_refused_before_the_work(small, tmp_path):
    file = tmp_path / "file"
    file.write_text("mine")
    for out in (file, file / "below"):
        done = tagvio("run", small, "--out", out)
        assert done.code == 1
        assert len(done.err.splitlines()) == 1
        assert str(out) in done.err
        assert "a folder that can be written is needed" in done.err
    assert file.read_text() == "mine"


def test_compare_needs_truth_and_says_so_before_the_work(tmp_path):
    log = write_log(tmp_path, detections=True, images=False)
    (log / TRUTH).unlink()
    done = tagvio("compare", log, "--out", tmp_path / "out")
    assert done.code == 1
    assert "no truth" in done.err
    assert not (tmp_path / "out" / "run.json").exists()
    assert tagvio("run", log, "--out", tmp_path / "out").code == 0


def summary_of(log, out):
    done = tagvio("run", log, "--out", out)
    assert done.code == 0, done.err
    return json.loads((out / "run.json").read_text())


def test_bad_rows_are_skipped_and_counted(tmp_path):
    log = write_log(tmp_path, detections=True, images=False)
    clean = summary_of(log, tmp_path / "clean")
    t = FRAME_STAMPS
    rows = [
        f"{t[1]},3,nan,{corner_cells(1, 3).partition(',')[2]}\n",
        f"{t[2]},3,1,2,3,4,5\n",
        f"{t[3]},3,x,{corner_cells(3, 3).partition(',')[2]}\n",
        f"{t[4]},3,{corner_cells(4, 3)[:20]}",
    ]
    with (log / DETECTIONS).open("a") as file:
        file.writelines(rows)
    bad = summary_of(log, tmp_path / "bad")
    found = {k: n for k, n in bad["counters"].items() if k.startswith("detections_")}
    assert sum(found.values()) == 4, found
    assert found["detections_truncated"] == 1
    assert bad["frames"] == clean["frames"]
    vo = [(tmp_path / d / "vo.tum").read_bytes() for d in ("clean", "bad")]
    assert vo[0] == vo[1]


def test_an_unreadable_image_among_good_ones_is_counted(tmp_path):
    log = write_log(tmp_path)
    folder = log / "mav0/cam0/data"
    (folder / f"{FRAME_STAMPS[3]}.png").write_bytes(b"no image")
    (folder / f"{FRAME_STAMPS[4]}.png").write_bytes(b"")
    (folder / f"{FRAME_STAMPS[5]}.png").unlink()
    summary = summary_of(log, tmp_path / "out")
    assert summary["counters"]["image_unreadable"] == 2
    assert summary["counters"]["image_missing"] == 1
    assert summary["frames"]["total"] == len(FRAME_STAMPS) - 3
    assert summary["rejected"] == {"no_tags": len(FRAME_STAMPS) - 3}


def keep_rows(log, keep):
    """Leave only the detections for which keep(stamp, number in its frame) holds."""
    head, *rows = (log / DETECTIONS).read_text().splitlines(keepends=True)
    seen, out = {}, []
    for row in rows:
        t_ns = int(row.split(",")[0])
        seen[t_ns] = seen.get(t_ns, -1) + 1
        if keep(t_ns, seen[t_ns]):
            out.append(row)
    (log / DETECTIONS).write_text(head + "".join(out))


@pytest.mark.parametrize("pose", ["joint", "fused"])
def test_a_frame_without_tags_and_one_with_a_single_tag(tmp_path, pose):
    log = write_true_log(tmp_path)
    keep_rows(log, lambda t_ns, k: t_ns != T0 and k == 0)
    (log / "config.yaml").write_text(f"tagvo: {{pose: {pose}}}\n")
    summary = summary_of(log, tmp_path / "out")
    assert summary["rejected"] == {"no_tags": 1}
    assert summary["frames"]["with_pose"] == 11
    if pose == "fused":
        assert summary["counters"]["pose_or_skipped"] == 11


def test_frames_whose_tags_are_all_dropped_are_counted_by_cause(tmp_path):
    log = write_true_log(tmp_path)
    (log / "config.yaml").write_text("tagvo: {filters: {min_side_px: 5000}}\n")
    summary = summary_of(log, tmp_path / "out")
    assert summary["rejected"] == {"no_usable_tags": 12}
    assert summary["counters"]["too_small"] > 12
    assert summary["frames"]["with_pose"] == 0
    assert (tmp_path / "out/vo.tum").read_text() == ""
    assert tagvio("compare", log, "--out", tmp_path / "cmp").code == 0
    content = json.loads((tmp_path / "cmp/comparison.json").read_text())
    assert content["estimators"]["vo"]["capture"] is None


def test_tags_that_are_not_on_the_map_are_counted(tmp_path):
    log = write_log(tmp_path, detections=True, images=False)
    assert summary_of(log, tmp_path / "out")["counters"]["not_on_map"] == 19


IMU = "mav0/imu0/data.csv"


@pytest.fixture(scope="module")
def flying(tmp_path_factory):
    return write_flying_log(tmp_path_factory.mktemp("flying"), seconds=4.0)


def edited_imu(flying, root, change):
    """A copy of the log, each IMU row (stamp, gyro, accel, arrival, mean) through `change`."""
    log = root / "edited"
    shutil.copytree(flying, log)
    head, *rows = (log / IMU).read_text().splitlines()
    changed = []
    for i, row in enumerate(rows):
        t_ns, *values, arrival, mean = row.split(",")
        new = change(i, int(t_ns), np.array([float(v) for v in values]), int(arrival))
        stamp, numbers, known = new
        changed.append(",".join([str(stamp), *(f"{v:.9f}" for v in numbers), str(known), mean]))
    (log / IMU).write_text("\n".join([head, *changed]) + "\n")
    return log


def in_degrees(i, t_ns, values, arrival):
    return t_ns, np.append(np.degrees(values[:3]), values[3:]), arrival


def spinning_in_degrees(i, t_ns, values, arrival):
    return in_degrees(i, t_ns, values + np.eye(6)[2] * 0.3, arrival)


def in_g(i, t_ns, values, arrival):
    return t_ns, np.append(values[:3], values[3:] / 9.81), arrival


def another_clock(i, t_ns, values, arrival):
    return t_ns - 10**18, values, arrival - 10**18


IMU_REFUSED = {"deg/s": spinning_in_degrees, "in g": in_g, "the clocks must overlap": another_clock}


@pytest.mark.parametrize("command", ["run", "compare"])
@pytest.mark.parametrize("words", IMU_REFUSED)
def test_an_imu_in_other_units_or_clocks_is_refused_in_one_line(flying, tmp_path, words, command):
    log = edited_imu(flying, tmp_path, IMU_REFUSED[words])
    done = tagvio(command, log, "--out", tmp_path / "out")
    assert done.code == 1, done
    assert len(done.err.splitlines()) == 1, done.err
    assert words in done.err
    assert str(log) in done.err
    assert tagvio("run", log, "--out", tmp_path / "out", "--vo-only").code == 0


def test_an_imu_that_the_poses_contradict_is_a_warning(flying, tmp_path):
    """A calm flight in deg/s looks like a fast one in rad/s; but the filter rejects the poses."""

    def calm(i, t_ns, values, arrival):
        return in_degrees(i, t_ns, values * np.repeat([0.5, 1.0], 3), arrival)

    done = tagvio("run", edited_imu(flying, tmp_path, calm), "--out", tmp_path / "out")
    assert done.code == 0
    assert "vio is not to be trusted" in done.err
    assert "units" in done.err


def test_gravity_off_by_more_than_five_percent_is_a_warning(flying, tmp_path):
    def heavy(i, t_ns, values, arrival):
        return t_ns, np.append(values[:3], 1.08 * values[3:]), arrival

    done = tagvio("run", edited_imu(flying, tmp_path, heavy), "--out", tmp_path / "out")
    assert done.code == 0
    assert "off by more than 5 %" in done.err
    assert json.loads((tmp_path / "out/run.json").read_text())["warnings"]


def test_a_filter_that_never_starts_is_a_warning(flying, tmp_path):
    """The IMU ends before the filter has seen enough of it."""
    short = tmp_path / "short"
    shutil.copytree(flying, short)
    rows = (short / IMU).read_text().splitlines(keepends=True)
    (short / IMU).write_text("".join(rows[:40]))
    done = tagvio("compare", short, "--out", tmp_path / "out")
    assert done.code == 0
    assert "the filter never started (still_window)" in done.err
    content = json.loads((tmp_path / "out/comparison.json").read_text())
    assert content["estimators"]["vio"]["capture"] is None
    assert content["estimators"]["vio"]["now"]["coverage"] == 0.0
    assert content["estimators"]["vo"]["capture"]["n"] > 30
    assert tagvio("run", short, "--out", tmp_path / "run").code == 0
    assert (tmp_path / "run/vio.tum").read_text() == ""


def test_samples_that_are_no_numbers_are_counted_and_survived(flying, tmp_path):
    def holes(i, t_ns, values, arrival):
        return t_ns, (np.full(6, np.nan) if i % 50 == 7 else values), arrival

    log = edited_imu(flying, tmp_path, holes)
    summary = summary_of(log, tmp_path / "out")
    assert summary["states"]["TRACKING"] > 400
    assert any("imu" in cause and n >= 15 for cause, n in summary["counters"].items())


SETUP_WRONG = {  # what the IMU says wrongly -> code, words on stderr
    "microseconds": ("stamp_unit", "nanoseconds are needed"),
    "no force": ("no_specific_force", "no specific force"),
}


def rescaled(log, divisor):
    """Every stamp of a log's CSV files divided."""
    for file in log.glob("mav0/*/*.csv"):
        head, *rows = file.read_text().splitlines()
        arrival = [k for k, name in enumerate(head.split(",")) if name.strip() == "arrival_ns"]
        out = [head]
        for row in rows:
            cells = row.split(",")
            for k in (0, *arrival):
                cells[k] = str(int(cells[k]) // divisor)
            out.append(",".join(cells))
        file.write_text("\n".join(out) + "\n")


@pytest.mark.parametrize("command", ["run", "compare"])
@pytest.mark.parametrize("mistake", SETUP_WRONG)
def test_a_set_up_that_is_wrong_beyond_doubt_ends_the_run(flying, tmp_path, mistake, command):
    code, words = SETUP_WRONG[mistake]

    def weightless(i, t_ns, values, arrival):
        return t_ns, np.append(values[:3], np.zeros(3)), arrival

    if mistake == "no force":
        log = edited_imu(flying, tmp_path, weightless)
    else:
        log = tmp_path / "log"
        shutil.copytree(flying, log)
        rescaled(log, 1000)
    out = tmp_path / "out"
    done = tagvio(command, log, "--out", out)
    assert done.code == 1, done
    errors = [line for line in done.err.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert words in errors[0]
    found = json.loads((out / "run.json").read_text())["setup"]
    assert [(f["code"], f["certain"]) for f in found] == [(code, True)]
    assert set(found[0]) == {"code", "text", "value", "certain"}
    if code == "no_specific_force" and command == "run":
        assert tagvio(command, log, "--out", out, "--force").code == 0

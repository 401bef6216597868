"""CSV as it comes from real logs: headers of all kinds, damaged rows counted, stamps exact."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from small_log import (
    DETECTIONS_HEADER,
    IMU_HEADER,
    IMU_STAMPS,
    N_IMU,
    NOISE,
    TRUTH_HEADER,
    corner_cells,
    imu_row,
)

from vio.errors import LogError
from vio.sources.flight_log.columns import canonical
from vio.sources.flight_log.csv_rows import Wanted, _block, parse_rows
from vio.sources.flight_log.files import (
    read_detections,
    read_frame_list,
    read_imu,
    read_imu_noise,
    read_phases,
    read_truth,
)
from vio.sources.flight_log.tally import Tally

ROWS = [imu_row(i) for i in range(N_IMU)]


def imu_of(tmp_path: Path, text: str | bytes):
    path, tally = tmp_path / "data.csv", Tally()
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_imu(path, tally), tally


def test_stamps_are_exact_and_numbers_are_those_of_the_file(tmp_path: Path) -> None:
    track, tally = imu_of(tmp_path, IMU_HEADER + "".join(ROWS))
    assert track.t_ns.tolist() == IMU_STAMPS
    assert track.arrival_ns.tolist() == IMU_STAMPS
    assert_allclose(track.gyro_I[7], [0.007, 0.2, 0.3], atol=0)
    assert_allclose(track.accel_I[7], [0.1, 0.07, 9.81], atol=0)
    assert tally.counters == {}
    sample = track.sample(7)
    assert sample.t_ns == IMU_STAMPS[7]
    assert_array_equal(sample.accel_I, track.accel_I[7])


@pytest.mark.parametrize(
    "header",
    [
        "timestamp,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z",
        "#timestamp [ns], w_RS_S_x [rad/s],w_y,w_z [rad/s], a_RS_S_x [m/s^2],a_y,a_z [m/s^2]",
        "\ufefftimestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z",
        '"t_ns","wx","wy","wz","ax","ay","az"',
        "# recorded by hand\n\n#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z",
        "#c0,c1,c2,c3,c4,c5,c6",
        "stamp (ns),one,two,three,four,five,six,temperature",
        "timestamp,angular_velocity.x,angular_velocity.y,angular_velocity.z,"
        "linear_acceleration.x,linear_acceleration.y,linear_acceleration.z",
    ],
)
def test_headers_that_say_the_same(tmp_path: Path, header: str) -> None:
    track, tally = imu_of(tmp_path, header + "\r\n" + "".join(ROWS[:9]).replace("\n", " \r\n"))
    assert track.t_ns.tolist() == IMU_STAMPS[:9]
    assert_allclose(track.gyro_I[8], [0.008, 0.2, 0.3])
    assert_allclose(track.accel_I[8], [0.1, 0.08, 9.81])
    assert tally.counters == {}


def test_swapped_names_are_followed(tmp_path: Path) -> None:
    header = "#timestamp [ns],a_x,a_y,a_z,w_x,w_y,w_z\n"
    track, _ = imu_of(tmp_path, header + ROWS[4])
    assert_allclose(track.accel_I[0], [0.004, 0.2, 0.3])
    assert_allclose(track.gyro_I[0], [0.1, 0.04, 9.81])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the file is empty"),
        ("\n\n  \n", "the file is empty"),
        ("".join(ROWS), "no header line"),
        (IMU_HEADER, "no valid row"),
        (IMU_HEADER + "nan,1,2,3,4,5,6\n1,2\n", "no valid row (rows came, but: imu_not_a_whole"),
        (TRUTH_HEADER + "1,0,0,0,1,0,0,0,0,0,0\n", "no column gyro_x"),
        (DETECTIONS_HEADER + f"1,3,{corner_cells(0, 3)}\n", "no column gyro_x"),
        ("#timestamp [ns],filename\n1,1.png\n", "no column gyro_x"),
        ("#timestamp,w_x,w_y,w_z,a_x,a_y\n1,2,3,4,5,6\n", "no column accel_z"),
        ("#timestamp,w_y,w_z,a_x,a_y,a_z\n1,2,3,4,5,6\n", "no column gyro_x"),
        ("one\n1\n", "no column gyro_x"),
        ("t,w_x,w_x,w_z,a_x,a_y,a_z\n1,2,3,4,5,6,7\n", "gyro_x twice"),
        ("t [s],w_x,w_y,w_z,a_x,a_y,a_z\n1,2,3,4,5,6,7\n", "is in s; ns"),
        ("t,w_x [deg/s],w_y,w_z,a_x,a_y,a_z\n1,2,3,4,5,6,7\n", "is in deg/s"),
        ("t,w_x,w_y,w_z,a_x [g],a_y,a_z\n1,2,3,4,5,6,7\n", "is in g"),
        (
            "#timestamp;w_x;w_y;w_z;a_x;a_y;a_z\n1;2;3;4;5;6;7\n",
            "separator ; found, a comma is needed",
        ),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(LogError) as caught:
        imu_of(tmp_path, text)
    assert said in str(caught.value)
    assert "gyro x y z [rad/s]" in str(caught.value) or "are needed" in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "data.csv"))
    assert "\n" not in str(caught.value)


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such file"):
        read_imu(tmp_path / "none.csv", Tally())
    with pytest.raises(LogError, match="is a folder"):
        read_imu(tmp_path, Tally())


@pytest.mark.parametrize(
    ("bad", "cause"),
    [
        ("{t},1,2,3\n", "imu_too_few_columns"),
        ("{t},1,2,3,4,5,6,7,8\n", "imu_too_many_columns"),
        ("{t},1,2,3,4,5,6{t},1,2,3,4,5,6\n", "imu_too_many_columns"),
        ("{t},1,2,x,4,5,6\n", "imu_not_a_number"),
        ("{t},1,2,,4,5,6\n", "imu_not_a_number"),
        ("{t},1,2,1_0,4,5,6\n", "imu_not_a_number"),
        ("{t},1,2,nan,4,5,6\n", "imu_not_finite"),
        ("{t},1,2,3,4,5,-inf\n", "imu_not_finite"),
        ("{t},1,2,3,4,5,1e35\n", "imu_not_finite"),
        ("1.403e18,1,2,3,4,5,6\n", "imu_not_a_whole_number"),
        ("1403638519.5,1,2,3,4,5,6\n", "imu_not_a_whole_number"),
        ("{t}{t},1,2,3,4,5,6\n", "imu_not_a_whole_number"),
        ("\x00\x00,1,2,3,4,5,6\n", "imu_not_a_whole_number"),
    ],
)
def test_a_bad_row_is_skipped_and_counted(tmp_path: Path, bad: str, cause: str) -> None:
    rows = [*ROWS[:50], bad.format(t=IMU_STAMPS[50]), *ROWS[51:60], bad.format(t=IMU_STAMPS[60])]
    rows += ROWS[61:70]
    track, tally = imu_of(tmp_path, IMU_HEADER + "".join(rows))
    assert track.t_ns.tolist() == [t for i, t in enumerate(IMU_STAMPS[:70]) if i not in (50, 60)]
    assert tally.counters == {cause: 2}
    assert tally.warnings == [f"{tmp_path / 'data.csv'} line 52: row skipped ({cause}: 2)"]


def test_a_truncated_last_line_has_its_own_cause(tmp_path: Path) -> None:
    text = IMU_HEADER + "".join(ROWS[:5])
    track, tally = imu_of(tmp_path, text[:-20])
    assert len(track) == 4
    assert tally.counters == {"imu_truncated": 1}


def test_repeated_and_backward_stamps(tmp_path: Path) -> None:
    rows = [*ROWS[:10], ROWS[9].replace("9.81", "1.0"), *ROWS[20:30], *ROWS[12:15], *ROWS[30:40]]
    track, tally = imu_of(tmp_path, IMU_HEADER + "".join(rows))
    order = [*range(10), *range(20, 30), *range(12, 15), *range(30, 40)]
    assert track.t_ns.tolist() == [IMU_STAMPS[i] for i in order]
    assert track.accel_I[9, 2] == 9.81  # the first of equal stamps stays
    assert tally.counters == {"imu_repeated_stamp": 1, "imu_backward_stamp": 1, "imu_gap": 2}


def test_arrival_is_read_by_its_name_alone(tmp_path: Path) -> None:
    header = IMU_HEADER.strip() + ",arrival_ns\n"
    late = [f"{row.strip()},{t + 7}\n" for row, t in zip(ROWS, IMU_STAMPS, strict=True)]
    late[3] = ROWS[3].strip() + ",\n"  # not known: at its stamp
    track, tally = imu_of(tmp_path, header + "".join(late))
    expected = [t + (7 if i != 3 else 0) for i, t in enumerate(IMU_STAMPS)]
    assert track.arrival_ns.tolist() == expected
    assert tally.counters == {}
    other_clock = header.replace("arrival_ns", "arrival [ns]")
    assert imu_of(tmp_path, other_clock + "".join(late))[0].arrival_ns.tolist() == IMU_STAMPS


def test_pandas_writes_whole_numbers_with_a_point(tmp_path: Path) -> None:
    rows = [row.replace(",", ".0,", 1) for row in ROWS[:3]]
    assert imu_of(tmp_path, IMU_HEADER + "".join(rows))[0].t_ns.tolist() == IMU_STAMPS[:3]


@pytest.mark.parametrize(
    ("cell", "name"),
    [
        ("timestamp [ns]", "t_ns"),
        (" w_RS_S_x [rad s^-1]", "gyro_x"),
        ("a_RS_S_z [m s^-2]", "accel_z"),
        ("b_w_RS_S_x [rad s^-1]", "bg_x"),
        ("ba_z]", "ba_z"),
        ("bw_y", "bg_y"),
        ("p_MB_x [m]", "p_x"),
        ("p_RS_R_y [m]", "p_y"),
        ("q_RS_w []", "q_w"),
        ("q_z[", "q_z"),
        ("qx", "q_x"),
        ("tx", "p_x"),
        ("z", "p_z"),
        ("v_RS_R_x [m s^-1]", "v_x"),
        ("v_tl", "v_tl"),
        ("v_bl [px]", "v_bl"),
        ("arrival [ns]", None),
        ("arrival_ns", "arrival_ns"),
        ("temperature", None),
    ],
)
def test_columns_of_real_files_are_known(cell: str, name: str | None) -> None:
    assert canonical(cell) == name


def truth_of(tmp_path: Path, text: str):
    path, tally = tmp_path / "truth.csv", Tally()
    path.write_text(text)
    return read_truth(path, tally), tally


def test_truth_takes_both_orders_of_the_quaternion(tmp_path: Path) -> None:
    wxyz, _ = truth_of(tmp_path, "#t,p_x,p_y,p_z,q_w,q_x,q_y,q_z\n5,1,2,3,0.6,0,0,0.8\n")
    xyzw, _ = truth_of(tmp_path, "timestamp [ns],x,y,z,qx,qy,qz,qw\n5,1,2,3,0,0,0.8,0.6\n")
    plain, _ = truth_of(tmp_path, "#a,b,c,d,e,f,g,h\n5,1,2,3,0.6,0,0,0.8\n")
    for truth in (wxyz, xyzw, plain):
        assert_allclose(truth.p_WI, [[1, 2, 3]])
        assert_allclose(truth.q_WI, [[0.6, 0, 0, 0.8]])
        assert truth.v_WI is None


def test_truth_is_sorted_unit_and_carries_what_it_has(tmp_path: Path) -> None:
    rows = "7,0,0,0,1,0,0,0,1,2,3\n5,0,0,1,0.9,0,0,0,0,0,0\n6,0,0,2,1.0005,0,0,0,nan,0,0\n"
    truth, tally = truth_of(tmp_path, TRUTH_HEADER + rows + "7,9,9,9,1,0,0,0,0,0,0\n")
    assert truth.t_ns.tolist() == [6, 7]
    assert_allclose(truth.q_WI, [[1, 0, 0, 0]] * 2, atol=1e-15)
    assert truth.v_WI is not None
    assert_array_equal(truth.v_WI, [[np.nan, 0, 0], [1, 2, 3]])
    assert truth.b_g is None
    counted = {"truth_not_unit": 1, "truth_repeated_stamp": 1, "truth_backward_stamp": 1}
    assert tally.counters == counted
    with pytest.raises(LogError, match=r"norm 2, 1 is needed; no row"):
        truth_of(tmp_path, TRUTH_HEADER + "7,0,0,0,2,0,0,0,1,2,3\n")


def test_detections_with_and_without_the_optional_columns(tmp_path: Path) -> None:
    path = tmp_path / "detections.csv"
    path.write_text(DETECTIONS_HEADER + f"5,3,{corner_cells(0, 3)}\n")
    table = read_detections(path, Tally())
    assert table.tags.corners_px.shape == (1, 4, 2)
    assert_allclose(table.tags.corners_px[0, 2], [20.03, 20.03])
    assert np.isnan(table.tags.margin).all()
    assert table.arrival_ns is None
    header = DETECTIONS_HEADER.strip() + ",hamming,decision_margin,arrival_ns\n"
    row = f"5,3,{corner_cells(0, 3)}"
    path.write_text(header + f"{row},2,nan,9\n{row},,55.5,\n")
    table = read_detections(path, Tally())
    assert table.tags.hamming.tolist() == [2, 0]
    assert_array_equal(table.tags.margin, [np.nan, 55.5])
    assert table.arrival_ns is not None
    assert table.arrival_ns.tolist() == [9, 5]


def test_detections_accept_a_header_that_names_no_corner(tmp_path: Path) -> None:
    path = tmp_path / "detections.csv"
    path.write_text("timestamp,tag_id,c0,c1,c2,c3,c4,c5,c6,c7\n5,3,0,0,1,0,1,1,0,1\n")
    assert_allclose(
        read_detections(path, Tally()).tags.corners_px[0], [[0, 0], [1, 0], [1, 1], [0, 1]]
    )
    path.write_text("timestamp,tag_id,u_tl,v_tl\n5,3,0,0\n")
    with pytest.raises(LogError, match="no column u_tr"):
        read_detections(path, Tally())


def test_phases_may_repeat_and_nest(tmp_path: Path) -> None:
    path, tally = tmp_path / "phases.csv", Tally()
    path.write_text("name,t_start_ns,t_end_ns\nT1,1,9\nT1/leg 1,2,3\nT1,8,7\ntail,4\n")
    phases = read_phases(path, tally)
    assert [(p.name, p.t_start_ns, p.t_end_ns) for p in phases] == [
        ("T1", 1, 9),
        ("T1/leg 1", 2, 3),
    ]
    assert tally.counters == {"phases_reversed": 1, "phases_truncated": 1}


def test_frames_keep_their_file_names(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    path.write_text("#timestamp [ns],filename\n5, a_1.png\n6,b.jpg\n6,c.jpg\n")
    frames = read_frame_list(path, Tally())
    assert frames.filename == ["a_1.png", "b.jpg"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("gyroscope_noise_density: 1.7e-04", ""), "`gyroscope_noise_density` is missing"),
        (("gyroscope_noise_density: 1.7e-04", "gyroscope_noise_density: 0"), "a positive number"),
        (("accelerometer_random_walk: 3.0e-3", "accelerometer_random_walk: -1"), "at least 0"),
        (("update_rate: 100.0", "update_rate: fast"), "update_rate: 'fast'"),
        (("update_rate: 100.0", "update_rate: -1"), "positive number of Hz"),
    ],
)
def test_a_wrong_noise_field_is_named(tmp_path: Path, change, said: str) -> None:
    path = tmp_path / "imu.yaml"
    path.write_text(NOISE.replace(*change))
    with pytest.raises(LogError) as caught:
        read_imu_noise(path)
    assert said in str(caught.value)
    assert str(path) in str(caught.value)


def test_noise_is_read_flat_and_below_a_name(tmp_path: Path) -> None:
    path = tmp_path / "imu.yaml"
    path.write_text(NOISE)
    noise = read_imu_noise(path)
    assert (noise.accel_density, noise.accel_walk) == (2e-3, 3e-3)
    assert (noise.gyro_density, noise.gyro_walk, noise.rate_hz) == (1.7e-4, 0.0, 100.0)
    path.write_text("imu0:\n" + "".join(f"  {line}\n" for line in NOISE.splitlines()))
    assert read_imu_noise(path) == noise


def test_a_hundred_thousand_rows_take_less_than_a_second(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    body = [
        f"{i * 5_000_000},{a},{b},1.5,2.5,3.5,9.8\n"
        for i, (a, b) in enumerate(rng.normal(size=(100_000, 2)))
    ]
    body[77_777] = "x\n"
    path = tmp_path / "data.csv"
    path.write_text(IMU_HEADER + "".join(body))
    start = time.process_time()
    track = read_imu(path, Tally())
    assert time.process_time() - start < 1.0
    assert len(track) == 99_999


cells = st.one_of(
    st.integers(-(2**63), 2**63).map(str),
    st.floats(allow_nan=True, allow_infinity=True).map(repr),
    st.sampled_from(["", " 1 ", "1.0", "1_0", "nan", "-inf", "0x1", "1e3", "١", "#", '"2"', "+5"]),
)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.lists(cells, min_size=2, max_size=4).map(",".join), max_size=6))
def test_the_fast_and_the_slow_way_agree(lines: list[str]) -> None:
    wanted = Wanted([0], [1, 2], [], must_ints=1, must_floats=1, need=3, width=3)

    def faults() -> tuple[list[tuple[str, int]], object]:
        seen: list[tuple[str, int]] = []
        return seen, lambda cause, line: seen.append((cause, line))

    fast_faults, hear = faults()
    fast = parse_rows(lines, 0, wanted, hear)
    slow_faults, hear = faults()
    slow = _block(lines, 0, True, wanted, hear)
    assert fast_faults == slow_faults
    assert_array_equal(fast.ints[0], slow.ints[:, 0])
    assert_array_equal(fast.floats[0], slow.floats)
    assert_array_equal(fast.line, slow.line)


SEED = (IMU_HEADER + "".join(ROWS[:12])).encode()
edits = st.lists(
    st.tuples(st.integers(0, len(SEED)), st.integers(0, 3), st.binary(min_size=0, max_size=3)),
    min_size=1,
    max_size=4,
)


@settings(max_examples=200, deadline=None)
@given(edits)
def test_damaged_bytes_give_a_word_or_a_counted_result(tmp_path_factory, changes) -> None:
    data = SEED
    for at, cut, put in changes:
        data = data[:at] + put + data[at + cut :]
    path, tally = tmp_path_factory.mktemp("fuzz") / "data.csv", Tally()
    path.write_bytes(data)
    try:
        track = read_imu(path, tally)
    except LogError as error:
        said, track = str(error), None
    if track is None:
        assert "\n" not in said
    else:
        assert np.isfinite(track.gyro_I).all()
        assert np.isfinite(track.accel_I).all()
        assert len(np.unique(track.t_ns)) == len(track)
        for counter in tally.counters:  # each is said, beside notes of its clock
            assert sum(f"({counter}: " in text for text in tally.warnings) == 1


@pytest.mark.parametrize("end", ["", "\n", "\r\n \n\n"])
@pytest.mark.parametrize("fault", [0, 2047, 2048, 4999])
def test_rows_are_numbered_and_the_last_is_known_over_blocks(tmp_path, fault, end):
    """5000 rows are three blocks; a short row in one of them is named, the last as cut."""
    body = [f"{i},1,2,3,4,5,6" for i in range(5000)]
    body[fault] = "7,1"
    path, tally = tmp_path / "data.csv", Tally()
    path.write_text(IMU_HEADER + "# remark\n\n" + "\n".join(body) + end)
    track = read_imu(path, tally)
    assert track.t_ns.tolist() == [i for i in range(5000) if i != fault]
    cause = "imu_truncated" if fault == 4999 else "imu_too_few_columns"
    assert tally.counters == {cause: 1}
    assert f"line {fault + 4}: row skipped" in tally.warnings[0]


def test_memory_grows_by_what_the_rows_hold(tmp_path):
    """3e5 rows of 100 bytes: 64 bytes of numbers, stamp and line each, and never the text."""
    path, rows = tmp_path / "data.csv", 300_000
    with path.open("w") as file:
        file.write(IMU_HEADER)
        file.writelines(f"{i}{',0.123456789012' * 6}\n" for i in range(rows))
    code = f"""
from pathlib import Path
from vio.sources.flight_log.files import read_imu
from vio.sources.flight_log.tally import Tally
small = Path({str(tmp_path / "small.csv")!r})
small.write_text({IMU_HEADER!r} + "1,0,0,0,0,0,0\\n" * 3000)
def peak():
    return int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
read_imu(small, Tally())
before = peak()
track = read_imu(Path({str(path)!r}), Tally())
print(len(track), 1024 * (peak() - before) / len(track))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    count, each = done.stdout.split()
    assert int(count) == rows
    assert float(each) < 150.0  # bytes a row, with what growing and checking take; held text: 400


@pytest.mark.parametrize("stamp", [2**62 + 1, 2**63 - 1, 2**63, 10**30])
def test_a_stamp_whose_differences_no_int64_holds_is_a_bad_row(tmp_path: Path, stamp: int) -> None:
    row = ",".join([str(stamp), *ROWS[3].split(",")[1:]])
    track, tally = imu_of(tmp_path, IMU_HEADER + "".join([*ROWS[:3], row, *ROWS[4:]]))
    assert track.t_ns.tolist() == [*IMU_STAMPS[:3], *IMU_STAMPS[4:]]
    assert sum(tally.counters.values()) == 1

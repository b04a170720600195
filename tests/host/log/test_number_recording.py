"""Number files of other programs: their metadata is used, and missing metadata must be given."""

import gzip
import json
import zipfile

import h5py
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from hubodo.cli import main
from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from hubodo.log.number_recording import InputFormat

DEG = np.pi / 180.0
RATES = np.random.default_rng(5).normal(0.1, 0.02, 4000)
"""deg/s"""


def read_file(path, file_format, count=4000):
    ((name, table),) = read_log(path, input_format=file_format).nodes.items()
    assert len(table) == count
    return name, table


def write_text(path, content):
    path.write_text(content, "utf-8")
    return path


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".csv.gz", ".mat", ".h5", ".npy"])
def test_one_column_with_a_rate_and_a_unit_is_a_channel(tmp_path, suffix):
    path = tmp_path / f"gyro{suffix}"
    if suffix == ".mat":
        savemat(path, {"rate": RATES})
    elif suffix == ".h5":
        with h5py.File(path, "w") as file:
            file["imu/rate"] = RATES
    elif suffix == ".npy":
        np.save(path, RATES)
    else:
        text = "# at rest\n" + "\n".join(map(repr, RATES.tolist())) + "\n"
        path.write_bytes(gzip.compress(text.encode()) if suffix.endswith("gz") else text.encode())
    name, table = read_file(path, InputFormat(100.0, ("deg/s",), channel="gx"))
    assert name == "gyro"
    assert table["gx"] == pytest.approx(RATES * DEG, rel=1e-15)
    assert table.t[1] == 0.01
    assert np.isnan(table["gz"]).all()


@pytest.mark.parametrize(
    ("file_format", "words"),
    [
        (InputFormat(100.0), "the unit of gz is missing; give --unit"),
        (InputFormat(None, ("deg/s",)), "has no time column; give its samples per second with --rate"),
        (InputFormat(100.0, ("g",)), "the unit of gz is missing"),
        (InputFormat(100.0, ("deg",)), "--unit 'deg': give one of rad/s"),
        (InputFormat(100.0, ("deg/s",), ("t", "gz")), "has 1 columns, --columns names 2"),
        (InputFormat(100.0, ("deg/s",), ("wz",)), "--columns: 'wz' is none of"),
    ],
)
def test_missing_metadata_must_be_given(tmp_path, file_format, words):
    path = write_text(tmp_path / "gyro.csv", "\n".join(map(repr, RATES.tolist())))
    with pytest.raises(InputError, match=words):
        read_log(path, input_format=file_format)


def test_columns_are_named_by_the_user_or_by_a_hubodo_header(tmp_path):
    body = "\n".join(f"{1000 * k};{k / 7};{9.81};x" for k in range(50))
    path = write_text(tmp_path / "wheel.txt", "stamp;rate;down;mark\n" + body.replace(";x", ";1"))
    with pytest.raises(
        InputError, match=r"4 columns \(stamp, rate, down, mark\); name them, as in --columns"
    ):
        read_log(path)
    file_format = InputFormat(None, ("0.5 deg/s", "m/s²"), ("t_us", "gy", "az", "-"))
    _, table = read_file(path, file_format, 50)
    assert table.t[1] == pytest.approx(1e-3)
    assert table["gy"][7] == pytest.approx(0.5 * DEG)
    assert table["az"][0] == 9.81
    ours = write_text(tmp_path / "left.csv", "t,gx,gy,gz\n0,1,2,3\n0.5,4,5,6\n")
    name, table = read_file(ours, InputFormat(), 2)
    assert name == "left"
    assert table["gz"].tolist() == [3.0, 6.0]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("1.0\n2.0\nnine\n", "row 3: 'nine' is not a number"),
        ("1,2\n1,2\n1\n", "row 3 has 1 columns, the first 2"),
        ("# 1\n", "holds no numbers"),
        ("t,gz\n0,1\n0,1\n", "time does not increase at row 2"),
    ],
)
def test_a_faulty_row_is_named(tmp_path, content, words):
    path = write_text(tmp_path / "gyro.csv", content)
    with pytest.raises(InputError, match=words):
        read_log(path, input_format=InputFormat(None, ("deg/s",), ()))


def test_matlab_structures_and_hdf5_units_are_read(tmp_path):
    t = np.arange(300) / 50.0
    savemat(tmp_path / "a.mat", {"imu": {"t": t, "gz": t * 0 + 2.0, "note": "x"}, "other": np.zeros(7)})
    with pytest.raises(InputError, match=r"imu\.t 300 x 1.*give --variable"):
        read_log(tmp_path / "a.mat", input_format=InputFormat(None, ("deg/s",)))
    _, table = read_file(tmp_path / "a.mat", InputFormat(None, ("deg/s",), variable="imu.t,imu.gz"), 300)
    assert table["gz"][0] == pytest.approx(2.0 * DEG)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["t"] = t
        file["gyro"] = np.tile([[1.0], [2.0], [3.0]], 300)
        file["gyro"].attrs["units"] = "deg/s"
    file_format = InputFormat(None, (), ("t", "gx", "gy", "gz"), "t,gyro")
    _, table = read_file(tmp_path / "b.h5", file_format, 300)
    assert table["gy"][5] == pytest.approx(2.0 * DEG)
    (tmp_path / "torn.mat").write_bytes((tmp_path / "a.mat").read_bytes()[:300])
    with pytest.raises(InputError, match=r"torn\.mat: cannot be read"):
        read_log(tmp_path / "torn.mat")


@pytest.mark.parametrize("generation", [1, 2])
def test_a_rosbag_of_either_generation_gives_its_imu_topics(tmp_path, generation):
    store = get_typestore(Stores.ROS1_NOETIC if generation == 1 else Stores.ROS2_HUMBLE)
    types = store.types
    path = tmp_path / ("ride.bag" if generation == 1 else "ride")
    bag = Bag1(path) if generation == 1 else Bag2(path, version=8, storage_plugin=StoragePlugin.SQLITE3)
    vector, zeros = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    with bag as writer:
        link = writer.add_connection("/left/imu", "sensor_msgs/msg/Imu", typestore=store)
        for k in range(40):
            stamp = types["builtin_interfaces/msg/Time"](sec=100, nanosec=k * 10_000_000)
            first = (k,) if generation == 1 else ()
            message = types["sensor_msgs/msg/Imu"](
                types["std_msgs/msg/Header"](*first, stamp, "left"),
                types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), zeros,
                vector(0.1, 0.2, k / 100), zeros, vector(0.0, 0.0, 9.8), zeros,
            )  # fmt: skip
            raw = store.serialize_ros1 if generation == 1 else store.serialize_cdr
            writer.write(link, 100_000_000_000 + k, raw(message, "sensor_msgs/msg/Imu"))
    name, table = read_file(path, InputFormat(), 40)
    assert name == "left"
    assert table.t[3] == pytest.approx(0.03)
    assert table["gz"][7] == 0.07
    assert table["az"][0] == 9.8


def test_the_unit_of_a_log_that_is_not_in_si_is_given_by_the_same_option(tmp_path, capsys):
    rows = np.column_stack(
        [np.arange(4000) / 100.0, np.tile(RATES, (3, 1)).T, np.tile([0.0, 0.0, 1.0], (4000, 1))]
    )
    header = "t,gx,gy,gz,ax,ay,az"
    (tmp_path / "log").mkdir()
    np.savetxt(tmp_path / "log" / "left.csv", rows, delimiter=",", header=header, comments="")
    assert main(["allan", str(tmp_path / "log")]) == 2
    assert "that is g" in capsys.readouterr().err
    assert main(["allan", str(tmp_path / "log"), "--unit", "g", "--unit", "deg/s", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["coefficients"]["N"]["value"] == pytest.approx(0.02 * 0.1 * DEG, rel=0.1)
    assert main(["info", str(tmp_path / "log" / "left.csv"), "--unit", "deg/s"]) == 0
    assert "/left/imu" in capsys.readouterr().out


def test_an_import_in_other_units_is_converted_or_causes_a_warning(tmp_path, capsys):
    t = np.arange(600) / 100.0
    rows = np.column_stack([t, *np.full((3, 600), 90.0), *np.full((2, 600), 0.0), np.ones(600)])
    (tmp_path / "log").mkdir()
    header = "t,gx,gy,gz,ax,ay,az"
    np.savetxt(tmp_path / "log" / "left.csv", rows, delimiter=",", header=header, comments="")
    words = ["import", str(tmp_path / "log"), "--json", "-o"]
    assert main([*words, str(tmp_path / "a.mcap")]) == 0
    (warning,) = json.loads(capsys.readouterr().out)["warnings"]
    assert "are probably in g" in warning
    assert main([*words, str(tmp_path / "b.mcap"), "--unit", "g", "--unit", "deg/s"]) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []
    assert read_log(tmp_path / "b.mcap").nodes["left"]["gz"][0] == pytest.approx(np.pi / 2)


def test_an_import_of_one_gyro_is_a_log_for_allan_and_refused_by_fuse(tmp_path, capsys):
    lone = write_text(tmp_path / "gyro.csv", "\n".join(map(repr, RATES.tolist())))
    log = str(tmp_path / "c.mcap")
    assert main(["import", str(lone), "--rate", "100", "--unit", "deg/s", "--json", "-o", log]) == 0
    (warning,) = json.loads(capsys.readouterr().out)["warnings"]
    assert "has no gx, gy, ax, ay, az" in warning
    assert read_log(tmp_path / "c.mcap").nodes["gyro"]["gz"] == pytest.approx(RATES * DEG, rel=1e-15)
    assert main(["allan", log, "--json"]) == 0
    (tmp_path / "v.toml").write_text(
        "[vehicle]\nwheel_radius = 0.3\ntrack_width = 0.5\n[nodes.gyro]\nside = 'left'\nfacing = 'left'\n"
    )
    assert main(["fuse", log, "--vehicle", str(tmp_path / "v.toml"), "-o", str(tmp_path / "out")]) == 2
    assert "node gyro has no gx, gy, ax, ay, az; the wheel filter needs all six" in capsys.readouterr().err


def test_stamps_that_do_not_increase_are_answered_by_what_to_do(tmp_path):
    """Repeated stamps can be replaced by the rate, with the same units; a clock that was reset cannot."""
    t = np.arange(8) * 0.25
    rows = np.column_stack([np.floor(t), *np.full((3, 8), 0.5)])
    text = "t,gx,gy,gz\n" + "\n".join(",".join(map(str, row)) for row in rows)
    repeated = write_text(tmp_path / "a.csv", text)
    with pytest.raises(InputError, match=r"row 2 of its numbers and 5 others.*columns -,gx,gy,gz --rate HZ"):
        read_log(repeated)
    form = InputFormat(columns=("-", "gx", "gy", "gz"), rate=4.0)
    table = read_log(repeated, input_format=form).nodes["a"]
    assert table.t == pytest.approx(t) and table["gx"] == pytest.approx(np.full(8, 0.5)), (
        "rad/s, by the header"
    )
    with pytest.raises(InputError, match="omit --rate, or the times, with --columns -,gx,gy,gz"):
        read_log(repeated, input_format=InputFormat(rate=4.0))
    rows[:, 0] = [0, 20, 40, 60, 0, 20, 40, 60]
    reset = "t,gx,gy,gz\n" + "\n".join(",".join(map(str, row)) for row in rows)
    with pytest.raises(InputError, match="goes back at row 5 of its numbers; split the file there"):
        read_log(write_text(tmp_path / "b.csv", reset))


def test_numbers_in_quotation_marks_are_read(tmp_path):
    path = write_text(tmp_path / "a.csv", '"t","gx","gy","gz"\n"0","1","2","3"\n"0.5","4","5","6"\n')
    assert read_log(path).nodes["a"].gyro.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_negative_times_and_missing_samples_leave_the_distance_as_it_is(tmp_path, capsys):
    """A log of a wheel that rolls 20 m, beginning at -10 s, with words for missing numbers."""
    t = np.arange(-10.0, 20.0, 0.005)
    rate = np.clip(t + 5.0, 0.0, 5.0)
    angle = np.cumsum(rate) * 0.005
    columns = [0 * t, 0 * t, rate, -9.80665 * np.cos(angle), 9.80665 * np.sin(angle), 0 * t]
    rows = [[f"{v:.6f}" for v in row] for row in np.column_stack([t, *columns]) + 1e-6]
    for row in rows[50::50]:
        row[3] = "n/a"
    log = write_text(tmp_path / "left.csv", "t,gx,gy,gz,ax,ay,az\n" + "\n".join(map(",".join, rows)) + "\n")
    vehicle = write_text(
        tmp_path / "v.toml",
        '[vehicle]\nwheel_radius = 0.2\ntrack_width = 0.5\n[nodes.left]\nside = "left"\nfacing = "left"\n',
    )
    assert main(["fuse", str(log), "--vehicle", str(vehicle), "-o", str(tmp_path / "out"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["distance"] == pytest.approx(0.2 * angle[-1], rel=0.01)
    assert any(
        "119 of 6000 samples hold NaN or infinity, first at t = -9.7" in it for it in result["warnings"]
    )
    assert main(["info", str(log)]) == 0


def test_an_archive_is_named_with_its_content(tmp_path):
    with zipfile.ZipFile(tmp_path / "drive.zip", "w") as archive:
        archive.writestr("drive/left.csv", "t,gz\n0,1\n")
    with pytest.raises(InputError, match=r"is an archive with drive/left\.csv; unpack it"):
        read_log(tmp_path / "drive.zip")


def test_a_folder_of_two_exports_of_another_program_is_one_recording(tmp_path):
    header = '"Zeit";"Gyro X (°/s)";"Gyro Y (°/s)";"Gyro Z (°/s)";"Acc X (g)";"Acc Y (g)";"Acc Z (g)"\r\n'
    for name, start in (("Left.CSV", 1.8e9), ("right.csv", 1.8e9 + 2.5)):
        rows = (f"{start + 0.01 * k:.2f};{k};0;90;0;1;0\r\n".replace(".", ",") for k in range(50))
        (tmp_path / name).write_text("\ufeff" + header + "".join(rows), "utf-8")
    (tmp_path / "truth.csv").write_text("t,x,y\n0,0,0\n1,1,0\n")
    recording = read_log(tmp_path)
    assert recording.t_zero_ns == 1_800_000_000 * 10**9
    assert recording.nodes["right"].t[0] - recording.nodes["Left"].t[0] == pytest.approx(2.5, abs=1e-6)
    assert recording.nodes["right"]["gz"] == pytest.approx(np.pi / 2)
    assert recording.nodes["Left"]["ay"] == pytest.approx(9.80665)
    assert recording.truth is not None
    (tmp_path / "truth.csv").write_text("t,x\n0,0\n1,1\n")
    with pytest.raises(InputError, match=r"truth\.csv: row 1: no column y"):
        read_log(tmp_path)


def test_a_folder_of_text_files_is_answered_by_their_new_name(tmp_path):
    write_text(tmp_path / "left.txt", "t,gx\n0,1\n")
    with pytest.raises(InputError, match=r"holds no node; .*; rename left\.txt to left\.csv"):
        read_log(tmp_path)


@pytest.mark.parametrize(
    ("width", "advice"),
    [
        (3, "--columns gx,gy,gz --rate HZ; - omits one"),
        (4, "--columns t,gx,gy,gz; - omits one"),
        (5, "--columns t,gx,gy,gz,-; - omits one"),
        (6, "--columns gx,gy,gz,ax,ay,az --rate HZ; - omits one"),
        (8, "--columns t,gx,gy,gz,ax,ay,az,-; - omits one"),
    ],
)
def test_a_file_without_headings_is_answered_by_as_many_names_as_it_has_columns(tmp_path, width, advice):
    np.save(tmp_path / "a.npy", np.arange(10.0 * width).reshape(10, width))
    with pytest.raises(InputError, match=f"has {width} columns.*{advice}$"):
        read_log(tmp_path / "a.npy")


def test_labels_beside_the_numbers_are_named_as_such(tmp_path):
    (tmp_path / "a.log").write_text("gx: 1.5 gy: 2.5\n" * 20)
    with pytest.raises(InputError, match="'gx:' is a label beside each number; write a table"):
        read_log(tmp_path / "a.log")


@pytest.mark.parametrize(
    ("headings", "advice"),
    [
        ("time,lat,lon,alt", "gnss.csv with t,latitude_deg,longitude_deg,altitude"),
        ("t,left_ticks,right_ticks", "wheels.csv with t,left,right in m/s"),
        ("t,left_gx,left_gy,left_gz,right_gx,right_gy,right_gz", "left.csv and right.csv into one folder"),
    ],
)
def test_a_table_of_something_else_is_answered_by_where_it_belongs(tmp_path, headings, advice):
    row = ",".join("1" * (headings.count(",") + 1))
    (tmp_path / "a.csv").write_text(f"{headings}\n{row}\n{row.replace('1', '2', 1)}\n")
    with pytest.raises(InputError, match=advice):
        read_log(tmp_path / "a.csv")


@pytest.mark.parametrize(("heading", "is_refused"), [("node", True), ("Sensor", True), ("activity", False)])
def test_rows_of_several_nodes_in_one_file_are_refused_other_words_are_not(tmp_path, heading, is_refused):
    rows = (f"{name},{k}{',0.1' * 6}" for k, name in enumerate(["left", "right"] * 4))
    (tmp_path / "a.csv").write_text(f"{heading},t,gx,gy,gz,ax,ay,az\n" + "\n".join(rows) + "\n")
    if is_refused:
        with pytest.raises(InputError, match=r"of 2 nodes \(left, right\)"):
            read_log(tmp_path / "a.csv")
    else:
        assert len(read_log(tmp_path / "a.csv").nodes["a"].t) == 8

"""Number files as other programs write them: columns, units and times by the format that they document."""

import codecs

import numpy as np
import pytest

from hubodo.errors import InputError
from hubodo.log.any_log import read_log
from in_process import hubodo

DEG = np.pi / 180.0
T = np.arange(4) * 0.01
RATES = np.arange(12.0).reshape(4, 3) / 16.0
FORCE = np.array([0.25, 0.5, 9.75]) + np.zeros((4, 3))
US = 1e6 * T + 5e6


def write(path, header, *columns, before="", encoding="utf-8", delimiter=","):
    """Write columns below a header; numpy columns of two dimensions are several columns."""
    arrays = [np.asarray(column).reshape(4, -1) for column in columns]
    rows = [[f"{cell}" for array in arrays for cell in array[k]] for k in range(4)]
    text = before + header + "\n" + "".join(delimiter.join(row) + "\n" for row in rows)
    path.write_bytes(text.encode(encoding))
    return path


def only_node(path):
    (table,) = read_log(path).nodes.values()
    return table


NS = (1e9 * T).astype(np.int64) + 1_767_225_600_000_000_000
ROS = "%time,field.header.frame_id," + ",".join(
    f"field.{name}.{axis}" for name in ("angular_velocity", "linear_acceleration") for axis in "xyz"
)
EUROC = "#timestamp [ns]," + ",".join(
    [f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"] + [f"a_RS_S_{axis} [m s^-2]" for axis in "xyz"]
)
PX4 = "timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt," + ",".join(
    f"accelerometer_m_s2[{k}]" for k in range(3)
)
INCREMENTS = "timestamp,timestamp_sample,{},delta_angle_dt,delta_velocity_dt".format(
    ",".join(f"{name}[{k}]" for name in ("delta_angle", "delta_velocity") for k in range(3))
)
DT_US = np.array([9_800.0, 10_000.0, 10_200.0, 2_500.0])
ARTEMIS = "rtcDate,rtcTime,aX,aY,aZ,gX,gY,gZ,imu_degC"
XSENS = "PacketCounter\tSampleTimeFine\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z"
DOT = "PacketCounter,SampleTimeFine,Euler_X,Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z"
UNITS_IN_NAMES = "Time_ms,AccX_g,AccY_g,AccZ_g,GyroX_dps,GyroY_dps,GyroZ_dps"
COUNT = np.arange(4)


@pytest.mark.parametrize(
    ("header", "columns", "options"),
    [
        (PX4, (US, RATES, COUNT, FORCE), {}),
        (
            INCREMENTS,
            (US + 300, US, RATES * 1e-6 * DT_US[:, None], FORCE * 2e-6 * DT_US[:, None], DT_US, 2 * DT_US),
            {},
        ),
        (
            ARTEMIS,
            (["03/14/2026"] * 4, [f"12:00:00.0{k}" for k in COUNT], FORCE / 9.80665e-3, RATES / DEG, COUNT),
            {},
        ),
        ("timestamp,TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", (T + 1e9, US, 0 * COUNT, RATES, FORCE), {}),
        ("timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z", (NS, RATES, FORCE), {}),
        (EUROC, (NS, RATES, FORCE), {}),
        (ROS, (NS, ["imu link"] * 4, RATES, FORCE), {}),
        ("__time,/i/angular_velocity/x,/i/angular_velocity/y,/i/angular_velocity/z", (T, RATES), {}),
        ("Time," + ROS.partition("id,")[2].replace("field.", ""), (T + 1e9, RATES, FORCE), {}),
        (XSENS, (COUNT, 1e4 * T + 77, FORCE, RATES), {"delimiter": "\t", "before": "// MT Manager 4.6\n"}),
        (DOT, (COUNT, US, COUNT, FORCE, RATES / DEG), {"before": "sep=,\nDeviceTag:,DOT\nRate:,100Hz\n\n"}),
        ("time,gFx,gFy,gFz,wx,wy,wz", (T, FORCE / 9.80665, RATES), {}),
        (UNITS_IN_NAMES, (1e3 * T, FORCE / 9.80665, RATES / DEG), {}),
        ("elapsed (s),x-axis (deg/s),y-axis (deg/s),z-axis (deg/s)", (T, RATES / DEG), {}),
        ("Time (s);gx (°/s);gy (°/s);gz (°/s)", (T, RATES / DEG), {"encoding": "cp1252", "delimiter": ";"}),
    ],
)
def test_times_and_channels_of_another_program_are_in_si_without_an_option(
    tmp_path, header, columns, options
):
    table = only_node(write(tmp_path / "imu.csv", header, *columns, **options))
    np.testing.assert_allclose(table.t - table.t[0], T, atol=1e-6)
    np.testing.assert_allclose(table.gyro, RATES, atol=1e-9)
    assert np.isnan(table.accel).all() or np.allclose(table.accel, FORCE)


def test_the_name_of_a_px4_file_says_what_its_axes_measure(tmp_path):
    header = "timestamp,timestamp_sample,device_id,x,y,z"
    table = only_node(write(tmp_path / "log_sensor_gyro_0.csv", header, US, US - 300, COUNT, RATES))
    np.testing.assert_allclose(table.gyro, RATES)
    with pytest.raises(InputError, match="name them, as in --columns"):
        read_log(write(tmp_path / "log_0.csv", header, US, US - 300, COUNT, RATES))


def test_each_imu_of_an_ardupilot_log_is_a_node(tmp_path):
    header = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    times, sensors = np.repeat(US[:2], 2), np.array([0, 1, 0, 1])
    nodes = read_log(write(tmp_path / "imu.csv", header, times, sensors, RATES, FORCE)).nodes
    assert list(nodes) == ["imu_0", "imu_1"]
    np.testing.assert_allclose(nodes["imu_1"].gyro, RATES[1::2])


def test_text_in_utf_16_is_read(tmp_path):
    path = write(tmp_path / "a.csv", "t,gx,gy,gz,ax,ay,az", T, RATES, FORCE, encoding="utf-16")
    assert path.read_bytes().startswith(codecs.BOM_UTF16_LE)
    np.testing.assert_allclose(only_node(path).gyro, RATES)


def test_a_folder_may_hold_files_in_utf_16_beside_others(tmp_path):
    header = "t,gx,gy,gz,ax,ay,az"
    for name, encoding in (("left", "utf-16"), ("right", "utf-16-le"), ("frame", "utf-8")):
        write(tmp_path / f"{name}.csv", header, T, RATES, FORCE, encoding=encoding)
    nodes = read_log(tmp_path).nodes
    assert sorted(nodes) == ["frame", "left", "right"]
    for node in nodes.values():
        np.testing.assert_allclose(node.gyro, RATES)


@pytest.mark.parametrize(
    ("name", "content", "advice"),
    [
        ("a.ulg", b"ULog\x01\x12\x35\x01", "ulog2csv"),
        ("a.bin", b"\xa3\x95\x80\x80\x59", "mavlogdump"),
        ("a.mtb", b"\xfa\xff\x36\x10", "MT Manager"),
        ("a.json", b'[{"gx": 1}]', "as CSV"),
        ("imu.yaml", b"gyroscope_noise_density: 0.0002\n", "a file of settings"),
        ("a.xlsx", b"PK\x03\x04\x14\x00", "save the sheet as CSV"),
    ],
)
def test_a_file_that_must_be_converted_is_refused_with_the_program_that_does_it(
    tmp_path, name, content, advice
):
    (tmp_path / name).write_bytes(content + bytes(100))
    with pytest.raises(InputError, match=advice):
        read_log(tmp_path / name)


def test_one_sensor_is_evaluated_without_the_unit_of_the_other(tmp_path):
    header = "time,gx (deg/s),gy (deg/s),gz (deg/s),ax,ay,az"
    rng = np.random.default_rng(1)
    rows = np.column_stack([np.arange(3000) / 100.0, rng.normal(0.0, 0.1, (3000, 3)), np.ones((3000, 3))])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=header, comments="")
    assert hubodo("allan", tmp_path / "a.csv", "--channel", "gz").code == 0
    refused = hubodo("import", tmp_path / "a.csv", "-o", tmp_path / "a.mcap")
    assert refused.code == 2 and "the unit of ax, ay, az is missing; give --unit" in refused.err

"""Identification of a node as text."""

import math

import pytest

from fakes.node_messages import hello
from hubodo.ingest.node.identity import code_name, describe_firmware_difference, hello_metadata
from hubodo.ingest.node.imu_noise import sample_noise
from hubowire.messages import Part, ResetCause


def test_metadata_is_the_hello_in_decimal_and_hexadecimal_text() -> None:
    fields = hello_metadata(
        hello(fingerprint=0x00ABCDEF, rate_mhz=416_667, parts=((0x6B, 0x69, Part.LSM6DS33),))
    )
    assert fields["fingerprint"] == "00abcdef"
    assert fields["firmware"] == "1.4.2"
    assert fields["serial"] == "0011223344556677"
    assert fields["rate_hz"] == "416.667"
    assert fields["parts"] == "0x6b who_am_i 0x69 LSM6DS33"
    assert all(isinstance(value, str) for value in fields.values())


def test_a_chip_that_the_host_does_not_know_is_unknown_and_no_error() -> None:
    assert hello_metadata(hello(parts=((0x10, 0x20, 200), (0x6B, 0x69, 1))))["parts"] == (
        "0x10 who_am_i 0x20 unknown; 0x6b who_am_i 0x69 LSM6DS33"
    )


def test_a_chip_without_a_part_is_known_by_its_identity_with_the_noise_of_its_data_sheet() -> None:
    """LSM6DSO: 3.8 mdeg/s/√Hz and 70 µg/√Hz (ST DS12140); white noise in half the rate."""
    node = hello(rate_mhz=416_000, parts=((0x1E, 0x3D, Part.LIS3MDL), (0x6B, 0x6C, 0)))
    assert hello_metadata(node)["parts"].endswith("0x6b who_am_i 0x6c LSM6DSO")
    gyro, accel = sample_noise(node)
    assert math.degrees(gyro) == pytest.approx(3.8e-3 * 208**0.5)
    assert accel == pytest.approx(70e-6 * 9.80665 * 208**0.5)
    unknown_gyro, unknown_accel = sample_noise(hello(rate_mhz=416_000, parts=((0x6B, 0x11, 0),)))
    assert unknown_gyro > gyro and unknown_accel > accel


def test_an_lsm6dsv_and_an_mpu6500_with_the_same_identity_differ_by_their_addresses() -> None:
    parts = hello_metadata(hello(parts=((0x68, 0x70, 0), (0x6A, 0x70, 0), (0x6B, 0x73, 0))))["parts"]
    assert parts == ("0x68 who_am_i 0x70 unknown; 0x6a who_am_i 0x70 LSM6DSV; 0x6b who_am_i 0x73 LSM6DSV320X")


def test_equal_firmware_is_no_warning() -> None:
    assert describe_firmware_difference({}) is None
    assert describe_firmware_difference({"left": (1, 4, 2), "right": (1, 4, 2)}) is None


def test_different_firmware_is_listed_by_node_in_alphabetical_order() -> None:
    text = describe_firmware_difference({"right": (1, 4, 2), "left": (1, 3, 0)})
    assert text is not None
    assert "left 1.3.0, right 1.4.2" in text
    assert "hubodo flash" in text


def test_a_code_is_its_name_and_an_unknown_one_its_number() -> None:
    assert code_name(ResetCause, ResetCause.BROWN_OUT) == "brown_out"
    assert code_name(ResetCause, 99) == "99"

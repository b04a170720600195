"""Requested settings of a board: parsing of the command line, calibration and key of the board."""

from pathlib import Path

import pytest

from hubodo.calibration.file import CalibratedEffect, Calibration, NodeCalibration, Quantity
from hubodo.errors import CalibrationError, InputError
from hubodo.flash.order import SettingsOrder, parse_node_id, parse_settings
from hubodo.ingest.link.keys import KeyRing

SERIAL = "0011223344556677"


@pytest.mark.parametrize(
    ("text", "number"), [("left", 1), ("right", 2), ("frame", 3), ("254", 254), ("1", 1)]
)
def test_a_node_is_given_by_name_or_number(text: str, number: int) -> None:
    assert parse_node_id(text) == number


@pytest.mark.parametrize("text", ["0", "255", "-1", "middle", "", "1.0"])
def test_a_node_that_the_protocol_cannot_address_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="from 1 to 254"):
        parse_node_id(text, "--node")


def test_values_have_the_type_of_the_default_of_their_setting() -> None:
    settings = parse_settings(["rate_hz=208", "watchdog=false", "link=udp", "arm_mm=[30,-5]"])
    assert settings == {"rate_hz": 208, "watchdog": False, "link": "udp", "arm_mm": [30, -5]}


def test_a_password_of_digits_and_equals_signs_stays_text() -> None:
    assert parse_settings(["password=12345678"]) == {"password": "12345678"}
    assert parse_settings(["password=a=b=c"]) == {"password": "a=b=c"}
    assert parse_settings(["ssid="]) == {"ssid": ""}


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("rate_hz", "write NAME=VALUE"),
        ("rate_hx=208", "no setting 'rate_hx'; is it rate_hz?"),
        ("zzz=1", "no setting 'zzz'; see firmware/README.md"),
        ("rate_hz=fast", "rate_hz must be int"),
        ("rate_hz=20.5", "rate_hz must be int"),
        ("watchdog=1", "watchdog must be bool"),
        ("pins=[4]", "pins must be dict"),
        ("radio_nodes=[1,2,3,4,5,6]", "5 nodes at most; use a second receiver on another channel"),
    ],
)
def test_a_setting_that_no_node_has_or_of_another_type_is_refused(word: str, message: str) -> None:
    with pytest.raises(InputError) as refusal:
        parse_settings([word])
    assert f"--set {word}: " in str(refusal.value) and message in str(refusal.value)


def test_settings_of_the_order_replace_present_ones_and_leave_the_others() -> None:
    order = SettingsOrder({"rate_hz": 104})
    assert order.has_changes and not SettingsOrder().has_changes
    assert order.config({"rate_hz": 416, "ssid": "shed"}, SERIAL) == {"rate_hz": 104, "ssid": "shed"}


def test_each_board_has_one_key_which_stays_the_same(tmp_path: Path) -> None:
    path = tmp_path / "keys.toml"
    order = SettingsOrder(keys=KeyRing(path, create=True))
    first, second = order.config({}, SERIAL), order.config({}, "7766554433221100")
    assert first["key"] != second["key"]
    assert bytes.fromhex(str(first["key"])) == KeyRing(path).keys[SERIAL]
    assert SettingsOrder(keys=KeyRing(path)).config({}, SERIAL) == first


def _calibration(serial: str) -> Calibration:
    bias = CalibratedEffect({axis: Quantity(0.01, 0.001) for axis in "xyz"})
    return Calibration({"left": NodeCalibration({"gyro_bias": bias}, serial)})


def test_a_calibration_gives_the_settings_of_its_node() -> None:
    order = SettingsOrder({"node_id": 1}, _calibration(SERIAL.upper()), Path("calibration.toml"))
    config = order.config({}, SERIAL)
    # 0.01 rad/s are 572,958 udps.
    assert config["bias_udps"] == [572958] * 3


def test_a_setting_without_enough_heap_is_refused_whichever_command_sets_the_other_one() -> None:
    high_g = {"high_g_rate_hz": 400}
    with pytest.raises(InputError, match=r"high_g_rate_hz and bias_kind 3: .* --set high_g_rate_hz=0"):
        parse_settings(["high_g_rate_hz=400", "bias_kind=3"])
    with pytest.raises(InputError, match="high_g_rate_hz and bias_kind 3"):
        SettingsOrder({"bias_kind": 3}).config(high_g, SERIAL)
    warm_up = {axis: Quantity(0.001, 1e-4) for axis in "xyz"} | {"time_constant": Quantity(60.0, 1.0)}
    node = NodeCalibration({"gyro_warmup": CalibratedEffect(warm_up)}, SERIAL)
    order = SettingsOrder({}, Calibration({"left": node}), Path("calibration.toml"))
    with pytest.raises(InputError, match="high_g_rate_hz and warmup_udps"):
        order.config(high_g, SERIAL)
    assert SettingsOrder({"bias_kind": 3, "high_g_rate_hz": 0}).config(high_g, SERIAL)["bias_kind"] == 3


def test_a_calibration_of_another_node_or_board_is_refused() -> None:
    order = SettingsOrder({"node_id": 2}, _calibration(SERIAL), Path("calibration.toml"))
    with pytest.raises(InputError, match="no node 'right', only left; give --node"):
        order.config({}, SERIAL)
    order = SettingsOrder({}, _calibration("aaaaaaaaaaaaaaaa"), Path("calibration.toml"))
    with pytest.raises(CalibrationError, match="belongs to the board with serial aaaaaaaaaaaaaaaa"):
        order.config({"node_id": 1}, SERIAL)

"""Health reports of a node: events of counters that have grown, supply, and JSON."""

import dataclasses
import math

import pytest

from fakes.node_messages import health
from hubodo.ingest.node.health import SupplyHistory, health_json, read_supply, report_worsening
from hubowire.messages import Fault


def test_a_report_without_new_errors_is_no_event() -> None:
    before = health(i2c_errors=3, faults=Fault.LOW_BATTERY)
    assert list(report_worsening("left", before, before, 5)) == []
    assert list(report_worsening("left", None, health(), 5)) == []


def test_the_event_lists_new_faults_and_the_growth_of_each_counter() -> None:
    before = health(i2c_errors=3, frames_dropped=2, faults=Fault.LOW_BATTERY)
    now = health(i2c_errors=5, frames_dropped=9, faults=Fault.LOW_BATTERY | Fault.BUS_STUCK)
    (event,) = report_worsening("left", before, now, 77)
    assert (event.t_ns, event.kind, event.source) == (77, "health", "left")
    assert event.text == "left: bus stuck, i2c errors +2, frames dropped +7"
    assert event.data == {"node": "left", **health_json("left", now)}


def test_counters_of_the_first_report_count_from_zero() -> None:
    (event,) = report_worsening("left", None, health(samples_missed=4), 0)
    assert event.text == "left: samples missed +4"


def test_counters_that_a_restart_set_back_are_no_growth() -> None:
    assert list(report_worsening("left", health(i2c_errors=9), health(i2c_errors=1), 0)) == []


@pytest.mark.parametrize(("percent", "charge"), [(0, 0.0), (55, 0.55), (100, 1.0)])
def test_supply_is_in_volts_and_a_share(percent: int, charge: float) -> None:
    assert read_supply(health(battery_mv=3712, battery_percent=percent)) == (3.712, charge)


def test_a_charge_above_100_percent_means_unknown() -> None:
    assert math.isnan(read_supply(health(battery_percent=255))[1])


def test_json_has_every_field_of_the_message() -> None:
    fields = health_json("right", health(worst_loop_us=1234))
    assert fields["node"] == "right" and fields["worst_loop_us"] == 1234
    assert set(fields) - {"node"} == {field.name for field in dataclasses.fields(health())}


def test_the_supply_at_a_time_is_the_newest_one_measured_before() -> None:
    history = SupplyHistory()
    assert history.voltage_at(10) is None
    for t_ns in range(0, 200, 10):
        history.add(t_ns, t_ns / 100)
    assert history.voltage_at(190) == history.voltage_at(500) == 1.9
    assert history.voltage_at(189) == 1.8
    # Of 20 voltages the eight newest are stored.
    assert history.voltage_at(120) == 1.2
    assert history.voltage_at(119) is None

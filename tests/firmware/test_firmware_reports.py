"""Reports of a node as decoded by the host: Hello without a chip, saturating counters, faults."""

from types import SimpleNamespace

import reports
from outbox import Outbox

import hubowire
from hubowire.messages import Fault, Filter


def create_node(**parts):
    """Return a node with only the parts that the reports use."""
    defaults = {
        "chip": None,
        "mag": None,
        "batch": 8,
        "chips": (),
        "faults": 0,
        "i2c_errors": 0,
        "recoveries": 0,
    }
    return SimpleNamespace(
        parts=SimpleNamespace(**{**defaults, **parts}),
        board=SimpleNamespace(serial=bytes(8), boot_id=9, kind=1, reset_cause=1, battery_mv=lambda: 3300),
        settings={"filter_kind": 0, "low_battery_mv": 3500},
        sampler=SimpleNamespace(clock=SimpleNamespace(bound_us=lambda: 65535), overruns=70000, missed=65535),
        link=SimpleNamespace(reader=SimpleNamespace(damaged=3)),
        outbox=Outbox(4, 1),
        longest_us=1234,
        free_heap=100_000,
    )


def take_message(reporting):
    """Return the only message in the outbox, decoded."""
    wire = bytes(reporting.outbox.oldest().raw[1 + reporting.outbox.sent : reporting.outbox.oldest().end])
    reporting.outbox.advance(len(wire))
    (frame,) = hubowire.FrameDecoder().feed(wire)
    return hubowire.decode(frame.type_id, frame.payload)


def test_without_a_chip_hello_has_zeros_for_it():
    reporting = create_node(chips=((0x6B, 0x33, 0),))
    reports.hello(reporting)
    hello = take_message(reporting)
    chip_fields = (
        hello.rate_mhz, hello.gyro_range_dps, hello.accel_range_g, hello.gyro_lsb_ndps, hello.accel_lsb_ng,
        hello.temperature_lsb_udegc, hello.temperature_offset_udegc, hello.mag_lsb_ft,
    )  # fmt: skip
    assert chip_fields == (0,) * 8
    assert hello.parts == ((0x6B, 0x33, 0),) and hello.stamp_bound_us == 65535


def test_the_filter_report_has_the_axes_in_order():
    reporting = create_node()
    reporting.estimator = SimpleNamespace(
        saturations=4, rate_q8=lambda axis: -(100 + axis), bias_q12=lambda axis: 200 + axis
    )
    reporting.init = SimpleNamespace(
        state=2, samples=2000, variance_q8=[300, 301, 302], sigma_q12=[400, 401, 402]
    )
    reporting.sampler.newest_us = 77
    reports.filter_state(reporting)
    assert take_message(reporting) == Filter(
        77, 2, 4, 2000, (-100, -101, -102), (200, 201, 202), (300, 301, 302), (400, 401, 402)
    )


def test_counters_in_health_saturate_and_the_longest_loop_is_reset():
    reporting = create_node(i2c_errors=65534, recoveries=1 << 20)
    reports.health(reporting)
    health = take_message(reporting)
    assert (health.i2c_errors, health.bus_recoveries, health.fifo_overruns) == (65534, 65535, 65535)
    assert (health.samples_missed, health.frames_damaged, health.worst_loop_us) == (65535, 3, 1234)
    assert reporting.longest_us == 0


def test_low_battery_is_a_fault_only_below_the_limit_and_only_if_measured():
    reporting = create_node()
    for millivolts, fault in ((3499, Fault.LOW_BATTERY), (3500, 0), (0, 0)):
        reporting.board.battery_mv = lambda volts=millivolts: volts
        reports.health(reporting)
        health = take_message(reporting)
        assert (health.battery_mv, health.faults) == (millivolts, fault)

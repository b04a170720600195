"""Tables and pages in the chosen units, SI or those of data sheets; JSON is in SI whatever is chosen."""

import io
import json
import re

import numpy as np
import pytest
from rich.console import Console

import hubodo
from generators.rate_table import Axis, turn_table
from generators.table_folders import write_record
from generators.table_record import DEG_H, Programme
from hubodo.sensors.allan.page import allan_sections
from hubodo.sensors.filters.page import filter_sections
from hubodo.sensors.heading.page import heading_sections
from hubodo.sensors.imu.page import imu_sections
from hubodo.sensors.imu.pose_plan import plan_poses
from hubodo.sensors.north.drift import DriftNoise
from hubodo.sensors.north.page import north_sections
from hubodo.sensors.north.plan import plan_stops
from hubodo.sensors.warmup.page import warmup_sections
from hubodo.unit_systems import UNIT_SYSTEM_ALIASES
from in_process import hubodo as run

COMMON = re.compile(r"°(?!C)|\bdeg\b|\bmg\b|µg|ppm|arc-min|/√?h\b")
SI = re.compile(r"\brad\b|m/s²|m/s/√s")
ANGLE_TO_SET = re.compile(r"\d[\d, ]* degrees")
"""Angles of a table are set in degrees."""


def printed(result):
    console = Console(file=io.StringIO(), width=400)
    result.render(console)
    return console.file.getvalue()


def page_text(sections):
    """Return the texts and tables of sections."""
    parts = []
    for section in sections:
        parts += [section.text, *(section.advice or ())]
        parts += [" ".join(map(str, row)) for it in section.tables or () for row in (it.headings, *it.rows)]
    return " ".join(parts)


def still_log(seconds=400, rate=20.0):
    rng = np.random.default_rng(1)
    t = np.arange(int(seconds * rate)) / rate
    warm = -0.005 * np.exp(-t / 40.0)[:, None]
    gyro = rng.normal(0.01, 1e-4, (len(t), 3)) + warm
    return hubodo.from_arrays(gyro, rng.normal([0.0, 0.0, 9.81], 0.01, (len(t), 3)), t=t)


def turned_log():
    t, gyro, table = turn_table(
        np.random.default_rng(2), Axis(bias=0.01, scale=0.004), seconds=10.0, rounds=1
    )
    accel = np.random.default_rng(3).normal([0.0, 0.0, 9.81], 0.01, (len(t), 3))
    return hubodo.from_arrays(np.column_stack([0.0 * t, 0.0 * t, gyro]), accel, t=t), np.degrees(table[:, 1])


def carousel_result(folder):
    programme = Programme([180, -90, 180, -270, 180, -90, 180], [15.0] * 8, [60.0] * 7)
    noise = {"n": np.radians(0.002), "b": 0.5 * DEG_H, "k": 1e-8}
    world = {"azimuth": np.radians(30.0), "latitude": np.radians(45.0), "hz": 10.0, "noise": noise}
    write_record(folder, programme, np.random.default_rng(1), **world)
    return hubodo.open(folder).north(latitude_deg=45.0, method="maytag4", near_deg=20.0)


def pose_result():
    rng = np.random.default_rng(5)
    up = rng.normal(size=(16, 3))
    means = 9.80665 * up / np.linalg.norm(up, axis=1)[:, None] + [0.02, -0.01, 0.03]
    accel = np.repeat(means, 120, axis=0) + rng.normal(0.0, 0.002, (1920, 3))
    gyro = rng.normal(0.001, 1e-4, (1920, 3))
    gyro[::120] += 1.0  # the sensor is turned to the next pose
    return hubodo.from_arrays(gyro, accel, rate=50.0).calibrate_imu()


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Return each result with a function that returns the sections of its page."""
    still, (turned, rates) = still_log(), turned_log()
    return (
        (still.allan(channel="gz"), allan_sections),
        (still.allan(channel="az"), allan_sections),
        (still.warmup(channel="gz"), warmup_sections),
        (turned.heading(standstills=[(0.0, 9.0)]), heading_sections),
        (turned.filters(standstills=[(0.0, 9.0)], end=40.0), filter_sections),
        (turned.calibrate_rate(rates_deg_s=rates), None),
        (pose_result(), imu_sections),
        (plan_poses(DriftNoise(2e-3, 0.0, 0.0), 5e-3, 5.0), None),
        (carousel_result(tmp_path_factory.mktemp("table")), north_sections),
        (plan_stops(DriftNoise(1e-5, 1e-6, 0.0), 45.0, 1.0, 2.0), None),
    )


@pytest.fixture
def no_figures(monkeypatch):
    for room in ("allan", "warmup", "filters", "north"):
        monkeypatch.setattr(f"hubodo.sensors.{room}.page.render_drawing", lambda draw: None)


@pytest.mark.parametrize(("system", "other"), [("si", COMMON), ("common", SI)], ids=("si", "common"))
@pytest.mark.usefixtures("no_figures")
def test_tables_and_pages_have_the_chosen_units_and_json_is_as_before(results, system, other):
    for result, sections in results:
        before = json.dumps(result.as_json())
        with hubodo.display_units(system):
            text = printed(result) + ("" if sections is None else page_text(sections(result)))
            assert json.dumps(result.as_json()) == before
        table_text = text
        for note in getattr(result, "notes", ()):  # remarks name what they are about in its own unit
            table_text = table_text.replace(note[1:], "")
        table_text = ANGLE_TO_SET.sub("", table_text)
        assert not other.search(table_text), (type(result), other.findall(table_text), text)


def test_the_choice_ends_with_the_statement_and_a_wrong_one_is_refused(results):
    rate = results[5][0]
    before = printed(rate)
    with hubodo.display_units("common"), hubodo.display_units("si"):
        assert "rad/s" in printed(rate)
    assert printed(rate) == before
    with pytest.raises(hubodo.InputError, match="units 'metric': choose from common, si"):
        hubodo.display_units("metric")


def test_the_option_chooses_units_and_is_not_that_of_a_file():
    words = ("calibrate", "plan", "--noise-density", 0.002)
    assert "bias 1σ, m/s²" in run(*words, "--units", "si").out
    for system in ("common", *UNIT_SYSTEM_ALIASES):
        assert f"bias 1σ, {'m/s²' if system == 'SI' else 'mg'}" in run(*words, "--units", system).out
    refused = run(*words, "--units", "deg/s")
    assert refused.code == 2 and "the unit of a file is --unit" in refused.err

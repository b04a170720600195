"""NMEA decoder: time and sigmas, empty fields, damaged lines, rollovers."""

import calendar
import functools
import math
import operator
import random
import time

import pynmea2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hubodo.ingest.gnss.nmea import NmeaDecoder
from hubodo.ingest.gnss.session import GnssSession
from hubodo.log.records import EventRecord, GnssFix, NmeaBytes
from hubodo.units import NS_PER_S

NOW = calendar.timegm((2026, 5, 17, 12, 35, 20)) * NS_PER_S


def line(body):
    """Return a sentence with its checksum: XOR of all characters between $ and *."""
    checksum = 0
    for character in body:
        checksum ^= ord(character)
    return f"${body}*{checksum:02X}\r\n".encode()


def epoch(at="123519.00", day="170526", talker="GN", gst=True, quality=4):
    out = line(f"{talker}GGA,{at},4807.0380000,N,01131.0000000,E,{quality},12,0.7,545.4,M,46.9,M,1.0,0000")
    out += line(f"{talker}RMC,{at},A,4807.0380000,N,01131.0000000,E,0.10,,{day},,,R")
    if gst:
        out += line(f"{talker}GST,{at},0.02,0.03,0.02,45.0,0.012,0.018,0.035")
    return out


def fixes(data, t_ns=NOW):
    decoder = NmeaDecoder()
    return [*decoder.feed(data, t_ns), *decoder.flush()]


@pytest.mark.parametrize("talker", ["GP", "GN", "GA", "GB", "GL", "QZ"])
def test_an_epoch_becomes_one_fix_with_the_sentences_own_time(talker):
    (fix,) = fixes(epoch(talker=talker))
    assert fix.utc_ns == calendar.timegm((2026, 5, 17, 12, 35, 19)) * NS_PER_S
    assert fix.latitude_deg == pytest.approx(48 + 7.038 / 60, abs=1e-9)
    assert fix.longitude_deg == pytest.approx(11 + 31 / 60, abs=1e-9)
    assert fix.altitude == pytest.approx(545.4 + 46.9)  # height above the ellipsoid
    assert fix.status == 2
    assert fix.received_ns == NOW


def test_sigmas_are_those_of_gst_in_east_north_up_and_none_without_it():
    # GST gives latitude before longitude (NMEA 0183: fields 6, 7, 8).
    assert fixes(epoch())[0].sigma == (0.018, 0.012, 0.035)
    assert fixes(epoch(gst=False))[0].sigma is None


def test_a_south_western_position_is_negative():
    body = "GNGGA,123519,3352.0000,S,15112.0000,W,1,08,0.9,10.0,M,0.0,M,,"
    (fix,) = fixes(line(body) + line("GNRMC,123519,A,3352.0000,S,15112.0000,W,0,0,170526,,,A"))
    assert fix.latitude_deg < 0 > fix.longitude_deg


def test_empty_fields_are_legal_and_give_no_invented_numbers():
    nothing = line("GNGGA,,,,,,0,00,99.99,,,,,,") + line("GNRMC,,V,,,,,,,,,,N") + line("GNGST,,,,,,,,")
    assert fixes(nothing) == []
    without_height = line("GNGGA,123519,4807.038,N,01131.000,E,1,08,0.9,,,,,,")
    (fix,) = fixes(without_height)
    assert math.isnan(fix.altitude)
    assert fix.utc_ns is None  # without RMC the date is unknown


def test_a_position_without_a_fix_is_not_one():
    assert fixes(epoch(quality=0)) == []


def test_bad_checksums_and_unknown_sentences_are_counted_and_ignored():
    decoder = NmeaDecoder()
    bad = epoch().replace(b"4807.0380000,N,01131.0000000,E,0.10", b"4807.0380001,N,01131.0000000,E,0.10")
    data = bad + line("GNXYZ,1,2,3") + b"garbage\r\n\xff\xfe$GP\r\n" + epoch("123520.00")
    got = [*decoder.feed(data, NOW), *decoder.flush()]
    assert len(got) == 2
    assert decoder.counts.checksum_errors == 1
    assert got[0].utc_ns is None  # its RMC, which has the date, was damaged
    assert got[1].utc_ns is not None


@given(st.integers(1, 40))
def test_the_block_size_does_not_matter(size):
    data = epoch("123519.00") + epoch("123520.00") + epoch("123521.00")
    decoder, got = NmeaDecoder(), []
    for k in range(0, len(data), size):
        got += decoder.feed(data[k : k + size], NOW)
    got += decoder.flush()
    assert [f.utc_ns for f in got] == [f.utc_ns for f in fixes(data)]
    assert len(got) == 3


def test_a_fix_is_given_as_soon_as_the_usual_sentences_are_there():
    decoder = NmeaDecoder()
    list(decoder.feed(epoch("123519.00"), NOW))
    assert len(list(decoder.feed(epoch("123520.00"), NOW))) == 2  # without waiting for the next epoch


def test_midnight_between_date_and_time_is_assigned_to_the_correct_day():
    decoder = NmeaDecoder()
    data = epoch("235959.00", "170526")
    data += line("GNGGA,000000.00,4807.038,N,01131.000,E,1,08,0.9,5,M,0,M,,")
    data += line("GNRMC,000000.00,A,4807.038,N,01131.000,E,0,0,180526,,,A")
    got = [*decoder.feed(data, NOW + 43200 * NS_PER_S), *decoder.flush()]
    assert got[1].utc_ns - got[0].utc_ns == NS_PER_S


def test_a_date_1024_weeks_back_is_a_week_rollover_and_set_right():
    then = time.gmtime(NOW / NS_PER_S - 1024 * 7 * 86400)
    (fix,) = fixes(epoch(day=time.strftime("%d%m%y", then)))
    assert fix.utc_ns == calendar.timegm((2026, 5, 17, 12, 35, 19)) * NS_PER_S


@given(st.binary(max_size=300))
def test_no_bytes_make_it_raise(data):
    list(NmeaDecoder().feed(data + b"\n" + epoch(), NOW))


@given(
    st.lists(st.sampled_from(["GGA", "RMC", "GST"]), max_size=4), st.text("0123456789.,NSEWAV-", max_size=60)
)
def test_no_sentence_with_a_right_checksum_makes_it_raise(kinds, suffix):
    list(NmeaDecoder().feed(b"".join(line(f"GN{kind},{suffix}") for kind in kinds), NOW))


def test_sentences_of_an_independent_writer_are_read():
    fields = [
        "184353.07",
        "1929.045",
        "S",
        "02410.506",
        "E",
        "1",
        "04",
        "2.6",
        "100.00",
        "M",
        "-33.9",
        "M",
        "",
        "0000",
    ]
    text = str(pynmea2.GGA("GP", "GGA", tuple(fields)))
    (fix,) = fixes(text.encode() + b"\r\n")
    assert (fix.latitude_deg, fix.longitude_deg) == pytest.approx((-19.484083333, 24.1751))
    assert fix.altitude == pytest.approx(66.1)


class FakeSink:
    """A sink that keeps fixes, events and bytes."""

    def __init__(self):
        self.fixes, self.events, self.bytes = [], [], b""

    def write_record(self, record):
        match record:
            case GnssFix():
                self.fixes.append((record.t_ns, record.t_log_ns))
            case EventRecord():
                self.events.append(record.event)
            case NmeaBytes():
                self.bytes += record.data


def test_fixes_carry_gnss_time_where_the_hosts_clock_agrees():
    sink = FakeSink()
    session = GnssSession("gnss", sink)
    data = epoch("123519.00") + epoch("123520.00")
    session.handle_bytes(data, NOW)
    session.close()
    assert [published for published, _ in sink.fixes] == [NOW - NS_PER_S, NOW]
    assert sink.events == []
    assert sink.bytes == data


def test_where_it_does_not_they_are_put_on_the_hosts_clock_and_an_event_says_so():
    sink = FakeSink()
    session = GnssSession("gnss", sink)
    off = 3600 * NS_PER_S
    for k, delay in enumerate((0.9, 0.2, 0.5)):
        session.handle_bytes(
            epoch(f"1235{19 + k:02d}.00"), NOW - NS_PER_S + off + k * NS_PER_S + int(delay * NS_PER_S)
        )
    session.close()
    assert [event.kind for event in sink.events] == ["clock"]
    published = [p for p, _ in sink.fixes]
    assert published[-1] == NOW + NS_PER_S + off + int(0.2 * NS_PER_S)
    assert published == sorted(published)


HOSTILE = (
    "nan",
    "-inf",
    "inf",
    "1e200",
    "-1e200",
    "9" * 40,
    "",
    "-",
    "0x1f",
    "1_0",
    "۴۲",
    "N",
    "1.2.3",
    " 7 ",
)


@pytest.mark.parametrize("seed", range(3))
def test_sentences_with_hostile_fields_and_valid_checksums_are_counted_and_nothing_is_raised(seed):
    rng = random.Random(seed)
    decoder, fixes = NmeaDecoder(), []
    for number in range(3000):
        at = f"{number % 24:02d}{number % 60:02d}{number % 60:02d}.00"
        for text in epoch(at=at).decode().split():
            fields = text[1 : text.index("*")].split(",")
            for _ in range(rng.choice((0, 0, 1, 2))):
                fields[rng.randrange(len(fields))] = rng.choice(HOSTILE)
            body = ",".join(fields).encode("utf-8")
            check = functools.reduce(operator.xor, body)
            fixes += decoder.feed(b"$%s*%02X\r\n" % (body, check), NOW)
    fixes += decoder.flush()
    assert decoder.counts.unparsed > 100, f"seed {seed}"
    assert len(fixes) > 1000, f"seed {seed}"
    for fix in fixes:
        assert -90 <= fix.latitude_deg <= 90 and -180 <= fix.longitude_deg <= 180, f"seed {seed}"
        assert abs(fix.altitude) < 1e6 or math.isnan(fix.altitude), f"seed {seed}"
        assert fix.sigma is None or all(0 < sigma <= 1e5 for sigma in fix.sigma), f"seed {seed}"


def test_sigmas_of_zero_are_treated_as_unknown():
    zeros = line("GNGST,123519.00,0.0,0.0,0.0,0.0,0.0,0.0,0.0")
    assert fixes(epoch(gst=False) + zeros)[0].sigma is None

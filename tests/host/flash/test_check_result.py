"""Results of the checks of a board: verdicts and the keys of their JSON."""

from hubodo.flash.check_result import CHECKS, CheckResult, failed_check, passed_check, unknown_check


def test_each_verdict_has_a_label() -> None:
    assert passed_check("port", "open").verdict == "ok"
    assert failed_check("port", "missing", "plug it in").verdict == "wrong"
    assert unknown_check("port", "not tried").verdict == "unknown"


def test_json_has_the_established_key_and_the_name_that_people_see() -> None:
    result = failed_check("protocol", "text of a GNSS receiver", "give this port with --gnss")
    assert result.as_json() == {
        "check": "speech",
        "name": "protocol",
        "verdict": "wrong",
        "seen": "text of a GNSS receiver",
        "remedy": "give this port with --gnss",
    }


def test_no_two_checks_share_a_key_and_no_key_is_lost() -> None:
    """Keys as in the first version of the JSON; programs depend on them."""
    keys = [CheckResult(check, "ok", "").as_json()["check"] for check in CHECKS]
    assert keys == [
        *("port", "speech", "MicroPython", "wires", "files", "hello"),
        *("sensor", "power", "samples", "rest", "clock", "link"),
    ]

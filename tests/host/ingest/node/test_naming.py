"""Unique names of nodes and links."""

from hubodo.ingest.node.naming import RecordedNames, assign_name, unique_name


def test_the_first_free_number_is_appended():
    assert unique_name("left", {"right"}) == "left"
    assert unique_name("left", {"left", "left_2", "left_4"}) == "left_3"


def test_the_name_of_the_port_comes_first_and_a_clash_of_standard_names_is_reported():
    assert assign_name("front", 1, {"left"}) == ("front", False)
    assert assign_name(None, 1, set()) == ("left", False)
    assert assign_name("front", 1, {"front", "left"}) == ("left_2", True)


def test_boards_of_one_id_have_the_names_of_the_log_whichever_is_decoded_first():
    log = {"node.left": {"serial": "aa01"}, "node.left_2": {"serial": "aa02"}, "hubodo": {"serial": "aa03"}}
    for order in (("aa01", "aa02"), ("aa02", "aa01")):
        names = RecordedNames(log)
        assert {serial: names.assign(None, 1, bytes.fromhex(serial)) for serial in order} == {
            "aa01": "left",
            "aa02": "left_2",
        }
    names = RecordedNames(log)
    assert names.assign(None, 1, b"\xaa\x03") == "left_3", "a board that the log does not name"
    assert names.assign(None, 1, b"") == "left", "a node that never identified itself"
    assert names.assign(None, 1, b"\xaa\x01") == "left_4", "its name is in use"


def test_a_board_recorded_on_two_links_keeps_both_names():
    names = RecordedNames({"node.left": {"serial": "aa01"}, "node.left_2": {"serial": "aa01"}})
    assert [names.assign(None, 1, b"\xaa\x01") for _ in range(2)] == ["left", "left_2"]


def test_the_name_of_a_port_comes_first_unless_another_board_has_it_in_the_log():
    log = {"node.left": {"serial": "aa01"}, "node.left_2": {"serial": "aa02"}}
    names = RecordedNames(log)
    assert names.assign("left", 1, b"\xaa\x02") == "left_2"
    assert names.assign("left", 1, b"\xaa\x01") == "left"
    assert names.assign("front", 1, b"\xaa\x01") == "front", "a board of this serial on another link"

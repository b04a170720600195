"""Unique names of nodes and links."""

from hubodo.ingest.node.naming import assign_name, unique_name


def test_the_first_free_number_is_appended():
    assert unique_name("left", {"right"}) == "left"
    assert unique_name("left", {"left", "left_2", "left_4"}) == "left_3"


def test_the_name_of_the_port_comes_first_and_a_clash_of_standard_names_is_reported():
    assert assign_name("front", 1, {"left"}) == ("front", False)
    assert assign_name(None, 1, set()) == ("left", False)
    assert assign_name("front", 1, {"front", "left"}) == ("left_2", True)

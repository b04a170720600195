"""What a node and its host assume of each other before either is told anything."""

import inspect

import settings

from hubodo.ingest.link.link import PortLink
from hubodo.ingest.live.record_config import RecordConfig
from hubowire import budget


def test_the_node_s_uart_and_record_speak_the_same_rate_unless_told_otherwise():
    rates = {
        settings.DEFAULTS["baud"],
        RecordConfig().baud,
        inspect.signature(PortLink).parameters["baud"].default,
    }
    assert rates == {budget.UART_BAUD}


def test_that_rate_carries_every_rate_of_the_chips_and_the_console_s_does_not():
    loads = {
        (baud, rate): budget.link_load(budget.serial_link(baud), rate, 16)
        for baud in (budget.UART_BAUD, budget.CONSOLE_BAUD)
        for rate in (208, 416, 1660)
    }
    assert max(load for (baud, _), load in loads.items() if baud == budget.UART_BAUD) < budget.MAX_LINK_LOAD
    assert loads[budget.CONSOLE_BAUD, 416] < budget.MAX_LINK_LOAD < loads[budget.CONSOLE_BAUD, 1660]

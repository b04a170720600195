"""Defaults of node and host agree."""

import inspect

import settings

from hubodo.ingest.link.link import PortLink
from hubodo.ingest.live.record_config import RecordConfig
from hubowire import budget


def test_node_and_recorder_have_the_same_default_baud_rate():
    rates = {
        settings.DEFAULTS["baud"],
        RecordConfig().baud,
        inspect.signature(PortLink).parameters["baud"].default,
    }
    assert rates == {budget.UART_BAUD}


def test_the_default_baud_rate_carries_every_sample_rate_and_that_of_the_console_does_not():
    loads = {
        (baud, rate): budget.link_load(budget.serial_link(baud), rate, 16)
        for baud in (budget.UART_BAUD, budget.CONSOLE_BAUD)
        for rate in (208, 416, 1660)
    }
    assert max(load for (baud, _), load in loads.items() if baud == budget.UART_BAUD) < budget.MAX_LINK_LOAD
    assert loads[budget.CONSOLE_BAUD, 416] < budget.MAX_LINK_LOAD < loads[budget.CONSOLE_BAUD, 1660]

"""Waiting for reports of links continues after a signal."""

import signal
import threading
import time

from hubodo.ingest.live.computer import ThisComputer


def test_a_signal_whose_handler_outlasts_the_wait_does_not_make_it_endless():
    computer, handled = ThisComputer(), []
    rescue = threading.Timer(20, computer.put, ("much too late",))

    def handler(number, frame):
        time.sleep(0.2)
        handled.append(number)

    before = signal.signal(signal.SIGUSR2, handler)
    rescue.start()
    try:
        threading.Timer(0.05, signal.pthread_kill, (threading.get_ident(), signal.SIGUSR2)).start()
        while not handled:
            assert computer.next_report(0.1) is None
        assert computer.next_report(0.1) is None
    finally:
        rescue.cancel()
        signal.signal(signal.SIGUSR2, before)


def test_notifications_arrive_in_order_and_end_the_wait():
    computer = ThisComputer()
    assert computer.next_report(0.0) is None and computer.next_report(0.01) is None
    threading.Timer(0.02, computer.put, (1,)).start()
    assert computer.next_report(30.0) == 1
    for k in range(5):
        computer.put(k)
    assert [computer.next_report(30.0) for _ in range(5)] == list(range(5))

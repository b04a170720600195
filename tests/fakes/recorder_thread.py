"""A recorder in a thread of the test, and a listed serial device."""

import threading
from dataclasses import dataclass

from hubodo.ingest.live.daemon import record
from hubodo.ingest.live.record_config import RecordConfig


@dataclass
class Device:
    """A serial device in the list of ports."""

    device: str
    serial_number: str | None


class RecorderThread:
    """A recorder in a thread, so that the test can act on the nodes meanwhile."""

    def __init__(self, out, *ports, **kwargs):
        settings = {
            key: kwargs.pop(key) for key in list(kwargs) if key in ("wait", "duration", "gnss", "key_file")
        }
        config = RecordConfig(ports=ports, **settings)
        self.stop = threading.Event()
        self.result = self.error = None

        def run():
            try:
                self.result = record(config, out, stop=self.stop, **kwargs)
            except Exception as error:  # noqa: BLE001 handed to the test by `__exit__`
                self.error = error

        self.thread = threading.Thread(target=run)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.stop.set()
        self.thread.join(10)
        assert not self.thread.is_alive()
        if self.error is not None:
            raise self.error

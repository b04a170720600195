"""HTTP servers beside a recording: a bounded number of connections, in a thread of their own."""

"""Ports and what comes over them: bytes, strangers, links that break."""

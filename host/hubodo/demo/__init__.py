"""The whole product end to end without hardware: a drive, two virtual nodes, the daemon, fusion, a page."""

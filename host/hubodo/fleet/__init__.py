"""One analysis over many logs: found, shared out among processes, gathered in one table and on one page."""

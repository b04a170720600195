"""Run one analysis over many logs in parallel and collect the results in a table and a page."""

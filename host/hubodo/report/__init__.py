"""Reports: the pages of a log and of a gap search."""

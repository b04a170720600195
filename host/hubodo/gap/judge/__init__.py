"""Decision on effects: rounds of the search, reconsideration, held-out samples."""

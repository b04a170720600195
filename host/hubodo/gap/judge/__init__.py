"""The verdict on names: rounds of the search, second thoughts, what is held out."""

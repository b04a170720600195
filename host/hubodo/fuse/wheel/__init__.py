"""The filter of one or two wheels."""

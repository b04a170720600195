"""The package as Python programs and notebooks use it; its names stand in `hubodo.__all__`."""

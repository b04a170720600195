"""The Python interface of the package; its public names are in `hubodo.__all__`."""

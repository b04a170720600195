"""Version of the package, its documentation and its logs."""

__version__ = "0.1.0"

"""The version, of package, documents and logs."""

__version__ = "0.1.0"

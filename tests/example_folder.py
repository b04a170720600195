"""The files that the examples of the documentation use, as `hubodo example` writes them."""

from pathlib import Path

from hubodo.demo.example_files import write_example_files as write_files


def write_example_files(folder: Path) -> Path:
    """Write the files into a folder, and return it."""
    write_files(folder, lambda text, share: None)
    return folder

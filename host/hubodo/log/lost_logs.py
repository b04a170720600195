"""Logs that another program deletes or changes while they are written: how much is lost, in words."""

from __future__ import annotations

from hubodo.log.mcap_file import McapFile


def loss_words(file: McapFile) -> str | None:
    """Return why the messages of an open log are lost; None where they are not."""
    match file.file_state():
        case "nowhere":
            why = (
                f"was deleted or replaced while it was written; {file.message_count} messages in it are lost"
            )
        case "changed":
            why = (
                f"was shortened or written to by another program; up to {file.message_count} messages in it "
                "are lost (hubodo recover gives back those that are left)"
            )
        case _:
            return None
    return f"{file.path}: {why}"

"""From bytes on a link to timed samples in a log."""

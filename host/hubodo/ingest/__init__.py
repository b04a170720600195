"""Ingest: from bytes on a link to samples with host times in a log."""

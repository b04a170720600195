"""HTTP servers with bounded connections in threads of their own."""

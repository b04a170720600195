"""Reports: self-contained HTML pages with text, tables and figures, and figure files."""

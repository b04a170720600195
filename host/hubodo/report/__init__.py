"""Pages for people: one self-contained HTML file with words, tables and figures."""

"""Pages, figures and tables: self-contained HTML, figures as SVG or files, and tables on a terminal."""

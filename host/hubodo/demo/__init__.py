"""The end-to-end demonstration without hardware: two virtual nodes, recorder, fusion and page."""

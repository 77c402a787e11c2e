"""The experiments of the papers, run again: through the real service path and directly, with a table and a picture."""

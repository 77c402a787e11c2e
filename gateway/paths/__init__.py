"""Paths over the floor and who follows them: geometry and arithmetic only."""

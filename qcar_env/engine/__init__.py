"""Compiled fleets: many cars, closed loops, the exact map of linear ones."""

"""Analyses of a model at a point, over a period, or along a trajectory."""

"""Runners of other multibody programs on our scenes, for benchmarks: optional, never required."""

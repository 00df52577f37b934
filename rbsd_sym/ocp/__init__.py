"""Optimal control on the same model."""

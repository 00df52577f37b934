"""Foundations of all other folders: symbols, checks, names, rotations, linear algebra, files."""

"""Rigid-body mechanics as expressions: motion of frames, named quantities with units."""

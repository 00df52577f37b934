"""A Dae as functions with exact derivatives, and the values they are called with."""

"""Functions of a Dae with exact derivatives, and the values they are called with."""

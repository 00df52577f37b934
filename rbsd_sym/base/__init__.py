"""What every floor above may use: symbols, checks, rotations, linear algebra, files."""

"""A second opinion in numpy alone: textbook forms that share nothing with the library."""

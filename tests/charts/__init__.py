"""Scripts that measure and draw what the READMEs show; run from the command line, not by pytest."""

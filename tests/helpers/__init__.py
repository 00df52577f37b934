"""What tests of several folders share beside scenes: comparisons, compilers, refusals."""

"""Colours, line styles and markers of all figures."""

# The palette of Okabe and Ito, whose colours readers with any colour vision can distinguish.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#000000", "#CC79A7", "#56B4E9", "#E69F00", "#F0E442")
STYLES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

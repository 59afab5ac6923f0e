"""The four experiments of the paper, one module each, and what they share."""

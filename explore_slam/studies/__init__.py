"""The experiments of the paper, studies of strategies and accuracy, and reference methods."""

"""The paper's experiments, and studies of strategies and accuracy."""

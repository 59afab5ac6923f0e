"""The paper's four experiments, repeated: one module each, and what they share."""

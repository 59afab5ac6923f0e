"""The update step: proposal, landmark filters, map management, inter-robot observations."""

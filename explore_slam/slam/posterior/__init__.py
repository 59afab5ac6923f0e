"""Joint samples of all paths from the posterior of the graph: recorded, drawn, taken over."""

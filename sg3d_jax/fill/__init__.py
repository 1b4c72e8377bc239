"""Fill models: labels, edges and centroids of a block, given its size and the graph so far."""

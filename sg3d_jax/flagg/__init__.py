"""FLAGG: growing a graph in blocks by Insert, Fill and Halt, and the removal process behind it."""

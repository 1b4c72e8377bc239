"""Scene graphs for the eye. Nothing else in the package imports a plotting library."""

"""What goes in and out of the package: planes and scene graphs as files other programs read."""

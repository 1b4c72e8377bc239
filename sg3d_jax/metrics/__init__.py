"""How good generated scene graphs are: against the truth of the same planes, and as a set."""

"""Where scene graphs come from: generators, files, splits and their statistics."""

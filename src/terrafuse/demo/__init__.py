"""Two robots and a passing car in a world whose truth is known: the first thing to run."""

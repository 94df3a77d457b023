"""Linear programs, continuation, periodic motions, long simulations; the paper's own analysis."""

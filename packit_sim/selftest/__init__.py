"""Random comparisons of the engine with the oracle and with boolean volumes."""

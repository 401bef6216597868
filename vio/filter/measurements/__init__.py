"""One file a measurement of the filter: what it predicts, and its Jacobian."""

"""Tags themselves: families, their bit patterns, and where each one lies."""

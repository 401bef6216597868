"""The paper's tables, simulated: what is flown, what came of it, and which orderings hold."""

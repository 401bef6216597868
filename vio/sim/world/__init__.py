"""The simulated world: vehicles, their dynamics, flights and trajectories."""

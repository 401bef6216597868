"""The error-state Kalman filter: its state, propagation, history and health."""

"""The simulated sensors: IMU, camera, clocks, and what each gets wrong."""

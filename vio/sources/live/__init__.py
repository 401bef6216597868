"""Live sources: a camera, the autopilot's IMU, and the queue of their events."""

"""Plays a logged flight into a simulated autopilot: its IMU as the simulator, our poses besides."""

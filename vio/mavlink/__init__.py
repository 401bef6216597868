"""The bridge to a flight controller: poses out, IMU and clock in; all MAVLink is in here."""

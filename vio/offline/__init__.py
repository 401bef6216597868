"""What the commands for recorded flights do, without their words."""

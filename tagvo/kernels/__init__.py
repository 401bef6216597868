"""Compiled mathematics that several modules share: rotations, small linear algebra, projection."""

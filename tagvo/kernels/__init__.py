"""Compiled mathematics: the only place where loops over components stand."""

"""Is the rig set up as its files say: hypotheses, findings, tags that no map has."""

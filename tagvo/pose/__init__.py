"""From corners to one camera pose: the paper's stages in its order, and the joint pose."""

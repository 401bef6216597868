"""Floors of tags: laid out as in the paper, searched for many useful tags a view."""

"""A picture of a tag map by the definition of one: slow, and shared with neither renderer."""

import numpy as np

from tagvo.camera.model import unproject
from tagvo.tags.bitmaps import tag_bitmap


def cast_slowly(tag_map, camera, R_WC, p_WC, look, fine=7):
    """Each ray met with each tag in turn, by its definition; (h, w) grey levels."""
    width, height = camera.resolution
    t = (np.arange(fine) + 0.5) / fine - 0.5
    x, y = np.meshgrid(*((np.arange(k)[:, None] + t).ravel() for k in (width, height)))
    x_n, _, valid = unproject(camera, np.stack([x, y], axis=-1))
    d_W = np.concatenate([x_n, np.ones((*x.shape, 1))], axis=-1) @ R_WC.T
    light = np.full(x.shape, look.floor)
    nearest = np.full(x.shape, np.inf)
    for i in range(len(tag_map)):
        cells = tag_bitmap(tag_map.family, int(tag_map.tag_id[i]), tag_map.border_bits)
        side, n = tag_map.total_size[i], len(cells)
        o_T = tag_map.R_WT[i].T @ (p_WC - tag_map.p_WT[i])
        d_T = d_W @ tag_map.R_WT[i]
        depth = np.where(d_T[..., 2] != 0.0, -o_T[2] / d_T[..., 2], -1.0)
        xy = o_T[:2] + depth[..., None] * d_T[..., :2]
        hit = (np.abs(xy) < side / 2).all(axis=-1) & (depth > 0) & (depth < nearest) & (o_T[2] > 0)
        column = ((xy[..., 0] / side + 0.5) * n)[hit].astype(int)
        row = ((0.5 - xy[..., 1] / side) * n)[hit].astype(int)
        light[hit] = np.where(cells[row, column] > 0, look.white, look.black)
        nearest[hit] = depth[hit]
    light = light * valid
    return light.reshape(height, fine, width, fine).mean(axis=(1, 3))

"""Models that are sliced for the benchmarks, as binary STL, each with settings of CuraEngine."""

import struct

import numpy as np

from hframe_post.arrays import Array

SPREAD = {"center_object": "true", "machine_width": "220", "machine_depth": "220"}


def models() -> dict[str, tuple[bytes, dict[str, str]]]:
    """Return models with thousands of stops, short moves, fine infill, and without any stop."""
    hops = {"support_enable": "true", "retraction_hop_enabled": "true", "layer_height": "0.1"}
    fine = {"meshfix_maximum_resolution": "0.05", "meshfix_maximum_deviation": "0.005"}
    infill = {"infill_pattern": "gyroid", "infill_line_distance": "2", **fine}
    spiral = {"magic_spiralize": "true", **fine}
    return {
        "figure": (stl(*figure()), hops),
        "knot": (stl(knot()), {}),
        "gyroid": (stl(ellipsoid((0, 0, 18), (18, 18, 18), 400)), infill),
        "vase": (stl(vase()), spiral),
    }


def stl(*surfaces: Array) -> bytes:
    """Return closed surfaces, each a grid of points (n, m, 3) whose last column joins the first."""
    corners = []
    for points in surfaces:
        a, b = points[:-1], points[1:]
        c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
        pair = np.concatenate([np.stack([a, c, b], axis=2), np.stack([b, c, d], axis=2)])
        corners.append(pair.reshape(-1, 9))
    table = np.concatenate(corners)
    facets = np.zeros(len(table), dtype=[("n", "<f4", 3), ("v", "<f4", 9), ("a", "<u2")])
    facets["v"] = table
    return bytes(80) + struct.pack("<I", len(facets)) + facets.tobytes()


def around(n: int) -> Array:
    return np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)


def ellipsoid(centre: tuple[float, ...], radii: tuple[float, ...], n: int) -> Array:
    """Return the surface of an ellipsoid (n/2, n, 3)."""
    height, v = np.linspace(-np.pi / 2, np.pi / 2, n // 2)[:, None], around(n)[None]
    ball = np.stack(
        [np.cos(height) * np.cos(v), np.cos(height) * np.sin(v), np.sin(height) + 0.0 * v], axis=2
    )
    return np.asarray(centre + np.array(radii) * ball)


def figure() -> list[Array]:
    """Return a body of 34 mm with legs, raised arms and fingers, which need support and hops."""
    parts = [ellipsoid((0, 0, 16), (8, 6, 10), 160), ellipsoid((0, 0, 29), (5, 5, 5), 120)]
    for side in (-1, 1):
        parts.append(ellipsoid((4 * side, 0, 4), (3.5, 5, 6), 80))
        parts.append(ellipsoid((10 * side, 0, 19), (6, 2.5, 2.5), 80))
        for k in range(3):
            parts.append(ellipsoid(((13 + k) * side, 2 * k - 2, 24), (0.8, 0.8, 5), 40))
    return parts


def vase() -> Array:
    """Return a wavy vase of 40 mm, whose wall is one outline."""
    z, v = np.linspace(0.0, 40.0, 400)[:, None], around(2400)[None]
    radius = 15.0 + 4.0 * np.sin(z / 7.0) + 0.8 * np.sin(12.0 * v + z / 5.0)
    wall = np.stack([radius * np.cos(v), radius * np.sin(v), z + 0.0 * v], axis=2)
    ends = np.broadcast_to(np.array([[[0.0, 0.0, 0.0]], [[0.0, 0.0, 40.0]]]), (2, 2400, 3))
    return np.concatenate([ends[:1], wall, ends[1:]])


def knot() -> Array:
    """Return a torus knot as a tube."""
    u = np.append(around(1500), 0.0)
    radius = 20.0 + 8.0 * np.cos(3.0 * u)
    centre = np.stack(
        [radius * np.cos(2.0 * u), radius * np.sin(2.0 * u), 8.0 * np.sin(3.0 * u) + 12.1], axis=1
    )
    ahead = np.roll(centre[:-1], -1, axis=0) - np.roll(centre[:-1], 1, axis=0)
    side = np.cross(ahead, [0.0, 0.0, 1.0])
    up = np.cross(ahead, side)
    v = around(60)[None, :, None]
    ring = [axis / np.linalg.norm(axis, axis=1)[:, None] for axis in (side, up)]
    tube = centre[:-1, None] + 4.0 * (np.cos(v) * ring[0][:, None] + np.sin(v) * ring[1][:, None])
    return np.concatenate([tube, tube[:1]])

"""Axes, rays, boxes, meshes, the skeleton and its joints, and streams on one clock."""

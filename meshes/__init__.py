"""Meshes of the specimens, knowing nothing of physics."""

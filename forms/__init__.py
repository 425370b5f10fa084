"""Weak forms in UFL, written once and knowing nothing of grains."""

"""Embedded synthetic worlds: trimesh scenes cast with embreex, with exact ground truth."""
